"""The parts that a tabular learner is put together from, by name, and which go together. Imports no jax."""

from __future__ import annotations

from typing import Literal, get_args

#: What a transition bootstraps from.
Target = Literal["greedy", "sarsa", "expected"]
#: Which traces visits leave.
TraceKind = Literal["none", "accumulating", "replacing", "dutch"]
#: What step sizes follow.
StepSizeBy = Literal["episodes", "visits"]


def unfit(
    *,
    target: str,
    double: bool,
    n_steps: int,
    traces: str,
    offline: bool,
    planning_steps: int,
    model_outcomes: int,
    step_size: str,
) -> str:
    """What is wrong with parts or with their being together, in one line; empty where nothing is.

    >>> unfit(target="greedy", double=True, n_steps=1, traces="dutch", offline=False, planning_steps=0,
    ...       model_outcomes=1, step_size="episodes")
    'double: True is not allowed with traces (dutch), whose errors all go to one table'
    """
    for field, value, names in (
        ("target", target, get_args(Target)),
        ("traces", traces, get_args(TraceKind)),
        ("step_size", step_size, get_args(StepSizeBy)),
    ):
        if value not in names:
            return f"{field}: {value!r} is not allowed: {', '.join(names)}"
    least = {"n_steps": (n_steps, 1), "planning_steps": (planning_steps, 0), "model_outcomes": (model_outcomes, 1)}
    for field, (count, bound) in least.items():
        if count < bound:
            return f"{field}: {count} is not allowed: at least {bound}"
    if traces != "none" and n_steps > 1:
        return f"n_steps: {n_steps} is not allowed with traces ({traces}): 1"
    if traces != "none" and double:
        return f"double: {double} is not allowed with traces ({traces}), whose errors all go to one table"
    if offline and traces in ("none", "dutch"):
        return f"offline: {offline} is not allowed with traces ({traces}): accumulating or replacing ones"
    if offline and planning_steps:
        return f"planning_steps: {planning_steps} is not allowed with offline, which leaves the table until the cut: 0"
    return ""
