"""Statistics over seeds: what one may say of a setting after a handful of trainings."""

from __future__ import annotations

import copy
import functools
import statistics
from collections.abc import Callable, Iterable, Iterator, Sequence
from typing import Any, NamedTuple

import numpy as np

CONFIDENCE = 0.95
RESAMPLES = 2000


class Estimate(NamedTuple):
    """A value with the ends of its 95 % interval, which are None where there are too few seeds for one."""

    value: float | None
    low: float | None
    high: float | None


class Survival(NamedTuple):
    """Steps of a survival curve: share[i] of the seeds is unsolved from times[i] on. Arrays of one length.

    low and high are the ends of the 95 % interval of share, NaN where there is none.
    """

    times: np.ndarray
    share: np.ndarray
    low: np.ndarray
    high: np.ndarray


def share(successes: int, trials: int) -> Estimate:
    """Share of successes with Wilson's interval (Wilson, 1927). Raises ValueError without a trial.

    >>> share(8, 10).value
    0.8
    """
    if trials < 1:
        raise ValueError(f"trials: {trials} must be at least 1")
    interval = _scipy_stats().binomtest(successes, trials).proportion_ci(CONFIDENCE, method="wilson")
    return Estimate(successes / trials, float(interval.low), float(interval.high))


def mean(values: Sequence[float]) -> Estimate:
    """Mean with a percentile bootstrap interval over seeds.

    No value without a seed, no interval with one. Raises ValueError on a value that is not finite. Efron,
    *Bootstrap Methods: Another Look at the Jackknife*, 1979.
    """
    return _trimmed_mean("values", values, 0)


def median(values: Sequence[float]) -> Estimate:
    """Median, otherwise as ``mean``.

    >>> median([4.0, 1.0, 2.0, 100.0]).value
    3.0
    """
    return _trimmed_mean("values", values, (len(values) - 1) // 2)


def interquartile_mean(values: Sequence[float]) -> Estimate:
    """Mean of the middle half, otherwise as ``mean``.

    Agarwal et al., *Deep Reinforcement Learning at the Edge of the Statistical Precipice*, 2021.

    >>> interquartile_mean([0.0, 1.0, 3.0, 100.0]).value
    2.0
    """
    return _trimmed_mean("values", values, len(values) // 4)


def paired_difference(a: Sequence[float], b: Sequence[float]) -> Estimate:
    """Mean of a_i - b_i over the seeds i that both settings ran, otherwise as ``mean``: the pairs are resampled.

    Raises ValueError also when a and b differ in length.

    >>> paired_difference([3.0, 5.0], [1.0, 1.0]).value
    3.0
    """
    ours, theirs = _numbers("a", a), _numbers("b", b)
    if ours.size != theirs.size:
        raise ValueError(f"b: {theirs.size} values must be as many as those of a, {ours.size}")
    return _trimmed_mean("a - b", ours - theirs, 0)


def probability_of_improvement(a: Sequence[float], b: Sequence[float]) -> Estimate:
    """P(X > Y) + P(X = Y) / 2 for a seed X of a and a seed Y of b: Mann and Whitney's U over the number of pairs.

    The percentile bootstrap interval resamples the seeds of a and those of b independently. No value when either is
    empty, no interval when either has one seed. Infinite values are ranked. Raises ValueError on NaN. Agarwal et
    al., 2021.

    >>> probability_of_improvement([1.0, 3.0], [0.0, 3.0]).value
    0.625
    """
    ours, theirs = _numbers("a", a, infinite=True), _numbers("b", b, infinite=True)
    if not ours.size or not theirs.size:
        return Estimate(None, None, None)
    levels = np.unique(np.concatenate((ours, theirs)))
    x, y = (np.searchsorted(levels, np.sort(sample)) for sample in (ours, theirs))
    statistic = functools.partial(_improvement, levels=levels.size)
    value = float(statistic(x[None], y[None])[0])
    return Estimate(value, *(_bootstrap(statistic, x, y) if min(x.size, y.size) > 1 else (None, None)))


def median_time(times: Sequence[float | None]) -> float | None:
    """Median time to success over all seeds, where those that never succeeded (None) count as later than all others.

    None when half of the seeds or more never succeeded: the median is then beyond what was watched. Raises ValueError
    on NaN.

    >>> median_time([10, None, 30])
    30.0
    """
    if not times:
        return None
    middle = float(np.median(_numbers("times", [np.inf if time is None else time for time in times], infinite=True)))
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


def kaplan_meier_median(times: Sequence[float], observed: Sequence[bool]) -> Estimate:
    """Median time to success, the first t with S(t) <= 1/2, which counts seeds that were not watched to the end.

    S is ``survival``'s curve, and the arguments and what is raised are its too. The interval inverts that of S: its
    ends are the first t with low(t) <= 1/2 and with high(t) <= 1/2. Value and ends are None beyond what was watched;
    no interval with one seed. Brookmeyer & Crowley, *A Confidence Interval for the Median Survival Time*, 1982.

    >>> kaplan_meier_median([10, 20, 30], [True, False, True]).value
    30.0
    """
    curve = survival(times, observed)
    # S is a product of fractions: where it is exactly 1/2, rounding may leave it just above
    reached = (np.flatnonzero(row <= 0.5 + 1e-10) for row in (curve.share, curve.low, curve.high))
    return Estimate(*(float(curve.times[steps[0]]) if steps.size else None for steps in reached))


def survival(times: Sequence[float], observed: Sequence[bool]) -> Survival:
    """Kaplan and Meier's share of seeds still unsolved after each of the times, from time 0 with share 1.

    Seed i was solved at times[i] where observed[i], else last seen there unsolved: at infinity, it outlasts all
    others. S(t) = prod (1 - d_j / n_j) over the t_j <= t, at which d_j of n_j seeds still watched were solved. Its
    interval is Greenwood's, made for log(-log(S)): S^exp(+-z s) with s^2 = sum d_j / (n_j (n_j - d_j)) / log(S)^2.
    This is void at share 1 (NaN); at share 0, low is 0 and high stays what it was. Empty arrays without a seed, no
    interval with one. Raises ValueError on NaN, negative times, a success at infinity and unequal lengths.
    Kalbfleisch & Prentice, *The Statistical Analysis of Failure Time Data*, 1980.
    """
    ended, solved = _numbers("times", times, infinite=True), np.asarray(observed, bool)
    if ended.size != solved.size:
        raise ValueError(f"observed: {solved.size} values must be as many as the times, {ended.size}")
    if (ended < 0).any():
        raise ValueError(f"times: {ended.min()} must be at least 0")
    if np.isinf(ended[solved]).any():
        raise ValueError("times: inf must not be observed, as it is no time of success")
    if not ended.size:
        return Survival(*np.empty((4, 0)))

    at, row, seeds = np.unique(ended, return_inverse=True, return_counts=True)
    at, seeds = np.insert(at, 0, 0.0), np.insert(seeds, 0, 0)
    successes = np.bincount(row[solved] + 1, minlength=at.size)
    watched = ended.size - np.cumsum(seeds) + seeds
    share = np.cumprod((watched - successes) / watched)
    low, high = np.full((2, at.size), np.nan)
    if ended.size > 1:
        inside = (share > 0) & (share < 1)  # of the other rows, those before have no success and one may come after
        d, n, within = successes[inside], watched[inside], share[inside]
        z = statistics.NormalDist().inv_cdf((1 + CONFIDENCE) / 2)
        width = z * np.sqrt(np.cumsum(d / (n * (n - d)))) / -np.log(within)
        low[inside], high[inside] = within ** np.exp(width), within ** np.exp(-width)
        if share[-1] == 0:
            low[-1], high[-1] = 0, high[-2]
    finite = np.isfinite(at)
    return Survival(at[finite], share[finite], low[finite], high[finite])


def area_under_curve(steps: Sequence[float], values: Sequence[float], end: float) -> float | None:
    """Area under the learning curve of one lane over its length: the average of a piecewise constant curve.

    sum_i values[i] (steps[i + 1] - steps[i]) / (end - steps[0]), where end follows the last step: before the first
    nothing is known. Values of NaN are left out as if not there. None without a value, and the value itself where
    the curve has no length. Raises ValueError when the numbers of steps and values differ, steps do not rise, end is
    before the last or anything else is not finite.

    >>> area_under_curve([100, 200, 400], [0.0, 1.0, 4.0], 500)
    1.5
    """
    at, heights = _numbers("steps", steps), np.asarray(values, float)
    if at.size != heights.size:
        raise ValueError(f"values: {heights.size} must be as many as the steps, {at.size}")
    known = ~np.isnan(heights)
    at, heights = at[known], _numbers("values", np.where(known, heights, 0.0))[known]
    if not at.size:
        return None
    lengths = np.diff(at, append=_numbers("end", [end]))
    if (lengths[:-1] <= 0).any():
        raise ValueError(f"steps: {at.tolist()} must rise")
    if lengths[-1] < 0:
        raise ValueError(f"end: {end} must be at least the last step, {at[-1]}")
    return float(heights @ lengths / lengths.sum()) if lengths.any() else float(heights[0])


def _numbers(name: str, values: Sequence[float] | np.ndarray, infinite: bool = False) -> np.ndarray:
    """The values as an array. Raises ValueError on NaN and, unless ``infinite``, on infinite ones."""
    array = np.asarray(values, float)
    wrong = np.flatnonzero(np.isnan(array) if infinite else ~np.isfinite(array))
    if wrong.size:
        raise ValueError(f"{name}[{wrong[0]}]: {array[wrong[0]]} must be a {'' if infinite else 'finite '}number")
    return array


def _trimmed_mean(name: str, values: Sequence[float] | np.ndarray, cut: int) -> Estimate:
    """Mean of the sorted values less ``cut`` at either end: the mean, the interquartile mean and the median."""
    ordered = np.sort(_numbers(name, values))
    if not ordered.size:
        return Estimate(None, None, None)
    kept = slice(cut, ordered.size - cut)
    value = float(ordered[kept].mean())
    if ordered.size == 1:
        return Estimate(value, None, None)
    return Estimate(value, *_bootstrap(lambda rows: rows[:, kept].mean(1), ordered))


def _improvement(x: np.ndarray, y: np.ndarray, levels: int) -> np.ndarray:
    """P(X > Y) + P(X = Y) / 2 in each row of x [rows, n] and y [rows, m], integers below ``levels``."""
    first = levels * np.arange(len(x))[:, None]
    counts = (np.bincount((first + z).ravel(), minlength=first.size * levels).reshape(-1, levels) for z in (x, y))
    ours, theirs = counts
    return (ours * (theirs.cumsum(1) - theirs / 2)).sum(1) / (x.shape[1] * y.shape[1])


def _bootstrap(statistic: Callable[..., np.ndarray], *samples: np.ndarray) -> tuple[float, float]:
    """Ends of the percentile bootstrap interval: scipy.stats.bootstrap's, without its cost.

    ``statistic`` gives [rows] for resamples [rows, n] of each sample [n], sorted when that is.
    """
    sizes = tuple(sample.size for sample in samples)
    # a sweep asks for the same few sizes thousands of times; 32 of them are at most 128 MB
    drawn = _kept_resamples(sizes) if sum(sizes) <= 256 else _resamples(sizes)
    values = [statistic(*map(np.take, samples, rows)) for rows in drawn]
    low, high = np.quantile(np.concatenate(values), [(1 - CONFIDENCE) / 2, (1 + CONFIDENCE) / 2])
    return float(low), float(high)


def _resamples(sizes: tuple[int, ...]) -> Iterator[list[np.ndarray]]:
    """Indices [rows, n] of the resamples of samples of these sizes, each row sorted, RESAMPLES rows in all."""
    batch = max(1, 400_000 // sum(sizes))
    batches = [min(batch, RESAMPLES - start) for start in range(0, RESAMPLES, batch)]
    rngs = [np.random.default_rng(0)]  # the same data give the same interval
    for size in sizes[:-1]:  # as scipy draws: each sample where the one before has ended
        rngs.append(copy.deepcopy(rngs[-1]))
        for rows in batches:
            rngs[-1].integers(size, size=(rows, size))
    for rows in batches:
        yield [np.sort(rng.integers(size, size=(rows, size))) for rng, size in zip(rngs, sizes, strict=True)]


@functools.lru_cache(maxsize=32)
def _kept_resamples(sizes: tuple[int, ...]) -> Iterable[list[np.ndarray]]:
    return list(_resamples(sizes))


def _scipy_stats() -> Any:
    """scipy.stats, whose import takes almost half a second that a run of one seed need not wait for."""
    from scipy import stats

    return stats
