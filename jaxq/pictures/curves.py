"""Learning curves of a sweep: returns and the share of solved lanes over environment steps."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import pyarrow as pa
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import EngFormatter
from pyarrow import compute

from jaxq.pictures.columns import by_setting, can_rank, numbers, words
from jaxq.pictures.dress import COLORS, GRID, MOST_SETTINGS, dress, marks, nothing, with_legend

#: The axes of a sweep are cut when the longest lane ran more than this many times as long as 98 of 100.
MUCH_LONGER = 1.5


def learning_curves(lanes: pa.Table, curves: pa.Table, labels: Mapping[int, str]) -> Figure:
    """A sweep's picture: per setting the median training return with its quartiles, the same of greedy evaluations
    where there were some while training, and the share of solved lanes, over environment steps. A lane's curve begins
    at its first point, and a lane that ended keeps its last return. At most eight settings, those of highest return,
    or the first ones where a setting has one seed, which ranks nothing. When a few lanes ran much longer than the rest
    the axes end where 98 of 100 have ended, and the final share stands at the edge where it is another. What is left
    out is said above the legend.
    """
    if not len(lanes):
        figure = Figure(figsize=(11, 4), layout="constrained")
        return nothing(figure, "no lanes", *figure.subplots(1, 2))
    groups = by_setting(lanes)
    ranked = can_rank(groups)
    final, ends, status = numbers(lanes, "final_return"), numbers(lanes, "env_steps"), words(lanes, "status")
    means = {c: float(np.nan_to_num(final[rows], posinf=0, neginf=0).mean()) for c, rows in groups.items()}
    shown = sorted(sorted(means, key=lambda c: (-means[c] if ranked else 0.0, c))[:MOST_SETTINGS])
    picked = curves
    if len(shown) < len(groups):
        picked = curves.filter(compute.is_in(curves["config"], value_set=pa.array(shown, pa.int64())))
    evaluated = picked["eval_return"].drop_null() if len(picked) else []
    watched = len(evaluated) > sum(len(groups[c]) for c in shown)
    figure = Figure(figsize=(15 if watched else 11, 4), layout="constrained")
    left, *middle, right = figure.subplots(1, 3 if watched else 2)
    counts = {len(groups[c]) for c in shown}
    of = f"{n} lane{'s' * (n > 1)}" if len(counts) == 1 and (n := max(counts)) else "the setting's lanes"
    statistic = "return per episode" if counts == {1} else f"return: median, quartiles of {of}"
    dress(left, "return of training episodes", "environment steps", statistic)
    for axes in middle:
        dress(axes, "return of greedy episodes", "environment steps", statistic)
    dress(right, "share of lanes solved", "environment steps", f"share of {of}")
    of_shown = np.concatenate([groups[c] for c in shown])
    last = int(np.percentile(ends[of_shown], 98, method="inverted_cdf"))
    last = max(1, last if ends[of_shown].max() > MUCH_LONGER * last else int(ends[of_shown].max()))
    grid = np.linspace(0, last, GRID)
    right.set_ylim(-0.03, 1.03)
    curves_of = by_setting(picked)
    columns = [(left, numbers(picked, "train_return")), *((axes, numbers(picked, "eval_return")) for axes in middle)]
    seeds, steps = numbers(picked, "seed"), numbers(picked, "env_steps")
    stop, at = words(lanes, "stop"), numbers(lanes, "solved_at_step")
    handles, rises = [], []
    for i, config in enumerate(shown):
        look: dict[str, Any] = {"color": COLORS[i], "linestyle": (0, (4, 2)) if i % 2 else "-"}
        mine = curves_of.get(config, np.zeros(0, int))
        for axes, returns in columns:
            _draw(axes, grid, _on_grid(seeds[mine], steps[mine], returns[mine], grid), look)
        rows = groups[config]
        handles += right.plot([], [], **look)
        if stop[rows[0]] == "none":  # nobody looks for success
            continue
        times = np.sort(at[rows][np.isfinite(at[rows])])
        solved = np.searchsorted(times, grid, side="right") / len(rows)
        right.step(grid, solved, where="post", **look)
        if f"{solved[-1]:.2f}" != f"{len(times) / len(rows):.2f}":
            rises.append((len(times) / len(rows), float(solved[-1]), COLORS[i]))
    for axes in (left, *middle):
        if not axes.lines:
            nothing(figure, "no finished episode", axes)
    if len(right.lines) == len(shown):  # their keys in the legend alone
        nothing(figure, "no setting looks for success", right)
    for axes in (left, *middle, right):
        axes.set_xlim(-0.03 * last, 1.02 * last)
    _mark_rises(right, last, rises)
    notes = _notes(ends[of_shown], status[of_shown], len(shown), len(groups), last, bool(rises), ranked)
    return with_legend(figure, handles, [labels[c] for c in shown], notes)


def _draw(axes: Axes, grid: np.ndarray, values: np.ndarray, look: dict[str, Any]) -> None:
    known = np.isfinite(values).any(axis=0)
    if known.any():
        # Column by column: of thousands of lanes a copy of all is much memory.
        quartiles = [np.nanpercentile(column, [25, 50, 75]) for column in (values[:, i] for i in np.flatnonzero(known))]
        low, middle, high = np.array(quartiles, float).T
        axes.plot(grid[known], middle, **look, **(marks(1) if known.sum() == 1 else {}))
        axes.fill_between(grid[known], low, high, color=look["color"], alpha=0.15, linewidth=0)


def _on_grid(seeds: np.ndarray, steps: np.ndarray, returns: np.ndarray, grid: np.ndarray) -> np.ndarray:
    """Each lane's latest return at each point of the grid, NaN before its first, [lanes, points].

    Not a line between the points: the median of lanes half way up and half way down would dip where none does.
    """
    known = np.isfinite(returns)
    seeds, steps, returns = seeds[known], steps[known], returns[known]
    order = np.lexsort((steps, seeds))
    _, begins = np.unique(seeds[order], return_index=True)
    groups = np.split(order, begins[1:]) if len(order) else []
    values = np.full((len(groups), len(grid)), np.nan, np.float32)
    for i, rows in enumerate(groups):
        latest = np.searchsorted(steps[rows], grid, side="right") - 1
        values[i] = np.where(latest < 0, np.nan, returns[rows][latest])
    return values


def _notes(
    ends: np.ndarray, status: np.ndarray, shown: int, settings: int, last: int, rises: bool, ranked: bool
) -> str:
    """What the picture of a sweep does not show."""
    notes = []
    if settings > shown:
        which = "those of highest return" if ranked else "the first: one seed ranks nothing"
        notes.append(f"{shown} of {settings} settings, {which}")
    if (longest := ends.max()) > last:
        note = f"the axes end where {(ends <= last).sum()} of {len(ends)} lanes have ended; the longest ran "
        note += EngFormatter(places=1, sep="")(longest) + " steps"
        notes.append(note + ("; numbers at the edge: final shares" if rises else ""))
    if diverged := int((status == "diverged").sum()):
        notes.append(f"{diverged} of {len(status)} lanes diverged and keep their last return")
    return "\n".join(notes)


def _mark_rises(axes: Axes, last: int, rises: Sequence[tuple[float, float, str]]) -> None:
    """The final shares that differ from what is drawn up to ``last``, beside the axes. No number lies on another, and
    one that several settings share is grey.
    """
    colors: dict[str, set[str]] = {}
    for final, drawn, color in rises:
        axes.plot([last, 1.05 * last], [drawn, final], color=color, linestyle=":", clip_on=False)
        axes.plot(1.05 * last, final, color=color, marker="o", markersize=3.5, clip_on=False)
        colors.setdefault(f"{final:.2f}", set()).add(color)
    gap, at = 0.055, np.inf
    for below, text in reversed(list(enumerate(sorted(colors)))):
        at = max(min(float(text), at - gap), gap * below)
        color = colors[text].pop() if len(colors[text]) == 1 else "0.2"
        axes.text(1.065 * last, at, text, color=color, fontsize="small", va="center")
