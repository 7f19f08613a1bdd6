"""What each hyperparameter does: the metric over one axis, and over a pair of them."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import pyarrow as pa
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import AutoLocator, FixedLocator, FuncFormatter, LogLocator, NullLocator

from jaxq import stats
from jaxq.pictures.columns import by_setting, metric_of
from jaxq.pictures.dress import COLOR_MAP, COLORS, dress, with_legend

#: Positive values that span more than this many times have a logarithmic scale.
WIDE = 9
#: An axis of more values than this is averaged in as many bins as ``BINS``, a grid of more cells has no numbers.
FEW_VALUES, BINS, FEW_CELLS = 12, 8, 120
#: More settings than this are dots without intervals.
FEW_SETTINGS = 40


def sensitivity(lanes: pa.Table, axis: str, varied: Sequence[str], metric: str = "eval_return") -> Figure:
    """The metric over one axis: a dot per setting, its interquartile mean over seeds (with its 95 % interval where
    there are few), and a line, the interquartile mean of all lanes with that value, or of an eighth of them where
    values are many. Diverged lanes count as the worst, unsolved ones as the longest.
    """
    chosen = metric_of(lanes, metric)
    values = chosen.values
    groups = by_setting(lanes)
    figure = Figure(figsize=(7, 4.2), layout="constrained")
    axes: Any = figure.subplots()
    dress(axes, f"{chosen.name} by {axis}", axis, f"{chosen.name}, interquartile mean")
    column = lanes[axis].to_pylist()
    places, ticks = _places(column)
    handles, labels = [], []
    estimates = [stats.interquartile_mean(values[rows].tolist()) for rows in groups.values()]
    x = np.array([places[rows[0]] for rows in groups.values()])
    x = x + _jitter(x, ticks)
    heights = np.array([estimate.value for estimate in estimates], float)
    few = len(groups) <= FEW_SETTINGS
    dots = axes.plot(x, heights, ".", color="0.55", markersize=7 if few else 3, alpha=0.9 if few else 0.5, zorder=2)
    handles += dots
    labels.append("a setting")
    if few and estimates[0].low is not None:
        low, high = (np.array([getattr(e, end) for e in estimates], float) for end in ("low", "high"))
        axes.vlines(x, low, high, color="0.75", linewidth=1, zorder=1)
        labels[-1] = "a setting, with its 95 % interval over seeds"
    at, middle, low, high, binned = _marginal(places, values)
    if len(at) > 1 and len(groups) > len(at):
        handles += axes.plot(at, middle, color=COLORS[0], marker="o", markersize=5, zorder=3)
        several = max(map(len, groups.values())) > 1  # one seed has no interval
        if several:
            axes.fill_between(at, low, high, color=COLORS[0], alpha=0.15, linewidth=0, zorder=0)
        labels.append(f"all lanes {'of an eighth of the values' if binned else 'with this value'}")
        labels[-1] += ", 95 % interval" if several else ""
    _scale(axes, places, ticks)
    return with_legend(figure, handles, labels, chosen.note)


def heat_map(lanes: pa.Table, x: str, y: str, metric: str = "eval_return") -> Figure:
    """The metric over a pair of axes: a cell per pair of values, the interquartile mean of all its lanes, with its
    number where cells are few; or a dot per setting where values are many. Diverged lanes count as the worst, unsolved
    ones as the longest.
    """
    chosen = metric_of(lanes, metric)
    values = chosen.values
    figure = Figure(figsize=(7, 5), layout="constrained")
    axes: Any = figure.subplots()
    dress(axes, f"{chosen.name} by {x} and {y}", x, y)
    axes.grid(visible=False)
    across, columns = _ranks(lanes[x].to_pylist())
    up, rows = _ranks(lanes[y].to_pylist())
    if len(columns) * len(rows) <= 2 * len(by_setting(lanes)) or max(len(columns), len(rows)) <= FEW_VALUES:
        shown = _cells(axes, across, up, values, columns, rows)
    else:
        shown = _dots(axes, lanes, x, y, values)
    figure.colorbar(shown, ax=axes, label=f"{chosen.name}, interquartile mean")
    return with_legend(figure, [], [], chosen.note)


def _cells(
    axes: Axes, across: np.ndarray, up: np.ndarray, values: np.ndarray, columns: list[str], rows: list[str]
) -> Any:
    cells = np.full((len(rows), len(columns)), np.nan)
    for i in range(len(rows)):
        for j in range(len(columns)):
            mine = values[(up == i) & (across == j)]
            if len(mine):
                cells[i, j] = stats.interquartile_mean(mine.tolist()).value
    shown = axes.imshow(cells, origin="lower", aspect="auto", cmap=COLOR_MAP)
    _label(axes.xaxis, columns)
    _label(axes.yaxis, rows)
    if cells.size <= FEW_CELLS:
        low, high = np.nanmin(cells), np.nanmax(cells)
        for (i, j), value in np.ndenumerate(cells):
            if np.isfinite(value):
                bright = value > low + 0.6 * (high - low)
                axes.text(j, i, f"{value:.0f}", ha="center", va="center", color="black" if bright else "white")
    return shown


def _dots(axes: Axes, lanes: pa.Table, x: str, y: str, values: np.ndarray) -> Any:
    groups = by_setting(lanes)
    heights = np.array([stats.interquartile_mean(values[rows].tolist()).value for rows in groups.values()], float)
    places = []
    for name, scale in ((x, _scale), (y, _scale_up)):
        at, ticks = _places(lanes[name].to_pylist())
        first = np.array([at[rows[0]] for rows in groups.values()])
        places.append(first + _jitter(first, ticks))
        scale(axes, at, ticks)
    order = np.argsort(heights)  # the best on top
    across, up, heights = places[0][order], places[1][order], heights[order]
    size = 70 if len(order) <= 100 else 18
    return axes.scatter(across, up, c=heights, cmap=COLOR_MAP, s=size, edgecolors="0.3", linewidths=0.3)


def _marginal(places: np.ndarray, values: np.ndarray) -> tuple[np.ndarray, ...]:
    """Per value, or per bin of equally many lanes: where, the interquartile mean, the ends of its interval."""
    distinct = np.unique(places)
    binned = len(distinct) > FEW_VALUES
    if binned:
        parts = [part for part in np.array_split(np.argsort(places, kind="stable"), BINS) if len(part)]
    else:
        parts = [np.flatnonzero(places == value) for value in distinct]
    found = [stats.interquartile_mean(values[part].tolist()) for part in parts]
    at = np.array([np.median(places[part]) for part in parts])
    ends = ([estimate.value if end is None else end for estimate, end in pairs] for pairs in _ends(found))
    low, high = (np.array(end, float) for end in ends)
    return at, np.array([estimate.value for estimate in found], float), low, high, np.array(binned)


def _ends(found: list[stats.Estimate]) -> tuple[list[Any], list[Any]]:
    return [(one, one.low) for one in found], [(one, one.high) for one in found]


def _places(column: list[Any]) -> tuple[np.ndarray, list[str] | None]:
    """Where the values of an axis stand: numbers where they are, others side by side with their names as ticks."""
    if all(isinstance(value, (int, float)) and not isinstance(value, bool) for value in column):
        return np.asarray(column, float), None
    ranks, names = _ranks(column)
    return ranks.astype(float), names


def _ranks(column: list[Any]) -> tuple[np.ndarray, list[str]]:
    """The rank of each value among the different ones, and their names; null has a place of its own."""
    distinct = sorted(set(column), key=lambda value: (value is None, isinstance(value, str), value))
    rank = {value: i for i, value in enumerate(distinct)}
    names = [
        f"{value:g}" if isinstance(value, float) else "none" if value is None else str(value) for value in distinct
    ]
    return np.array([rank[value] for value in column]), names


def _jitter(x: np.ndarray, ticks: list[str] | None) -> np.ndarray:
    """Settings of one category stand beside each other."""
    if ticks is None:
        return np.zeros(len(x))
    return np.random.default_rng(0).uniform(-0.22, 0.22, len(x))


def _scale(axes: Axes, places: np.ndarray, ticks: list[str] | None) -> None:
    if ticks is not None:
        _label(axes.xaxis, ticks)
        axes.set_xlim(-0.5, len(ticks) - 0.5)
    else:
        _plain(axes, axes.xaxis, places)


def _scale_up(axes: Axes, places: np.ndarray, ticks: list[str] | None) -> None:
    if ticks is not None:
        _label(axes.yaxis, ticks)
        axes.set_ylim(-0.5, len(ticks) - 0.5)
    else:
        _plain(axes, axes.yaxis, places)


def _is_wide(places: np.ndarray) -> bool:
    return bool(places.min() > 0 and places.max() > WIDE * places.min())


def _plain(axes: Axes, axis: Any, places: np.ndarray) -> None:
    """A scale and ticks for a hyperparameter's numbers, written as they are: 0.99, not 990m."""
    wide = _is_wide(places)
    distinct = np.unique(places)
    if wide:
        (axes.set_xscale if axis.axis_name == "x" else axes.set_yscale)("log")
    if wide and len(distinct) <= FEW_VALUES:
        axis.set_major_locator(FixedLocator(distinct.tolist()))
    else:
        axis.set_major_locator(LogLocator(subs=(1.0, 3.0)) if wide else AutoLocator())
    axis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:.6g}"))
    axis.set_minor_locator(NullLocator())


def _label(axis: Any, names: list[str]) -> None:
    """Names as ticks, at most some twenty of them."""
    every = -(-len(names) // 20)
    at = list(range(0, len(names), every))
    turn = axis.axis_name == "x" and max(len(names[i]) for i in at) * len(at) > 60
    axis.set_ticks(at, [names[i] for i in at], **({"rotation": 45, "ha": "right"} if turn else {}))
