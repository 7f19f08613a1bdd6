"""Learning curves of a sweep: returns and the share of solved lanes over environment steps."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import pyarrow as pa
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.ticker import EngFormatter
from pyarrow import compute
from scipy.stats import binom

from jaxq import stats
from jaxq.pictures.columns import by_setting, can_rank, numbers, rungs, told_of_stopped, words
from jaxq.pictures.dress import COLORS, GRID, MOST_SETTINGS, STOPPED, dress, marks, nothing, with_legend

#: So many values have a 95 % interval of their median within them.
FEWEST = 6
#: The axes of a sweep are cut when the longest lane ran more than this many times as long as 98 of 100.
MUCH_LONGER = 1.5


def learning_curves(lanes: pa.Table, curves: pa.Table, labels: Mapping[int, str]) -> Figure:
    """A sweep's picture: per setting the median training return with its 95 % interval, the same of greedy evaluations
    where there were some while training, and the share of solved lanes where a setting looks for success, over
    environment steps. A lane's curve begins at its first point, and a lane that ended keeps its last return; of a
    setting that halving stopped the lines end where its lanes do. At most eight settings, those that went to the end
    and had the highest return, or the first ones where a setting has one seed, which ranks nothing. When a few lanes
    ran much longer than the rest the axes end where 98 of 100 have ended, and the final share stands at the edge where
    it is another. What is left out is said above the legend.
    """
    if not len(lanes):
        figure = Figure(figsize=(11, 4), layout="constrained")
        return nothing(figure, "no lanes", *figure.subplots(1, 2))
    groups, far = by_setting(lanes), rungs(lanes)
    ranked, halved = can_rank(groups), any(np.isfinite(rung) for rung in far.values())
    final, ends, status = numbers(lanes, "final_return"), numbers(lanes, "env_steps"), words(lanes, "status")
    means = {c: float(np.nan_to_num(final[rows], posinf=0, neginf=0).mean()) for c, rows in groups.items()}
    shown = sorted(sorted(means, key=lambda c: (-far[c], -means[c], c) if ranked else (c,))[:MOST_SETTINGS])
    picked = curves
    if len(shown) < len(groups):
        picked = curves.filter(compute.is_in(curves["config"], value_set=pa.array(shown, pa.int64())))
    evaluated = picked["eval_return"].drop_null() if len(picked) else []
    watched = len(evaluated) > sum(len(groups[c]) for c in shown)
    stop, at = words(lanes, "stop"), numbers(lanes, "solved_at_step")
    looks = [c for c in shown if stop[groups[c][0]] != "none"]
    panels = 1 + watched + bool(looks)
    figure = Figure(figsize=(3 + 4 * panels, 4), layout="constrained")
    left, *others = np.ravel(figure.subplots(1, panels)).tolist()
    middle, last_panel = others[:watched], others[watched:]
    counts = {len(groups[c]) for c in shown}
    of = f"{n} lane{'s' * (n > 1)}" if len(counts) == 1 and (n := max(counts)) else "the setting's lanes"
    band = "95 % interval" if max(counts) >= FEWEST else "range"
    statistic = "return per episode" if counts == {1} else f"return: median of {of}, {band}"
    dress(left, "return of training episodes", "environment steps", statistic)
    for axes in middle:
        dress(axes, "return of greedy episodes", "environment steps", statistic)
    for axes in last_panel:
        dress(axes, "share of lanes solved", "environment steps", f"share of {of}")
        axes.set_ylim(-0.03, 1.03)
    of_shown = np.concatenate([groups[c] for c in shown])
    last = int(np.percentile(ends[of_shown], 98, method="inverted_cdf"))
    last = max(1, last if ends[of_shown].max() > MUCH_LONGER * last else int(ends[of_shown].max()))
    grid = np.linspace(0, last, GRID)
    curves_of = by_setting(picked)
    columns = [(left, numbers(picked, "train_return")), *((axes, numbers(picked, "eval_return")) for axes in middle)]
    seeds, steps = numbers(picked, "seed"), numbers(picked, "env_steps")
    handles, rises = [], []
    for i, config in enumerate(shown):
        look: dict[str, Any] = {"color": COLORS[i], "linestyle": (0, (4, 2)) if i % 2 else "-"}
        mine, rows = curves_of.get(config, np.zeros(0, int)), groups[config]
        handles.append(Line2D([], [], **look))
        over = grid
        if np.isfinite(far[config]):  # what its lanes would have come to nobody knows
            over = np.append(grid[grid < ends[rows].max()], min(last, ends[rows].max()))
            look |= {"marker": STOPPED, "markevery": [-1], "markersize": 6}
        for axes, returns in columns:
            _draw(axes, over, _on_grid(seeds[mine], steps[mine], returns[mine], over), look)
        if config not in looks:
            continue
        (right,) = last_panel
        times = np.sort(at[rows][np.isfinite(at[rows])])
        solved = np.searchsorted(times, over, side="right") / len(rows)
        right.step(over, solved, where="post", **look)
        if f"{solved[-1]:.2f}" != f"{len(times) / len(rows):.2f}":
            rises.append((len(times) / len(rows), float(solved[-1]), COLORS[i]))
    for axes in (left, *middle):
        if not axes.lines:
            nothing(figure, "no finished episode", axes)
    for axes in (left, *others):
        axes.set_xlim(-0.03 * last, 1.02 * last)
    for axes in last_panel:
        _mark_rises(axes, last, rises)
    notes = _notes(ends[of_shown], status[of_shown], len(shown), len(groups), last, bool(rises), ranked, halved)
    return with_legend(figure, handles, [labels[c] for c in shown], notes)


def _draw(axes: Axes, grid: np.ndarray, values: np.ndarray, look: dict[str, Any]) -> None:
    known = np.isfinite(values).any(axis=0)
    if known.any():
        # Column by column: of thousands of lanes a copy of all is much memory.
        low, middle, high = np.array([_median(values[:, i]) for i in np.flatnonzero(known)]).T
        axes.plot(grid[known], middle, **(marks(1) if known.sum() == 1 else {}) | look)
        axes.fill_between(grid[known], low, high, color=look["color"], alpha=0.15, linewidth=0)


def _median(values: np.ndarray) -> tuple[float, float, float]:
    """The median with the ends of its 95 % interval, which are two of the values: how many are below the true median is
    binomial (n, 1/2). Of fewer than FEWEST values it would be wider than they are: then their least and greatest.
    Conover, *Practical Nonparametric Statistics*, 1999.
    """
    ordered = np.sort(values[np.isfinite(values)])
    cut = max(int(binom.ppf((1 - stats.CONFIDENCE) / 2, len(ordered), 0.5)) - 1, 0)
    return float(ordered[cut]), float(np.median(ordered)), float(ordered[len(ordered) - 1 - cut])


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
    ends: np.ndarray, status: np.ndarray, shown: int, settings: int, last: int, rises: bool, ranked: bool, halved: bool
) -> str:
    """What the picture of a sweep does not show."""
    notes = []
    if settings > shown:
        which = "those of highest return" if ranked else "the first: one seed ranks nothing"
        if ranked and halved:
            which = "those that came furthest, of these those of highest return"
        notes.append(f"{shown} of {settings} settings, {which}")
    if (longest := ends.max()) > last:
        note = f"the axes end where {(ends <= last).sum()} of {len(ends)} lanes have ended; the longest ran "
        note += EngFormatter(places=1, sep="")(longest) + " steps"
        notes.append(note + ("; numbers at the edge: final shares" if rises else ""))
    if diverged := int((status == "diverged").sum()):
        notes.append(f"{diverged} of {len(status)} lanes diverged and keep their last return")
    if stopped := told_of_stopped(status, f"their settings' lines end there ({STOPPED})"):
        notes.append(stopped)
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
