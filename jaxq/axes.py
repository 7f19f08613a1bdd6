"""Axes of a sweep, and the points that a method takes on them. Imports no jax, and scipy for Sobol's points alone."""

from __future__ import annotations

import itertools
import math
import sys
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Literal

from jaxq.suggest import nearest

if TYPE_CHECKING:
    import numpy as np

METHODS = ("grid", "random", "sobol", "list")
#: Points of a random or quasi-random sweep that does not say how many.
SAMPLES = 32
MAX_SETTINGS = 1_000_000


@dataclass(frozen=True)
class Range:
    """An interval that a random or quasi-random sweep draws from, evenly on a linear or a logarithmic scale.

    Ends that are both whole numbers make a range of whole numbers, ends included. Raises ValueError for ends that do
    not rise or are not finite, for a logarithmic scale from 0 or below, and for an unknown scale.
    """

    min: float
    max: float
    scale: Literal["linear", "log"] = "linear"

    def __post_init__(self) -> None:
        for end in (self.min, self.max):
            if isinstance(end, bool) or not isinstance(end, (int, float)) or not abs(end) <= sys.float_info.max:
                raise ValueError(f"range: {end!r} is not allowed: a finite number")
        if self.scale not in ("linear", "log"):
            raise ValueError(f"scale: {self.scale!r} is unknown{nearest(str(self.scale), ('linear', 'log'))}")
        if self.min >= self.max:
            raise ValueError(f"range: min {self.min} must be below max {self.max}")
        if self.scale == "log" and self.min <= 0:
            raise ValueError(f"range: min {self.min} must be above 0 on a log scale")

    def at(self, u: float) -> float:
        """The value at u in [0, 1): min + u (max - min), or min (max / min)^u. Six digits, so that it can be read.

        >>> Range(1e-4, 1e-2, "log").at(0.5), Range(1, 3).at(0.99)
        (0.001, 3)
        """
        whole = isinstance(self.min, int) and isinstance(self.max, int)
        low, high = (self.min - 0.5, self.max + 0.5) if whole else (self.min, self.max)
        value = low + u * (high - low) if self.scale == "linear" else low * (high / low) ** u
        if whole:
            return min(max(round(value), self.min), self.max)
        return min(max(float(f"{value:.6g}"), self.min), self.max)


Axis = Range | Sequence[Any]


def points(axes: Mapping[str, Axis], method: str, samples: int, seed: int) -> list[dict[str, Any]]:
    """The settings that a method makes of the axes, each a value per name.

    ``grid`` is the product, the last axis fastest; ``random`` draws ``samples`` settings, independently; ``sobol``
    takes as many of a scrambled Sobol sequence, which covers the axes evenly. An axis of values is drawn from with
    equal chances. What is drawn twice stands once. The same seed gives the same points. Sobol, *On the Distribution of
    Points in a Cube*, 1967; Owen, *Scrambling Sobol' and Niederreiter-Xing Points*, 1998.

    Raises ValueError for a range in a grid and for more than a million settings.
    """
    names = list(axes)
    if method == "grid":
        for name, axis in axes.items():
            if isinstance(axis, Range):
                raise ValueError(f"{name}: a range needs the method random or sobol")
        count = math.prod(len(axis) for axis in axes.values() if not isinstance(axis, Range))
        if count > MAX_SETTINGS:
            raise ValueError(f"settings: {count} is not allowed: at most {MAX_SETTINGS}")
        return [dict(zip(names, point, strict=True)) for point in itertools.product(*axes.values())]  # type: ignore[arg-type]
    varied = [name for name, axis in axes.items() if isinstance(axis, Range) or len(axis) > 1]
    drawn = _unit_cube(method, len(varied), samples, seed)
    found: dict[tuple[Any, ...], dict[str, Any]] = {}
    for row in drawn:
        at = dict(zip(varied, row.tolist(), strict=True))
        point = {name: _value(axis, at.get(name, 0.0)) for name, axis in axes.items()}
        found.setdefault(tuple(map(str, point.values())), point)
    return list(found.values())


def _value(axis: Axis, u: float) -> Any:
    return axis.at(u) if isinstance(axis, Range) else axis[int(u * len(axis))]


def _unit_cube(method: str, dimensions: int, samples: int, seed: int) -> np.ndarray:
    """[samples, dimensions] numbers in [0, 1)."""
    import numpy as np  # here: --help does not wait for it

    if dimensions == 0:
        return np.zeros((1, 0))
    if method == "random":
        return np.random.default_rng(seed).random((samples, dimensions))
    from scipy.stats import qmc

    sequence = qmc.Sobol(dimensions, scramble=True, rng=seed)
    return np.asarray(sequence.random_base2(max(0, math.ceil(math.log2(samples))))[:samples])
