"""Columns of tables as arrays, and rows by setting."""

from __future__ import annotations

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


def metric_of(lanes: pa.Table, metric: str) -> tuple[str, np.ndarray, int]:
    """The metric of each lane: its name, its values, and how many lanes diverged.

    ``final_return`` stands in where no lane has ``metric``. A diverged lane has none, and counts as the worst there is:
    0, or the least value where that is lower.
    """
    values = numbers(lanes, metric)
    if not np.isfinite(values).any():
        metric, values = "final_return", numbers(lanes, "final_return")
    missing = ~np.isfinite(values)
    worst = min(0.0, float(values[~missing].min())) if (~missing).any() else 0.0
    return metric, np.where(missing, worst, values), int((words(lanes, "status") == "diverged").sum())


NAMES = {"eval_return": "greedy return", "final_return": "training return"}


def named(metric: str) -> str:
    """What a metric is called on an axis."""
    return NAMES.get(metric, metric.replace("_", " "))
