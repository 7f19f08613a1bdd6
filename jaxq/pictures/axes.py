"""What each hyperparameter does: the metric over one axis, and over a pair of them."""

from __future__ import annotations

import itertools
import re
from collections.abc import Sequence
from typing import Any

import numpy as np
import pyarrow as pa
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import AutoLocator, EngFormatter, FixedLocator, FuncFormatter, LogLocator, NullLocator

from jaxq import stats
from jaxq.pictures.columns import by_setting, metric_of
from jaxq.pictures.dress import COLOR_MAP, COLORS, LARGE, dress, measured, nothing, with_legend

#: Positive values that span more than this many times have a logarithmic scale.
WIDE = 9
#: An axis of more numbers than this is averaged in as many bins as ``BINS``, a grid of more cells has no numbers.
FEW_VALUES, BINS, FEW_CELLS = 12, 8, 120
#: More settings than this are dots without intervals.
FEW_SETTINGS = 40
#: Each of a few values has a tick where they are further apart than this part of the axis.
CLOSE = 0.08
#: Letters in a line of a tick's name, and in all of them side by side.
LONGEST, ACROSS = 30, 62


def sensitivity(lanes: pa.Table, axis: str, varied: Sequence[str], metric: str = "eval_return") -> Figure:
    """The metric over one axis: a dot per setting, its interquartile mean over seeds (with its 95 % interval where
    there are few), and a line, the interquartile mean of all lanes with that value whatever else is ``varied``, or of
    an eighth of them where values are many; names are not joined by a line. Settings of one value stand beside each
    other. Diverged lanes count as the worst, unsolved ones as the longest.
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
    places, names = _places(lanes[axis].to_pylist())
    x = _beside(np.array([places[rows[0]] for rows in groups.values()]), names)
    heights = np.array([estimate.value for estimate in estimates], float)
    few = len(groups) <= FEW_SETTINGS
    handles = axes.plot(x, heights, ".", color="0.55", markersize=7 if few else 3, alpha=0.9 if few else 0.5, zorder=2)
    labels = ["a setting" if several else "a setting, its one seed"]
    if few and several:
        low, high = (np.array([getattr(one, end) for one in estimates], float) for end in ("low", "high"))
        axes.vlines(x, low, high, color="0.75", linewidth=1, zorder=1)
        labels[0] += ", with its 95 % interval over seeds"
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
    _scale(axes, axes.xaxis, places, names)
    return with_legend(figure, handles, labels, chosen.note)


def heat_map(lanes: pa.Table, x: str, y: str, metric: str = "eval_return") -> Figure:
    """The metric over a pair of axes: where lanes have most pairs of values a cell per pair, the interquartile mean of
    all its lanes, with its number where cells are few; else a dot per setting. Diverged lanes count as the worst,
    unsolved ones as the longest.
    """
    figure = Figure(figsize=(7, 5), layout="constrained")
    axes: Any = figure.subplots()
    if not len(lanes):
        return nothing(figure, "no lanes", axes)
    chosen, groups = metric_of(lanes, metric), by_setting(lanes)
    dress(axes, f"{chosen.name} by {x} and {y}", x, y)
    axes.grid(visible=False)
    (across, columns), (up, rows) = (_ranks(lanes[name].to_pylist()) for name in (x, y))
    pair = up * len(columns) + across
    pairs = np.unique(pair)
    cells = 2 * len(pairs) > len(columns) * len(rows)
    if cells:
        means = [stats.interquartile_mean(part.tolist()).value for part in _parts(pair, chosen.values)]
        table = np.full(len(rows) * len(columns), np.nan)
        table[pairs] = means
        shown = _cells(axes, table.reshape(len(rows), len(columns)), columns, rows)
    else:
        shown = _dots(axes, lanes, x, y, chosen.values)
    several = len(lanes) > (len(pairs) if cells else len(groups))
    bar = figure.colorbar(shown, ax=axes, label=_mean_of(chosen.name, several))
    measured(bar.ax.yaxis, chosen.values)
    return with_legend(figure, [], [], chosen.note)


def _cells(axes: Axes, cells: np.ndarray, columns: list[str], rows: list[str]) -> Any:
    shown = axes.imshow(cells, origin="lower", aspect="auto", cmap=COLOR_MAP)
    _label(axes.xaxis, columns)
    _label(axes.yaxis, rows)
    if cells.size <= FEW_CELLS:
        low, high = np.nanmin(cells), np.nanmax(cells)
        for (i, j), value in np.ndenumerate(cells):
            if np.isfinite(value):
                bright = value > low + 0.6 * (high - low)
                axes.text(j, i, _number(value), ha="center", va="center", color="black" if bright else "white")
    return shown


def _dots(axes: Axes, lanes: pa.Table, x: str, y: str, values: np.ndarray) -> Any:
    groups = by_setting(lanes)
    heights = np.array([stats.interquartile_mean(values[rows].tolist()).value for rows in groups.values()], float)
    stands = []
    for name, axis in ((x, axes.xaxis), (y, axes.yaxis)):
        places, names = _places(lanes[name].to_pylist())
        stands.append(_beside(np.array([places[rows[0]] for rows in groups.values()]), names))
        _scale(axes, axis, places, names)
    order = np.argsort(heights)  # the best on top
    size = 70 if len(order) <= 100 else 18
    look: dict[str, Any] = {"cmap": COLOR_MAP, "s": size, "edgecolors": "0.3", "linewidths": 0.3}
    return axes.scatter(stands[0][order], stands[1][order], c=heights[order], **look)


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


def _places(column: list[Any]) -> tuple[np.ndarray, list[str] | None]:
    """Where the values of an axis stand: numbers where they are, others side by side with their names as ticks."""
    if all(isinstance(value, (int, float)) and not isinstance(value, bool) for value in column):
        return np.asarray(column, float), None
    ranks, names = _ranks(column)
    return ranks.astype(float), names


def _ranks(column: list[Any]) -> tuple[np.ndarray, list[str]]:
    """The rank of each value among the different ones, and their names; null has a place of its own. Layer sizes are in
    the order of their numbers: 64,64 before 128.
    """

    def place(value: Any) -> tuple[Any, ...]:
        if not isinstance(value, str):
            return value is None, 0, (), value
        sizes = re.fullmatch(r"\d+(,\d+)*", value)
        return False, 1 if sizes else 2, tuple(map(int, value.split(","))) if sizes else (), value

    distinct = sorted(set(column), key=place)
    rank = {value: i for i, value in enumerate(distinct)}
    names = [
        f"{value:g}" if isinstance(value, float) else "none" if value is None else str(value) for value in distinct
    ]
    return np.array([rank[value] for value in column]), names


def _beside(x: np.ndarray, names: list[str] | None) -> np.ndarray:
    """Settings of one value stand beside each other, evenly and in no order, in less than the room up to the next one;
    of numbers as they are spaced on their axis.
    """
    distinct, which, counts = np.unique(x, return_inverse=True, return_counts=True)
    if names is None and (len(distinct) == 1 or len(distinct) > FEW_VALUES):
        return x
    wide = names is None and _is_wide(x)
    scaled = np.log(x) if wide else x
    room = 0.22
    if names is None:
        gaps = np.diff(np.log(distinct) if wide else distinct)
        room = min(0.25 * gaps.min(), 0.025 * gaps.sum())
    rng = np.random.default_rng(0)
    shifts = np.zeros(len(x))
    for i in np.flatnonzero(counts > 1):
        shifts[which == i] = rng.permutation(np.linspace(-room, room, counts[i]))
    return np.exp(scaled + shifts) if wide else scaled + shifts


def _scale(axes: Axes, axis: Any, places: np.ndarray, names: list[str] | None) -> None:
    """Names as ticks, or a scale and ticks for a hyperparameter's numbers, written as they are: 0.99, not 990m."""
    across = axis.axis_name == "x"
    if names is not None:
        _label(axis, names)
        (axes.set_xlim if across else axes.set_ylim)(-0.5, len(names) - 0.5)
        return
    wide, distinct = _is_wide(places), np.unique(places)
    if wide:
        (axes.set_xscale if across else axes.set_yscale)("log")
    gaps = np.diff(np.log(distinct) if wide else distinct)
    if len(distinct) <= FEW_VALUES and (not len(gaps) or gaps.min() >= CLOSE * gaps.sum()):
        axis.set_major_locator(FixedLocator(distinct.tolist()))
    else:
        axis.set_major_locator(LogLocator(subs=(1.0, 3.0)) if wide else AutoLocator())
    axis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:.6g}"))
    axis.set_minor_locator(NullLocator())


def _is_wide(places: np.ndarray) -> bool:
    return bool(places.min() > 0 and places.max() > WIDE * places.min())


def _label(axis: Any, names: list[str]) -> None:
    """Names as ticks, at most some twenty of them. Long ones are broken, and where that is not enough turned: the
    figure grows by their height.
    """
    at = list(range(0, len(names), -(-len(names) // 20)))
    if axis.axis_name == "y":
        axis.set_ticks(at, [_broken(names[i], LONGEST) for i in at])
        return
    room = ACROSS // len(at)
    shown = [_broken(names[i], max(8, room - 2)) for i in at]
    widths = [max(map(len, name.split("\n"))) for name in shown]
    if all(one + other <= 2 * (room - 1) for one, other in itertools.pairwise(widths)):
        axis.set_ticks(at, shown)
        return
    shown = [_broken(names[i], LONGEST) for i in at]
    axis.set_ticks(at, shown, rotation=45, ha="right", rotation_mode="anchor")
    figure = axis.get_figure()
    figure.set_figheight(figure.get_figheight() + 0.06 * max(len(line) for name in shown for line in name.split("\n")))


def _broken(name: str, letters: int) -> str:
    """Lines of at most so many letters where the name has an underscore, comma, point or dash to be broken at; without
    its middle where it is longer than two of the longest lines.
    """
    if len(name) > 2 * LONGEST:
        name = f"{name[: LONGEST - 2]}...{name[2 - LONGEST :]}"
    if len(name) <= letters:
        return name
    lines = [""]
    for piece in re.findall(rf"[^_,.-]{{1,{LONGEST}}}[_,.-]*|[_,.-]+", name):
        if lines[-1] and len(lines[-1]) + len(piece) > letters:
            lines.append("")
        lines[-1] += piece
    return "\n".join(lines)


def _number(value: float) -> str:
    """A number in a cell: 0.123, 12.3, 123, 12.3k."""
    if abs(value) >= LARGE:
        return str(EngFormatter(places=1, sep="")(value))
    return f"{value:.3g}" if abs(value) < 100 else f"{value:.0f}"
