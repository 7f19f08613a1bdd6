"""What each hyperparameter does: the metric over one axis, and over a pair of them."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import pyarrow as pa
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import EngFormatter

from jaxq import stats
from jaxq.pictures.columns import by_setting, metric_of, rungs
from jaxq.pictures.dress import COLOR_MAP, COLORS, LARGE, STOPPED, dress, measured, nothing, with_legend
from jaxq.pictures.scales import FEW_VALUES, beside, label_of, places_of, ranks, scale

#: An axis of more numbers than ``FEW_VALUES`` is averaged in so many bins, a grid of more cells has no numbers.
BINS, FEW_CELLS = 8, 120
#: More settings than this are dots without intervals.
FEW_SETTINGS = 40


def sensitivity(lanes: pa.Table, axis: str, varied: Sequence[str], metric: str = "eval_return") -> Figure:
    """The metric over one axis: a dot per setting, its interquartile mean over seeds (with its 95 % interval where
    there are few), and a line, the interquartile mean of all lanes with that value whatever else is ``varied``, or of
    an eighth of them where values are many; names are not joined by a line. Settings of one value stand beside each
    other. Diverged lanes count as the worst, unsolved ones as the longest. A setting that halving stopped has a cross.
    """
    figure = Figure(figsize=(7, 4.2), layout="constrained")
    axes: Any = figure.subplots()
    if not len(lanes):
        return nothing(figure, "no lanes", axes)
    chosen, groups = metric_of(lanes, metric), by_setting(lanes)
    values = chosen.values
    estimates = [stats.interquartile_mean(values[rows].tolist()) for rows in groups.values()]
    several = max(map(len, groups.values())) > 1
    dress(axes, f"{chosen.name} by {axis}", axis, _mean_of(chosen.name, several))
    measured(axes.yaxis, values)
    places, names = places_of(lanes[axis].to_pylist())
    x = beside(np.array([places[rows[0]] for rows in groups.values()]), names)
    heights = np.array([estimate.value for estimate in estimates], float)
    few = len(groups) <= FEW_SETTINGS
    ended = np.array([np.isinf(rung) for rung in rungs(lanes).values()])
    look: dict[str, Any] = {"color": "0.55", "linestyle": "none", "alpha": 0.9 if few else 0.5, "zorder": 2}
    handles, labels = [], []
    if ended.any():
        stands_out: dict[str, Any] = {} if ended.all() else {"color": "black", "alpha": 0.9, "zorder": 2.5}
        size = 7 if few or not ended.all() else 3
        handles += axes.plot(x[ended], heights[ended], marker=".", markersize=size, **look | stands_out)
        labels.append("a setting" if several else "a setting, its one seed")
    if not ended.all():
        handles += axes.plot(x[~ended], heights[~ended], marker=STOPPED, markersize=5 if few else 3, **look)
        labels.append("a setting that was stopped at a rung")
    if few and several:
        low, high = (np.array([getattr(one, end) for one in estimates], float) for end in ("low", "high"))
        axes.vlines(x, low, high, color="0.75", linewidth=1, zorder=1)
        labels = [f"{label}, with its 95 % interval over seeds" for label in labels]
    at, middle, low, high, binned = _marginal(places, values, FEW_VALUES if names is None else len(names))
    if len(at) > 1 and len(groups) > len(at):
        line = "-" if names is None else "none"  # between names there is nothing
        handles += axes.plot(at, middle, color=COLORS[0], linestyle=line, marker="o", markersize=5, zorder=3)
        labels.append(f"all lanes {'of an eighth of the values' if binned else 'with this value'}")
        if others := [name for name in varied if name != axis]:
            what = ", ".join(others) if len(others) <= 2 else f"the other {len(others)} hyperparameters"
            labels[-1] += f", whatever {what}"
        if several:  # one seed has no interval
            if names is None:
                axes.fill_between(at, low, high, color=COLORS[0], alpha=0.15, linewidth=0, zorder=0)
            else:
                axes.vlines(at, low, high, color=COLORS[0], linewidth=2, zorder=3)
            labels[-1] += ", 95 % interval"
        else:
            labels[-1] += ": interquartile mean"
    scale(axes, axes.xaxis, places, names)
    return with_legend(figure, handles, labels, chosen.note)


def heat_map(lanes: pa.Table, x: str, y: str, metric: str = "eval_return") -> Figure:
    """The metric over a pair of axes: where lanes have most pairs of values a cell per pair, the interquartile mean of
    all its lanes, with its number where cells are few; else a dot per setting. Diverged lanes count as the worst,
    unsolved ones as the longest. A cross marks a setting, or a cell of settings, that halving stopped.
    """
    figure = Figure(figsize=(7, 5), layout="constrained")
    axes: Any = figure.subplots()
    if not len(lanes):
        return nothing(figure, "no lanes", axes)
    chosen, groups = metric_of(lanes, metric), by_setting(lanes)
    dress(axes, f"{chosen.name} by {x} and {y}", x, y)
    axes.grid(visible=False)
    (across, columns), (up, rows) = (ranks(lanes[name].to_pylist()) for name in (x, y))
    pair = up * len(columns) + across
    pairs = np.unique(pair)
    cells = 2 * len(pairs) > len(columns) * len(rows)
    if cells:
        means = [stats.interquartile_mean(part.tolist()).value for part in _parts(pair, chosen.values)]
        table = np.full(len(rows) * len(columns), np.nan)
        table[pairs] = means
        shown = _cells(axes, table.reshape(len(rows), len(columns)), columns, rows)
        handles = _cross_out(axes, lanes, across, up)
        label = "every setting of the cell was stopped at a rung"
    else:
        shown, handles = _dots(axes, lanes, x, y, chosen.values)
        label = "a setting that was stopped at a rung"
    several = len(lanes) > (len(pairs) if cells else len(groups))
    bar = figure.colorbar(shown, ax=axes, label=_mean_of(chosen.name, several))
    measured(bar.ax.yaxis, chosen.values)
    return with_legend(figure, handles, [label] * len(handles), chosen.note)


def _cells(axes: Axes, cells: np.ndarray, columns: list[str], rows: list[str]) -> Any:
    shown = axes.imshow(cells, origin="lower", aspect="auto", cmap=COLOR_MAP)
    label_of(axes.xaxis, columns)
    label_of(axes.yaxis, rows)
    if cells.size <= FEW_CELLS:
        low, high = np.nanmin(cells), np.nanmax(cells)
        for (i, j), value in np.ndenumerate(cells):
            if np.isfinite(value):
                bright = value > low + 0.6 * (high - low)
                axes.text(j, i, _number(value), ha="center", va="center", color="black" if bright else "white")
    return shown


def _cross_out(axes: Axes, lanes: pa.Table, across: np.ndarray, up: np.ndarray) -> list[Artist]:
    """Crosses in the corners of the cells none of whose settings went to the end, as a list of their one artist."""
    far = rungs(lanes)
    ended = np.isinf([far[config] for config in lanes["config"].to_pylist()])
    went = set(zip(across[ended].tolist(), up[ended].tolist(), strict=True))
    crossed = sorted(set(zip(across.tolist(), up.tolist(), strict=True)) - went)
    if not crossed:
        return []
    at = np.array(crossed, float)
    look: dict[str, Any] = {"c": "white", "edgecolors": "black", "linewidths": 0.6}  # can be seen on every colour
    return [axes.scatter(at[:, 0] - 0.38, at[:, 1] + 0.38, marker=STOPPED.upper(), s=36, **look)]


def _dots(axes: Axes, lanes: pa.Table, x: str, y: str, values: np.ndarray) -> tuple[Any, list[Artist]]:
    """The dots, or what else carries their colours, and the crosses, if there are any."""
    groups = by_setting(lanes)
    heights = np.array([stats.interquartile_mean(values[rows].tolist()).value for rows in groups.values()], float)
    stands = []
    for name, axis in ((x, axes.xaxis), (y, axes.yaxis)):
        places, names = places_of(lanes[name].to_pylist())
        stands.append(beside(np.array([places[rows[0]] for rows in groups.values()]), names))
        scale(axes, axis, places, names)
    order = np.argsort(heights)  # the best on top
    ended = np.array([np.isinf(rung) for rung in rungs(lanes).values()])[order]
    size = 70 if len(order) <= 100 else 18
    look: dict[str, Any] = {"cmap": COLOR_MAP, "vmin": heights.min(), "vmax": heights.max()}
    crosses, dots = order[~ended], order[ended]
    drawn: list[Any] = []
    if len(crosses):
        found = axes.scatter(
            stands[0][crosses], stands[1][crosses], c=heights[crosses], marker=STOPPED, s=0.6 * size, **look
        )
        drawn.append(found)
    look |= {"s": size, "edgecolors": "0.3", "linewidths": 0.3}
    return axes.scatter(stands[0][dots], stands[1][dots], c=heights[dots], **look), drawn


def _mean_of(name: str, several: bool) -> str:
    """What an axis shows, of one lane its value."""
    return f"{name},{' ' if len(name) <= 20 else chr(10)}interquartile mean" if several else name


def _parts(keys: np.ndarray, values: np.ndarray) -> list[np.ndarray]:
    """The values by key, in the order of the keys."""
    order = np.argsort(keys, kind="stable")
    _, begins = np.unique(keys[order], return_index=True)
    return np.split(values[order], begins[1:])


def _marginal(
    places: np.ndarray, values: np.ndarray, most: int
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray, bool]:
    """Per value, or per bin of about equally many lanes where there are more values than ``most``: where, the
    interquartile mean, the ends of its interval, and whether in bins. Lanes of one value are never parted.
    """
    distinct, which, counts = np.unique(places, return_inverse=True, return_counts=True)
    binned = len(distinct) > most
    if binned:
        which = np.minimum((np.cumsum(counts) - counts / 2) * BINS // len(places), BINS - 1)[which]
    at = [float(np.median(part)) for part in _parts(which, places)]
    found = [stats.interquartile_mean(part.tolist()) for part in _parts(which, values)]
    middle, low, high = np.array(found, float).T  # an end that does not exist is NaN
    return np.array(at), middle, low, high, binned


def _number(value: float) -> str:
    """A number in a cell: 0.123, 12.3, 123, 12.3k."""
    if abs(value) >= LARGE:
        return str(EngFormatter(places=1, sep="")(value))
    return f"{value:.3g}" if abs(value) < 100 else f"{value:.0f}"
