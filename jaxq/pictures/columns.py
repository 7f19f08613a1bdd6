"""Columns of tables as arrays, rows by setting, and the metric that a picture is about."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pyarrow as pa


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


@dataclass(frozen=True)
class Metric:
    """What settings are compared by: its name on an axis, a value per lane, and what was counted how."""

    name: str
    values: np.ndarray
    more_is_better: bool
    note: str


def metric_of(lanes: pa.Table, metric: str) -> Metric:
    """The metric of each lane: ``eval_return``, ``final_return``, ``area_under_curve`` or ``solved_at_step``.

    ``final_return`` stands in where no lane has the one that is asked for. A lane without a return, as a diverged one,
    counts as the worst there is, 0 or the least value where that is lower; one that was never solved as the longest.
    """
    values = numbers(lanes, metric)
    if metric == "solved_at_step" and np.isfinite(values).any():
        unsolved = ~np.isfinite(values)
        longest = max(float(numbers(lanes, "env_steps").max()), float(values[~unsolved].max()))
        count = int(unsolved.sum())
        note = f"{count} of {len(values)} lanes were not solved and count as the longest" if count else ""
        return Metric(NAMES[metric], np.where(unsolved, longest, values), False, note)
    if not np.isfinite(values).any():
        metric, values = "final_return", numbers(lanes, "final_return")
    missing = ~np.isfinite(values)
    worst = min(0.0, float(values[~missing].min())) if (~missing).any() else 0.0
    diverged = int((words(lanes, "status") == "diverged").sum())
    note = f"{diverged} of {len(values)} lanes diverged and count as the worst" if diverged else ""
    return Metric(NAMES.get(metric, metric.replace("_", " ")), np.where(missing, worst, values), True, note)


NAMES = {
    "eval_return": "greedy return",
    "final_return": "training return",
    "solved_at_step": "environment steps until solved",
}
