"""Statistics over seeds: what one may say of a setting after a handful of trainings."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import numpy as np

CONFIDENCE = 0.95
RESAMPLES = 2000


class Estimate(NamedTuple):
    """A value with the ends of its 95 % interval, which are None where there are too few seeds for one."""

    value: float | None
    low: float | None
    high: float | None


def share(successes: int, trials: int) -> Estimate:
    """Share of successes with Wilson's interval (Wilson, 1927). Raises ValueError without a trial.

    >>> share(8, 10).value
    0.8
    """
    if trials < 1:
        raise ValueError(f"trials: {trials} must be at least 1")
    interval = _scipy_stats().binomtest(successes, trials).proportion_ci(CONFIDENCE, method="wilson")
    return Estimate(successes / trials, float(interval.low), float(interval.high))


def interquartile_mean(values: Sequence[float]) -> Estimate:
    """Mean of the middle half with a percentile bootstrap interval over seeds.

    Agarwal et al., *Deep Reinforcement Learning at the Edge of the Statistical Precipice*, 2021. No value without a
    seed, no interval with one.

    >>> interquartile_mean([0.0, 1.0, 3.0, 100.0]).value
    2.0
    """
    array = np.asarray(values, float)
    if array.size == 0:
        return Estimate(None, None, None)
    if array.size == 1:
        return Estimate(float(array[0]), None, None)
    value = float(_scipy_stats().trim_mean(array, 0.25))
    return Estimate(value, *_bootstrap(array, _iqm))


def median_time(times: Sequence[float | None]) -> float | None:
    """Median time to success over all seeds, where those that never succeeded (None) count as later than all others.

    None when half of the seeds or more never succeeded: the median is then beyond what was watched.

    >>> median_time([10, None, 30])
    30.0
    """
    if not times:
        return None
    middle = float(np.median([np.inf if time is None else time for time in times]))
    return middle if np.isfinite(middle) else None


def time_to_success(times: Sequence[float | None]) -> Estimate:
    """``median_time`` with the interval between two of the sorted times, which holds for every distribution.

    How many of n times are below the true median is binomial (n, 1/2), so the ends are the k-th time from either side
    for the largest k that leaves at most 2.5 % outside: scipy's ``quantile_test``. An end is None where it lies beyond
    what was watched, and both are where there are too few times. Conover, *Practical Nonparametric Statistics*, 1999.
    """
    ordered = [np.inf if time is None else time for time in times]
    value = median_time(times)
    if not times:
        return Estimate(None, None, None)
    interval = _scipy_stats().quantile_test(ordered, p=0.5).confidence_interval(CONFIDENCE)
    low, high = (float(end) if np.isfinite(end) else None for end in interval)
    return Estimate(value, low, high)


def mean(values: Sequence[float]) -> Estimate:
    """Mean with a percentile bootstrap interval over seeds. No value without a seed, no interval with one."""
    if len(values) < 2:
        return Estimate(float(values[0]) if values else None, None, None)
    return Estimate(float(np.mean(values)), *_bootstrap(np.asarray(values, float), np.mean))


def _bootstrap(array: np.ndarray, statistic: Callable[..., Any]) -> tuple[float, float]:
    """Ends of the percentile bootstrap interval of ``statistic(sample, axis=...)``."""
    interval = (
        _scipy_stats()
        .bootstrap(
            (array,),
            statistic,
            n_resamples=RESAMPLES,
            confidence_level=CONFIDENCE,
            method="percentile",
            vectorized=True,
            rng=np.random.default_rng(0),  # the same data give the same interval
            batch=max(1, 4_000_000 // array.size),
        )
        .confidence_interval
    )
    return float(interval.low), float(interval.high)


def _iqm(sample: np.ndarray, axis: int) -> np.ndarray:
    return np.asarray(_scipy_stats().trim_mean(sample, 0.25, axis=axis))


def _scipy_stats() -> Any:
    """scipy.stats, whose import takes almost half a second that a run of one seed need not wait for."""
    from scipy import stats

    return stats
