"""Pictures as matplotlib figures, drawn off screen; ``save`` writes a PNG."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import EngFormatter

from jaxq.tables import Row

WINDOW = 50
MOST_SETTINGS = 8
GRID = 200


def q_values(max_q: np.ndarray) -> Figure:
    """The tutorial's first picture: the value bootstrapped from, at every training step. max_q [updates]."""
    figure, axes = _figure("Q-values over training steps", "training step", "Q-value")
    axes.plot(np.arange(1, len(max_q) + 1), max_q, linewidth=0.4, color="tab:blue", alpha=0.5, label="each step")
    if len(max_q) >= WINDOW:
        width = max(WINDOW, len(max_q) // GRID)
        smooth = np.convolve(max_q, np.ones(width) / width, mode="valid")
        axes.plot(np.arange(width, len(max_q) + 1), smooth, color="tab:blue", label=f"mean of {width}")
        axes.legend(frameon=False)
    return figure


def episode_lengths(lengths: np.ndarray, *, success_at: float | None = None) -> Figure:
    """The tutorial's second picture: how long each training episode lasted, with the mean of the last 50."""
    figure, axes = _figure("Successful steps over training episodes", "training episode", "steps")
    episodes = np.arange(1, len(lengths) + 1)
    axes.plot(episodes, lengths, linewidth=0.7, color="tab:blue", alpha=0.6, label="each episode")
    if len(lengths) >= WINDOW:
        mean = np.convolve(lengths, np.ones(WINDOW) / WINDOW, mode="valid")
        axes.plot(episodes[WINDOW - 1 :], mean, color="tab:orange", label=f"mean of {WINDOW}")
    if success_at is not None:
        axes.axhline(success_at, color="0.5", linestyle="--", linewidth=0.8, label="success")
    axes.legend(frameon=False)
    return figure


def learning_curves(lanes: Sequence[Row], curves: Sequence[Row], labels: dict[int, str]) -> Figure:
    """A sweep's picture: per setting the median training return with its quartiles, and the share of solved lanes,
    over environment steps. A lane that ended keeps its last return. At most eight settings, those of highest return;
    the axis ends where 98 of 100 lanes have ended.
    """
    figure = Figure(figsize=(11, 4.2), layout="constrained")
    left, right = figure.subplots(1, 2)
    _dress(left, "return of training episodes", "environment steps", "return (median, quartiles)")
    _dress(right, "share of lanes solved", "environment steps", "share")
    right.set_ylim(-0.03, 1.03)
    grid = np.linspace(0, np.percentile([row["env_steps"] for row in lanes] or [1], 98, method="higher"), GRID)
    by_config = _grouped(lanes)
    means = {c: np.mean([row["final_return"] or 0.0 for row in rows]) for c, rows in by_config.items()}
    shown = sorted(sorted(by_config, key=lambda c: -means[c])[:MOST_SETTINGS])
    curves_of = _grouped(curves)
    for i, config in enumerate(shown):
        color = f"C{i}"
        values = _on_grid(curves_of.get(config, []), grid)
        if values.size:
            low, middle, high = np.nanpercentile(values, [25, 50, 75], axis=0)
            left.plot(grid, middle, color=color, label=labels[config])
            left.fill_between(grid, low, high, color=color, alpha=0.2, linewidth=0)
        rows = by_config[config]
        times = np.sort([row["solved_at_step"] for row in rows if row["solved_at_step"] is not None])
        solved = np.searchsorted(times, grid, side="right") / len(rows)
        right.step(grid, solved, where="post", color=color, label=labels[config])
    if left.has_data():
        left.legend(frameon=False, fontsize="small")
    return figure


def save(figure: Figure, path: Path) -> Path:
    """Writes the figure and returns the path."""
    figure.savefig(path, dpi=120)
    return path


def _grouped(rows: Sequence[Row]) -> dict[int, list[Row]]:
    groups: dict[int, list[Row]] = {}
    for row in rows:
        groups.setdefault(row["config"], []).append(row)
    return groups


def _on_grid(rows: Sequence[Row], grid: np.ndarray) -> np.ndarray:
    """Each lane's latest training return at each point of the grid, [lanes, points]."""
    by_seed: dict[int, list[tuple[int, float]]] = {}
    for row in rows:
        if row["train_return"] is not None:
            by_seed.setdefault(row["seed"], []).append((row["env_steps"], row["train_return"]))
    values = []
    for points in by_seed.values():
        steps, returns = np.array(sorted(points)).T
        values.append(returns[np.clip(np.searchsorted(steps, grid, side="right") - 1, 0, None)])
    return np.array(values)


def _figure(title: str, x: str, y: str) -> tuple[Figure, Axes]:
    figure = Figure(figsize=(7, 4), layout="constrained")
    axes: Any = figure.subplots()
    _dress(axes, title, x, y)
    return figure, axes


def _dress(axes: Axes, title: str, x: str, y: str) -> None:
    axes.set_title(title)
    axes.set_xlabel(x)
    axes.set_ylabel(y)
    axes.spines[["top", "right"]].set_visible(False)
    axes.grid(alpha=0.25)
    axes.xaxis.set_major_formatter(EngFormatter(sep=""))  # 25k for 25000
