"""SBX's DQN, Stable-Baselines3 in JAX, on CartPole-v1: made, run and counted as ``sb3_dqn`` does.

Its environment and replay are Stable-Baselines3's, outside the compiled update.
"""

from __future__ import annotations

import runpy
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

PACKAGES = ("sbx-rl", "stable-baselines3", "jax", "jaxlib", "flax", "optax", "torch", "gymnasium")

SB3 = Path(__file__).with_name("sb3_dqn.py")

DIFFERS = (
    "Huber loss, no double Q-learning, all hidden layers as wide as the first: it has no others; uniform actions until"
    " updates start"
)


def prepare(case: str, setting: str = "article") -> Callable[[], float]:
    """One training of ``setting`` (a name in dqn_settings.json); ``case`` is 1. Units: updates."""
    from sbx import DQN

    return runpy.run_path(str(SB3))["throughput"](DQN, case, setting)


def solver(numbers: Mapping[str, Any], is_solved: Callable) -> Callable[[int], list]:
    """Trainings until they are solved (see ``solve``), with AMSGrad and a falling step size, as ours.

    The library reads its own schedule for the step size at the start alone, so the optimiser brings one.
    """
    import optax
    from sbx import DQN

    updates = (numbers["max_env_steps"] - numbers["learning_starts"]) // numbers["steps_per_update"]
    schedule = optax.linear_schedule(numbers["learning_rate"], numbers["learning_rate_end"], updates)
    policy = {"net_arch": numbers["hidden"], "optimizer_class": lambda learning_rate: optax.amsgrad(schedule)}
    static: dict[str, Any] = {}

    def make(*given: Any, **named: Any) -> Any:
        model = DQN(*given, **named)
        state = model.policy.qf_state
        if not static:  # with functions of its own every model would be compiled anew
            static.update(apply_fn=state.apply_fn, tx=state.tx)
        model.policy.qf_state = state.replace(**static)
        return model

    until_solved = runpy.run_path(str(SB3))["until_solved"]
    brief = {**numbers, "max_env_steps": 2 * numbers["learning_starts"]}
    until_solved(make, brief, is_solved, policy_kwargs=policy)(0)  # compiles
    return until_solved(make, numbers, is_solved, policy_kwargs=policy)
