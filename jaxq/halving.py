"""Successive halving: settings are compared at rungs, and the worst of them stop there.

With factor 3 a third of the settings pass each rung and the next is three times as far: rung k of n settings lies at
1 / factor^(K - k) of a lane's limit, K = floor(log(n) / log(factor)), k = 0 .. K - 1. Fewer rungs leave out the first
ones, where early trainings tell little. Every lane of a setting comes to
the rung before any is judged, so what is decided depends on results alone, not on which lane was quicker.

Jamieson and Talwalkar, *Non-stochastic Best Arm Identification and Hyperparameter Optimization*, 2016.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np

from jaxq.settings import NO_LIMIT
from jaxq.tally import PauseAt


class Rung(NamedTuple):
    """Where settings are compared: at this part of a lane's limit."""

    number: int
    fraction: float


def rungs(settings: int, factor: int, most: int | None = None) -> list[Rung]:
    """The rungs of so many settings, the last ``most`` of them; none where settings are fewer than ``factor``.

    >>> [round(1 / rung.fraction) for rung in rungs(27, 3)]
    [27, 9, 3]
    """
    count = 0
    while factor ** (count + 1) <= settings:
        count += 1
    count = count if most is None else min(count, most)
    return [Rung(k, factor ** (k - count)) for k in range(count)]


def pause_at(settings: Any, rung: Rung) -> PauseAt:
    """Where a lane waits: at a part of its env steps where they are limited, else of its episodes.

    Raises ValueError for settings without either limit.
    """
    if settings.max_env_steps < NO_LIMIT:
        return PauseAt(math.ceil(settings.max_env_steps * rung.fraction), math.inf)
    if settings.max_episodes < NO_LIMIT:
        return PauseAt(math.inf, math.ceil(settings.max_episodes * rung.fraction))
    raise ValueError("halving: needs a limit, max_env_steps or max_episodes")


def score(returns: Sequence[float | None]) -> float:
    """What settings are compared by: the interquartile mean over seeds of the greedy return, -inf for a diverged one.

    >>> score([0.0, 1.0, 3.0, 100.0])
    2.0
    """
    ordered = np.sort([-math.inf if value is None else value for value in returns])
    cut = len(ordered) // 4
    return float(ordered[cut : len(ordered) - cut].mean())


def kept(scores: Mapping[int, float], factor: int) -> list[int]:
    """The settings that go on: the best of each ``factor``, rounded up; of equals those that come first."""
    best = sorted(scores, key=lambda config: (-scores[config], config))
    return sorted(best[: math.ceil(len(best) / factor)])
