"""Where the values of a hyperparameter stand on an axis, its scale and its ticks."""

from __future__ import annotations

import itertools
import re
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.ticker import AutoLocator, FixedLocator, FuncFormatter, LogLocator, NullLocator

#: Positive values that span more than this many times may have a logarithmic scale.
WIDE = 9
#: An axis of at most so many numbers has a tick for each.
FEW_VALUES = 12
#: Each of a few values has a tick where they are further apart than this part of the axis.
CLOSE = 0.08
#: Letters in a line of a tick's name, and in all of them side by side.
LONGEST, ACROSS = 30, 62


def places_of(column: list[Any]) -> tuple[np.ndarray, list[str] | None]:
    """Where the values of an axis stand: numbers where they are, others side by side with their names as ticks."""
    if all(isinstance(value, (int, float)) and not isinstance(value, bool) for value in column):
        return np.asarray(column, float), None
    found, names = ranks(column)
    return found.astype(float), names


def ranks(column: list[Any]) -> tuple[np.ndarray, list[str]]:
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


def beside(x: np.ndarray, names: list[str] | None) -> np.ndarray:
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


def scale(axes: Axes, axis: Any, places: np.ndarray, names: list[str] | None) -> None:
    """Names as ticks, or a scale and ticks for a hyperparameter's numbers, written as they are: 0.99, not 990m."""
    across = axis.axis_name == "x"
    if names is not None:
        label_of(axis, names)
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
    """Whether a logarithmic scale spreads the values more evenly, as it does what was drawn from a range of that scale.
    Two values are even on both.
    """
    if places.min() <= 0 or places.max() <= WIDE * places.min():
        return False
    distinct = np.unique(places)
    return _unevenness(np.log(distinct)) <= _unevenness(distinct) + 1e-9


def _unevenness(values: np.ndarray) -> float:
    """How far at most a sorted value is from where it would stand if all were evenly spaced, as a part of the range."""
    even = np.linspace(values[0], values[-1], len(values))
    return float(np.abs(values - even).max() / (values[-1] - values[0]))


def label_of(axis: Any, names: list[str]) -> None:
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
