"""The share of seeds that are not solved yet, over environment steps or episodes."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
import pyarrow as pa
from matplotlib.collections import LineCollection
from matplotlib.figure import Figure

from jaxq import stats
from jaxq.pictures.columns import CLOCKS, by_setting, can_rank, numbers, words
from jaxq.pictures.dress import COLORS, MOST_SETTINGS, dress, nothing, with_legend
from jaxq.summaries import time_to_success

#: More bands than this are pale, since they lie on each other.
MOST_SHADED = 4
_SOLVED = {clock: name for name, clock in CLOCKS.items()}


def survival(lanes: pa.Table, labels: Mapping[int, str], clock: str = "env_steps") -> Figure:
    """Kaplan-Meier curves: the share of seeds unsolved, with 95 % bands (log-log Greenwood) where a setting has two
    seeds or more. At most eight settings have colours, those with the smallest area below their curve, or the first
    ones where a setting has one seed, which ranks nothing; the others are grey. A tick marks a seed that was watched no
    longer. Raises ValueError for an unknown clock.

    Kaplan and Meier, *Nonparametric Estimation from Incomplete Observations*, 1958.
    """
    if clock not in _SOLVED:
        raise ValueError(f"clock: {clock!r} is not one of {', '.join(_SOLVED)}")
    figure = Figure(figsize=(8, 4.2), layout="constrained")
    axes: Any = figure.subplots()
    name = clock.replace("env_steps", "environment steps")
    dress(axes, f"seeds not solved yet, over {name}", name, "share of seeds unsolved")
    if not len(lanes):
        return nothing(figure, "no lanes", axes)
    columns = ("solved_at_step", "solved_at_episode", "env_steps", "episodes", "max_env_steps", "max_episodes")
    data = {name: numbers(lanes, name) for name in columns} | {"status": words(lanes, "status")}
    stop = words(lanes, "stop")
    found = {}
    for config, rows in by_setting(lanes).items():
        if stop[rows[0]] != "none":
            mine = {name: values[rows] for name, values in data.items()}
            found[config] = time_to_success(mine, _SOLVED[clock], clock, f"max_{clock}")
    if not found:
        return nothing(figure, "no setting looks for success", axes)
    end = max(1.0, max(float(data[clock][rows].max()) for rows in by_setting(lanes).values()))
    curves = {config: stats.survival(times.tolist(), seen.tolist()) for config, (times, seen) in found.items()}
    areas = {config: _area(curve, end) for config, curve in curves.items()}
    ranked = can_rank({config: times for config, (times, _) in found.items()})
    best = sorted(sorted(areas, key=lambda config: (areas[config] if ranked else 0.0, config))[:MOST_SETTINGS])
    others = [curve for config, curve in curves.items() if config not in best]
    grey = [np.column_stack(_steps(curve.times, curve.share, end)) for curve in others]
    axes.add_collection(LineCollection(grey, colors="0.8", linewidths=0.6, zorder=1))
    handles: list[Any] = []
    bands = ticks = False
    for i, config in enumerate(best):
        curve, (times, seen) = curves[config], found[config]
        look: dict[str, Any] = {"color": COLORS[i], "linestyle": (0, (4, 2)) if i % 2 else "-"}
        x, y = _steps(curve.times, curve.share, end)
        handles += axes.plot(x, y, zorder=3, **look)
        if len(times) > 1:
            low, high = (_steps(curve.times, ends, end)[1] for ends in (curve.low, curve.high))
            until = x <= curve.times[int(np.argmin(curve.share))] if curve.share[-1] == 0 else np.ones(len(x), bool)
            shade = 0.15 if len(best) <= MOST_SHADED else 0.05
            axes.fill_between(x[until], low[until], high[until], color=COLORS[i], alpha=shade, linewidth=0, zorder=2)
            bands = bands or bool(np.isfinite(low[until]).any())
        watched = times[~seen & np.isfinite(times)]
        heights = y[np.searchsorted(x, watched, side="right") - 1]
        axes.plot(watched, heights, "|", color=COLORS[i], markersize=8, zorder=4)
        ticks = ticks or len(watched) > 0
    axes.set_ylim(-0.03, 1.03)
    axes.set_xlim(-0.02 * end, 1.02 * end)
    signs = ["bands: 95 % intervals"] * bands + ["|: a seed watched no longer"] * ticks
    notes = ["; ".join(signs)] if signs else []
    if len(best) < len(curves):
        which = "the quickest" if ranked else "the first, as one seed ranks nothing"
        notes.insert(0, f"{len(best)} of {len(curves)} settings, {which}; the others are grey")
    if never := sum(int(np.isinf(times).sum()) for times, _ in found.values()):
        seeds = sum(len(times) for times, _ in found.values())
        notes.append(f"{never} of {seeds} seeds ended otherwise, as by divergence, and count as never solved")
    return with_legend(figure, handles, [labels[config] for config in best], "\n".join(notes))


def _steps(times: np.ndarray, values: np.ndarray, end: float) -> tuple[np.ndarray, np.ndarray]:
    """The corners of a step function up to ``end``; where an interval is not known, the value 1 or 0 that it is at."""
    known = times <= end
    times, values = times[known], values[known]
    x = np.repeat(np.append(times, end), 2)[1:-1]
    return x, np.repeat(values, 2)


def _area(curve: Any, end: float) -> float:
    x, y = _steps(curve.times, curve.share, end)
    return float(np.sum(np.diff(x) * y[:-1]))
