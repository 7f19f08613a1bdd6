"""Columns of tables as arrays, rows by setting, and the metric that a picture is about."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
import pyarrow as pa

from jaxq.suggest import nearest
from jaxq.summaries import is_number


def numbers(table: pa.Table, name: str) -> np.ndarray:
    """A column as float64, NaN for null."""
    return np.asarray(table[name].cast(pa.float64()).to_numpy(), float)


def words(table: pa.Table, name: str) -> np.ndarray:
    """A column of text."""
    return np.asarray(table[name].to_pylist(), object)


def by_setting(table: pa.Table) -> dict[int, np.ndarray]:
    """The row numbers of each setting, in the order of the settings."""
    config = table["config"].to_numpy()
    order = np.argsort(config, kind="stable")
    settings, begins = np.unique(config[order], return_index=True)
    return dict(zip(settings.tolist(), np.split(order, begins[1:]), strict=True)) if len(order) else {}


def rungs(lanes: pa.Table) -> dict[int, float]:
    """How far each setting came: the last rung at which halving stopped a lane of it, infinity for one that went on."""
    groups = by_setting(lanes)
    if "stopped_at_rung" not in lanes.column_names:
        return dict.fromkeys(groups, np.inf)
    at = np.nan_to_num(numbers(lanes, "stopped_at_rung"), nan=-1)
    last = {config: float(at[rows].max()) for config, rows in groups.items()}
    return {config: np.inf if rung < 0 else rung for config, rung in last.items()}


def told_of_stopped(status: np.ndarray, what: str) -> str:
    """How many lanes halving stopped, and ``what`` that means in a picture; "" where it stopped none."""
    count = int((status == "stopped").sum())
    return f"{count} of {len(status)} lanes were stopped at a rung: {what}" if count else ""


def can_rank(groups: Mapping[int, np.ndarray]) -> bool:
    """Whether every setting has two seeds or more: one seed ranks nothing."""
    return all(len(rows) > 1 for rows in groups.values())


@dataclass(frozen=True)
class Metric:
    """What settings are compared by: its name on an axis, a value per lane, and what was counted how."""

    name: str
    values: np.ndarray
    more_is_better: bool
    note: str


def metric_of(lanes: pa.Table, metric: str) -> Metric:
    """The metric of each lane: ``eval_return``, another column of returns, or a time to success.

    Where no lane has the one that is asked for ``eval_return`` stands in, or ``final_return`` where none has that. A
    lane that diverged or has no return counts as the worst there is, 0 or the least value where that is lower; one
    that was never solved as the longest; one that halving stopped has the return that it had then. Raises ValueError
    for what is no column of numbers.
    """
    after = lanes.column_names.index("status") + 1
    known = [name for name in lanes.column_names[after:] if is_number(lanes[name].type)]
    if metric not in known:
        raise ValueError(f"metric: {metric!r} is no column of numbers of the lanes{nearest(str(metric), known)}")
    columns = [name for name in dict.fromkeys((metric, "eval_return", "final_return")) if name in lanes.column_names]
    name = next((one for one in columns if np.isfinite(numbers(lanes, one)).any()), columns[-1])
    status = words(lanes, "status")
    values, title = numbers(lanes, name), NAMES.get(name, name.replace("_", " "))
    missing = ~np.isfinite(values)
    if name in CLOCKS:
        longest = max(float(numbers(lanes, CLOCKS[name]).max()), float(values[~missing].max(initial=0.0)))
        told = f"{missing.sum()} of {len(values)} lanes were not solved and count as the longest"
        if stopped := int((status == "stopped").sum()):
            told += f", {stopped} of them because a rung stopped them"
        return Metric(title, np.where(missing, longest, values), False, told if missing.any() else "")
    diverged = status == "diverged"
    worst = min(0.0, float(values[~missing & ~diverged].min(initial=0.0)))
    counts = {"diverged": int(diverged.sum()), f"have no {title}": int((missing & ~diverged).sum())}
    told = ", ".join(f"{count} of {len(values)} lanes {what}" for what, count in counts.items() if count)
    note = [f"{told} and count as the worst" if told else "", told_of_stopped(status, "they have their return of then")]
    return Metric(title, np.where(missing | diverged, worst, values), True, "\n".join(filter(None, note)))


#: The columns of times to success, and the clock that each is read from.
CLOCKS = {"solved_at_step": "env_steps", "solved_at_episode": "episodes"}
NAMES = {
    "eval_return": "greedy return",
    "final_return": "training return",
    "solved_at_step": "environment steps until solved",
    "solved_at_episode": "episodes until solved",
}
