"""The share of seeds that are not solved yet, over environment steps or episodes."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
import pyarrow as pa
from matplotlib.collections import LineCollection
from matplotlib.figure import Figure

from jaxq import stats
from jaxq.pictures.columns import CLOCKS, by_setting, can_rank, numbers, rungs, told_of_stopped, words
from jaxq.pictures.dress import COLORS, MOST_SETTINGS, dress, nothing, with_legend
from jaxq.summaries import time_to_success

#: More bands than this are pale, since they lie on each other.
MOST_SHADED = 4
_SOLVED = {clock: name for name, clock in CLOCKS.items()}


def survival(lanes: pa.Table, labels: Mapping[int, str], clock: str = "env_steps") -> Figure:
    """Kaplan-Meier curves: the share of seeds unsolved, with 95 % bands (log-log Greenwood) where a setting has two
    seeds or more. A curve ends where the last of its seeds was watched, and a tick marks a seed that was watched no
    longer. Of more than eight settings those with a solved seed have colours, at most eight, the others are grey: first
    those that went to the end, the quickest being those with the smallest area below their curve, or the first ones
    where a setting has one seed, which ranks nothing. Raises ValueError for an unknown clock.

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
    until = {
        config: end if curve.share[-1] == 0 else min(end, max(found[config][0])) for config, curve in curves.items()
    }
    areas = {config: _mean(curve, until[config]) for config, curve in curves.items()}
    ranked, far = can_rank({config: times for config, (times, _) in found.items()}), rungs(lanes)
    best = list(curves)
    if len(best) > MOST_SETTINGS:
        best = [config for config, (_, seen) in found.items() if seen.any()]
        best.sort(key=lambda config: (-far[config], areas[config], config) if ranked else (config,))
        best = sorted(best[:MOST_SETTINGS])
    others = [(curve, until[config]) for config, curve in curves.items() if config not in best]
    grey = [np.column_stack(_steps(curve.times, curve.share, last)) for curve, last in others]
    axes.add_collection(LineCollection(grey, colors="0.8", linewidths=0.6, zorder=1))
    handles: list[Any] = []
    bands = ticks = False
    for i, config in enumerate(best):
        curve, last, (times, seen) = curves[config], until[config], found[config]
        look: dict[str, Any] = {"color": COLORS[i], "linestyle": (0, (4, 2)) if i % 2 else "-"}
        x, y = _steps(curve.times, curve.share, last)
        handles += axes.plot(x, y, zorder=3, **look)
        if len(times) > 1:
            low, high = (_steps(curve.times, ends, last)[1] for ends in (curve.low, curve.high))
            inside = x <= curve.times[int(np.argmin(curve.share))] if curve.share[-1] == 0 else np.ones(len(x), bool)
            shade = 0.15 if len(best) <= MOST_SHADED else 0.05
            axes.fill_between(x[inside], low[inside], high[inside], color=COLORS[i], alpha=shade, linewidth=0, zorder=2)
            bands = bands or bool(np.isfinite(low[inside]).any())
        watched = times[~seen & np.isfinite(times)]
        heights = y[np.searchsorted(x, watched, side="right") - 1]
        axes.plot(watched, heights, "|", color=COLORS[i], markersize=8, zorder=4)
        ticks = ticks or len(watched) > 0
    axes.set_ylim(-0.03, 1.03)
    axes.set_xlim(-0.02 * end, 1.02 * end)
    signs = ["bands: 95 % intervals"] * bands + ["|: a seed watched no longer"] * ticks
    notes = ["; ".join(signs)] if signs else []
    if len(best) < len(curves):
        solved = sum(bool(seen.any()) for _, seen in found.values())
        which = "the quickest" if ranked else "the first with a solved seed, as one seed ranks nothing"
        which = which if len(best) < solved else "those with a solved seed"
        told = f"{len(best)} of {len(curves)} settings, {which}; the others are grey"
        notes.insert(0, told if best else f"no seed of the {len(curves)} settings was solved")
    status = np.concatenate([data["status"][rows] for config, rows in by_setting(lanes).items() if config in found])
    never = np.isinf(np.concatenate([times for times, _ in found.values()]))
    notes += [_told_of_never(status, never, clock), told_of_stopped(status, "watched until then")]
    notes = list(filter(None, notes))
    return with_legend(figure, handles, [labels[config] for config in best], "\n".join(notes))


def _told_of_never(status: np.ndarray, never: np.ndarray, clock: str) -> str:
    lost = int((status[never] == "diverged").sum())
    out = int(never.sum()) - lost
    limit = {"env_steps": "max_episodes", "episodes": "max_env_steps"}[clock]  # of the clock that is not drawn
    told = [f"{n} of {len(never)} seeds {what}" for n, what in ((lost, "diverged"), (out, f"reached {limit}")) if n]
    return f"{', '.join(told)} and count as never solved" if told else ""


def _steps(times: np.ndarray, values: np.ndarray, end: float) -> tuple[np.ndarray, np.ndarray]:
    """The corners of a step function up to ``end``; where an interval is not known, the value 1 or 0 that it is at."""
    known = times <= end
    times, values = times[known], values[known]
    x = np.repeat(np.append(times, end), 2)[1:-1]
    return x, np.repeat(values, 2)


def _mean(curve: Any, end: float) -> float:
    """The mean share up to the end of the curve: what nobody watched ranks nothing."""
    x, y = _steps(curve.times, curve.share, end)
    return float(np.sum(np.diff(x) * y[:-1])) / max(end, 1.0)
