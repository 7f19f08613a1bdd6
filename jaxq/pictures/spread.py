"""How far the seeds of a setting are apart."""

from __future__ import annotations

import itertools
from collections.abc import Collection, Mapping
from typing import Any

import numpy as np
import pyarrow as pa
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from jaxq import stats
from jaxq.pictures.columns import by_setting, can_rank, metric_of, rungs
from jaxq.pictures.dress import COLORS, STOPPED, dress, measured, nothing, with_legend, wrapped

#: Up to so many settings have a row each; more are drawn by their rank.
MOST_ROWS = 40


def spread(lanes: pa.Table, labels: Mapping[int, str], metric: str = "eval_return") -> Figure:
    """Every seed of every setting: up to forty settings as rows of dots with the interquartile mean and its 95 %
    interval, the best on top; of more the interquartile mean, the quartiles and the range of the seeds by rank.
    Diverged lanes count as the worst. Settings that halving stopped come after those that went to the end, those that
    came further first, and have crosses, or stand right of a line. Settings of one seed are in the order of the sweep:
    one seed ranks nothing.
    """
    if not len(lanes):
        figure = Figure(figsize=(7, 3), layout="constrained")
        return nothing(figure, "no lanes", figure.subplots())
    chosen = metric_of(lanes, metric)
    values, sign = chosen.values, -1 if chosen.more_is_better else 1
    groups, far = by_setting(lanes), rungs(lanes)
    estimates = {c: stats.interquartile_mean(values[rows].tolist()) for c, rows in groups.items()}
    ranked = can_rank(groups)
    order = sorted(groups, key=lambda c: (-far[c], sign * (estimates[c].value or 0.0), c) if ranked else (c,))
    stopped = {config for config, rung in far.items() if np.isfinite(rung)}
    notes = [] if ranked or len(groups) == 1 else ["one seed: in the order of the sweep, not by rank"]
    notes += [chosen.note] if chosen.note else []
    if len(groups) <= MOST_ROWS:
        return _rows(order, groups, values, estimates, labels, chosen.name, "\n".join(notes), stopped)
    if ranked and stopped:
        notes.append("right of the line: settings that were stopped at a rung, those that came further first")
    if ranked:
        ends = {"first": labels[order[0]], "last": labels[order[-1]]}
        notes += [wrapped(f"{which}: {label}", 110) for which, label in ends.items()]
    figure = _ranks(order, groups, values, estimates, chosen.name, "\n".join(notes), ranked)
    if ranked and stopped:
        figure.axes[0].axvline(len(groups) - len(stopped) + 0.5, color="0.3", linestyle="--", linewidth=0.8)
    return figure


def _rows(
    order: list[int],
    groups: dict[int, np.ndarray],
    values: np.ndarray,
    estimates: dict[int, stats.Estimate],
    labels: Mapping[int, str],
    name: str,
    note: str,
    stopped: Collection[int],
) -> Figure:
    texts = [wrapped(labels[config], 60) for config in order]
    lines = sum(text.count("\n") + 1 for text in texts)
    figure = Figure(figsize=(9, 1.6 + 0.26 * lines), layout="constrained")
    axes: Any = figure.subplots()
    dress(axes, f"{name} of every seed", name, "")
    measured(axes.xaxis, values)
    rng = np.random.default_rng(0)
    handles: list[Any] = []
    dots: dict[str, list[Any]] = {}
    for row, config in enumerate(order):
        mine, estimate = values[groups[config]], estimates[config]
        height = row + rng.uniform(-0.2, 0.2, len(mine)) if len(mine) > 1 else [row]
        mark, wide = (STOPPED, 0.7) if config in stopped else (".", 1.0)
        size = wide * (9 if len(mine) == 1 else 6 if len(mine) <= 64 else 3)
        dots[mark] = axes.plot(mine, height, mark, color="0.6", markersize=size, alpha=0.8, zorder=2)
        if len(mine) > 1:  # of one seed the value is all there is
            middle = axes.plot([estimate.value], [row], "o", color=COLORS[0], markersize=6, zorder=4)
            axes.hlines(row, estimate.low, estimate.high, color=COLORS[0], linewidth=2, zorder=3)
            handles = middle
    axes.set_yticks(range(len(order)), texts, fontsize="small")
    axes.set_ylim(len(order) - 0.4, -0.6)
    _widen(axes, values)
    names = ["a seed" if mark == "." else "a seed of a setting that was stopped at a rung" for mark in dots]
    names += ["interquartile mean, 95 % interval"] * bool(handles)
    return with_legend(figure, [*itertools.chain(*dots.values()), *handles], names, note)


def _ranks(
    order: list[int],
    groups: dict[int, np.ndarray],
    values: np.ndarray,
    estimates: dict[int, stats.Estimate],
    name: str,
    note: str,
    ranked: bool,
) -> Figure:
    figure = Figure(figsize=(9, 4.5), layout="constrained")
    axes: Any = figure.subplots()
    dress(axes, f"{name} of {len(order)} settings", "rank of the setting" if ranked else "setting", name)
    measured(axes.yaxis, values)
    x = np.arange(1, len(order) + 1)
    middle = np.array([estimates[config].value for config in order], float)
    names, handles = ["the setting's one seed"], []
    if any(len(rows) > 1 for rows in groups.values()):
        ends = np.array([np.percentile(values[groups[config]], [0, 25, 75, 100]) for config in order]).T
        handles.append(axes.fill_between(x, ends[0], ends[3], step="mid", color=COLORS[0], alpha=0.12, linewidth=0))
        handles.append(axes.fill_between(x, ends[1], ends[2], step="mid", color=COLORS[0], alpha=0.3, linewidth=0))
        names = ["range of the seeds", "quartiles of the seeds", "interquartile mean"]
    handles += axes.plot(x, middle, ".", color=COLORS[0], markersize=3)
    axes.set_xlim(0, len(order) + 1)
    return with_legend(figure, handles, names, note)


def _widen(axes: Axes, values: np.ndarray) -> None:
    """Equal values, as 500 of every seed, are not at the edge."""
    low, high = float(values.min()), float(values.max())
    room = 0.04 * (high - low) or max(1.0, 0.1 * abs(high))
    axes.set_xlim(low - room, high + room)
