"""Statistics against hand-worked and published numbers, scipy and rliable."""

import json
import math
import pathlib
import subprocess
import sys

import numpy as np
import pytest
import scipy.stats
from hypothesis import given, settings
from hypothesis import strategies as st

from jaxq import stats

RLIABLE = json.loads((pathlib.Path(__file__).parent / "reference" / "rliable.json").read_text())
NUMBERS = st.lists(st.integers(-20, 20).map(float), min_size=2, max_size=12)
SEEDS = st.lists(st.tuples(st.integers(1, 12).map(float), st.booleans()), min_size=2, max_size=12)
QUICK = settings(max_examples=60, deadline=None)
AVERAGES = {
    "mean": (stats.mean, np.mean),
    "median": (stats.median, np.median),
    "interquartile_mean": (stats.interquartile_mean, lambda x, axis: scipy.stats.trim_mean(x, 0.25, axis=axis)),
}


def over_pairs(x, y, axis):
    """P(X > Y) + P(X = Y) / 2 of rows of x and of y, pair by pair."""
    assert axis == -1
    x, y = x[..., :, None], y[..., None, :]
    return np.mean((x > y) + (x == y) / 2, axis=(-2, -1))


def scipys_interval(samples, statistic, **options):
    """What jaxq.stats draws and how it takes percentiles, by scipy."""
    interval = scipy.stats.bootstrap(
        samples,
        statistic,
        n_resamples=stats.RESAMPLES,
        method="percentile",
        vectorized=True,
        rng=np.random.default_rng(0),
        **options,
    ).confidence_interval
    return [interval.low, interval.high]


def test_wilsons_interval_by_hand():
    # (p + z^2/2n +- z sqrt(p(1-p)/n + z^2/4n^2)) / (1 + z^2/n), z = 1.959964, p = 0.9, n = 10
    estimate = stats.share(9, 10)
    z, p, n = 1.959964, 0.9, 10
    middle, half = p + z * z / (2 * n), z * np.sqrt(p * (1 - p) / n + z * z / (4 * n * n))
    scale = 1 + z * z / n
    assert estimate.value == 0.9
    assert estimate.low == pytest.approx((middle - half) / scale, abs=1e-6)
    assert estimate.high == pytest.approx((middle + half) / scale, abs=1e-6)


def test_a_share_of_nothing_is_refused():
    with pytest.raises(ValueError, match="at least 1"):
        stats.share(0, 0)


def test_the_averages_by_hand():
    values = [1e9, 1, 2, 3, 4, 5, 6, -1e9]
    assert stats.interquartile_mean(values).value == np.mean([2, 3, 4, 5])
    assert stats.median(values).value == 3.5
    assert stats.median(values[1:]).value == 3
    assert stats.mean(values).value == 21 / 8
    assert stats.paired_difference([5, 7, 9], [1, 2, 0]).value == 6  # of 4, 5 and 9


@pytest.mark.parametrize("size", [2, 5, 16, 300, 3000])  # kept resamples, drawn ones, and more batches than one
@pytest.mark.parametrize("average", AVERAGES)
def test_an_average_and_its_interval_are_scipys(average, size):
    ours, theirs = AVERAGES[average]
    values = np.random.default_rng(size).normal(size=size)
    estimate = ours(values.tolist())
    assert estimate.value == pytest.approx(theirs(values, axis=0), rel=1e-12)
    np.testing.assert_allclose(estimate[1:], scipys_interval((np.sort(values),), theirs), rtol=1e-11)


def test_the_paired_difference_is_scipys_with_pairs_resampled():
    a, b = np.random.default_rng(0).normal(size=(2, 12)) + [[1], [0]]
    order = np.argsort(a - b)

    def difference(x, y, axis):
        return np.mean(x - y, axis=axis)

    estimate = stats.paired_difference(a, b)
    assert estimate.value == pytest.approx(np.mean(a) - np.mean(b), rel=1e-12)
    np.testing.assert_allclose(estimate[1:], scipys_interval((a[order], b[order]), difference, paired=True), rtol=1e-11)


def test_pairing_seeds_takes_out_what_they_share():
    rng = np.random.default_rng(2)
    shared, noise = rng.normal(0, 10, 20), rng.normal(0, 1, (2, 20))
    paired = stats.paired_difference(shared + noise[0] + 2, shared + noise[1])
    assert paired.high - paired.low < 0.3 * np.ptp(stats.mean(shared)[1:])
    assert 0 < paired.low < 2 < paired.high


def test_the_probability_of_improvement_by_hand():
    # of the 6 pairs 3 > 1, 3 > 2, 2 > 1 and 3 = 3, 2 = 2 (halves), 2 < 3: (3 + 2 / 2) / 6
    assert stats.probability_of_improvement([2, 3], [1, 2, 3]).value == 4 / 6
    assert stats.probability_of_improvement([4, 5], [1, 2, 3]) == (1, 1, 1)
    assert stats.probability_of_improvement([1, 1], [1, 1]) == (0.5, 0.5, 0.5)
    assert stats.probability_of_improvement([np.inf, 0], [-np.inf, 0]).value == 3.5 / 4


@pytest.mark.parametrize(("n", "m"), [(2, 2), (16, 12), (5, 30), (200, 60)])
def test_the_probability_of_improvement_and_its_interval_are_scipys(n, m):
    rng = np.random.default_rng(n)
    for a, b in ((rng.normal(0.3, 1, n), rng.normal(0, 1, m)), (rng.integers(9, size=n), rng.integers(9, size=m))):
        estimate = stats.probability_of_improvement(a, b)
        assert estimate.value == pytest.approx(scipy.stats.mannwhitneyu(a, b).statistic / (n * m), rel=1e-12)
        assert list(estimate[1:]) == pytest.approx(scipys_interval((np.sort(a), np.sort(b)), over_pairs), rel=1e-12)


@QUICK
@given(a=NUMBERS, b=NUMBERS)
def test_one_setting_improves_as_often_as_the_other_does_not(a, b):
    there, back = stats.probability_of_improvement(a, b), stats.probability_of_improvement(b, a)
    assert there.value + back.value == pytest.approx(1, rel=1e-12)
    assert 0 <= there.low <= there.value + 1e-12 <= there.high + 2e-12 <= 1 + 2e-12


@pytest.mark.parametrize("case", RLIABLE["cases"])
@pytest.mark.parametrize("name", [*AVERAGES, "probability_of_improvement"])
def test_values_are_rliables_and_intervals_so_within_the_noise_of_resampling(name, case):
    """The ends lie between those of rliable's intervals whose tails are 4 standard errors of ours wider and narrower.

    The share of R resamples below rliable's p-quantile has standard error sqrt(p (1 - p) / R): 0.35 % at p = 2.5 %.
    """
    error = math.sqrt(0.025 * 0.975 / stats.RESAMPLES)
    assert [(RLIABLE["tails"][tail] - 0.025) / error for tail in ("outer", "inner")] == pytest.approx([-4, 4], rel=0.03)
    inputs, (outer, inner) = RLIABLE["cases"][case], (RLIABLE["cases"][case][name][tail] for tail in ("outer", "inner"))
    samples = [inputs["a"], inputs["b"]] if name == "probability_of_improvement" else [inputs["a"]]
    value, low, high = getattr(stats, name)(*samples)
    slack = 1e-9 * abs(value)  # of rounding, where both ends are one and the same mean of values
    assert value == pytest.approx(inputs[name]["value"], rel=1e-12)
    assert outer[0] - slack <= low <= inner[0] + slack
    assert inner[1] - slack <= high <= outer[1] + slack


@pytest.mark.parametrize("statistic", [stats.mean, stats.median, stats.interquartile_mean])
def test_a_bootstrap_interval_covers_about_as_often_as_it_says(statistic):
    rng = np.random.default_rng(1)
    hits = 0
    for _ in range(200):
        low, high = statistic(rng.normal(size=40))[1:]
        hits += low <= 0 <= high
    assert 0.88 <= hits / 200 <= 0.99


def test_the_mean_and_its_interval_move_with_the_values():
    values = np.array([3.0, 1.0, 4.0, 1.0, 5.0])
    value, low, high = stats.mean(values.tolist())
    assert value == np.mean(values)
    assert min(values) <= low < value < high <= max(values)
    np.testing.assert_allclose(stats.mean((10 * values + 7).tolist()), [10 * end + 7 for end in (value, low, high)])


def test_the_median_time_counts_those_that_never_succeeded_as_later_than_all():
    assert stats.median_time([1, 2, 3, None, None]) == 3
    assert stats.median_time([1, 2, None, None, None]) is None
    assert stats.median_time([1, 2, None, None]) is None
    assert stats.median_time([]) is None


def test_the_interval_of_the_median_time_by_hand():
    # Of 10 times 0 or 1 are below the median with probability 11/1024, up to 2 with 56/1024: the 2nd and the 9th.
    times = [100, 20, 30, 40, 50, 60, 70, 80, 90, 10]
    assert stats.time_to_success(times) == (55, 20, 90)
    assert stats.time_to_success([None if time >= 90 else time for time in times]) == (55, 20, None)
    assert stats.time_to_success([None if time >= 50 else time for time in times]) == (None, 20, None)
    assert stats.time_to_success([1, 2, 3, 4, 5]) == (3, None, None)  # even the 1st and the 5th leave out 1/32 each
    assert stats.time_to_success([1, 2, 3, 4, 5, 6]) == (3.5, 1, 6)
    assert stats.time_to_success([]) == (None, None, None)


def test_a_survival_curve_by_hand():
    # S = 4/5 at 10, where 1 of 5 is solved; one is gone at 20; 4/5 2/3 at 30; 8/15 1/2 at 40; the last is gone at 50
    times, observed = [40, 20, 10, 50, 30], [True, False, True, False, True]
    curve = stats.survival(times, observed)
    assert curve.times.tolist() == [0, 10, 20, 30, 40, 50]
    np.testing.assert_allclose(curve.share, [1, 4 / 5, 4 / 5, 8 / 15, 4 / 15, 4 / 15], rtol=1e-12)
    # Greenwood's sum at 30 is 1/(5 4) + 1/(3 2) = 13/60, so z s = 1.959964 sqrt(13/60) / log(15/8) = 1.451322
    assert np.isnan([curve.low[0], curve.high[0]]).all()
    assert curve.low[3] == pytest.approx((8 / 15) ** math.exp(1.451322), rel=1e-6)
    assert curve.high[3] == pytest.approx((8 / 15) ** math.exp(-1.451322), rel=1e-6)
    # low is 0.204 at 10 already and high still 0.686 at 40
    assert stats.kaplan_meier_median(times, observed) == (40, 10, None)
    # without the last event S stays at 8/15
    assert stats.kaplan_meier_median(times, [False, False, True, False, True]) == (None, 10, None)


def test_a_survival_curve_as_published():
    """Weeks in remission of 21 + 21 patients, Freireich et al., 1963; S as in Klein & Moeschberger, table 4.1."""
    weeks = [6, 6, 6, 7, 10, 13, 16, 22, 23] + [6, 9, 10, 11, 17, 19, 20, 25, 32, 32, 34, 35]
    observed = [True] * 9 + [False] * 12
    curve = stats.survival(weeks, observed)
    published = {6: 0.857, 7: 0.807, 10: 0.753, 13: 0.690, 16: 0.627, 22: 0.538, 23: 0.448, 35: 0.448}
    assert {week: round(float(curve.share[curve.times == week][0]), 3) for week in published} == published
    assert stats.kaplan_meier_median(weeks, observed) == (23, 13, None)
    placebo = [1, 1, 2, 2, 3, 4, 4, 5, 5, 8, 8, 8, 8, 11, 11, 12, 12, 15, 17, 22, 23]
    assert stats.kaplan_meier_median(placebo, [True] * 21) == (8, 4, 11)


@QUICK
@given(seeds=SEEDS)
@pytest.mark.filterwarnings("ignore:The confidence interval is undefined:RuntimeWarning")
def test_a_survival_curve_and_its_interval_are_scipys(seeds):
    times, observed = map(np.array, zip(*seeds, strict=True))
    theirs = scipy.stats.ecdf(scipy.stats.CensoredData.right_censored(times, ~observed)).sf
    low, high = theirs.confidence_interval(0.95, method="log-log")
    ours = stats.survival(times, observed)
    assert [row[0] for row in ours[:2]] == [0, 1]
    assert ours.times[1:].tolist() == theirs.quantiles.tolist()
    np.testing.assert_allclose(ours.share[1:], theirs.probabilities, atol=1e-14)
    inside = (ours.share > 0) & (ours.share < 1)
    np.testing.assert_allclose(ours.low[inside], low.probabilities[inside[1:]], rtol=1e-11)
    np.testing.assert_allclose(ours.high[inside], high.probabilities[inside[1:]], rtol=1e-11)
    assert np.isnan([ours.low, ours.high])[:, ours.share == 1].all()
    if ours.share[-1] == 0:
        np.testing.assert_array_equal([ours.low[-1], ours.high[-1]], [0, ours.high[-2]])


@QUICK
@given(times=st.lists(st.integers(1, 30).map(float), min_size=1, max_size=15), censored=st.integers(0, 15))
def test_without_early_censoring_the_median_is_the_first_half_of_all_seeds(times, censored):
    curve = stats.survival(times + [np.inf] * censored, [True] * len(times) + [False] * censored)
    ordered, seeds = sorted(times), len(times) + censored
    middle = math.ceil(seeds / 2)
    expected = ordered[middle - 1] if middle <= len(ordered) else None
    estimate = stats.kaplan_meier_median(times + [np.inf] * censored, [True] * len(times) + [False] * censored)
    assert estimate.value == expected
    assert curve.times[-1] == ordered[-1]  # nothing is drawn at infinity
    assert curve.share[-1] == pytest.approx(censored / seeds, abs=1e-14)


@QUICK
@given(seeds=SEEDS, which=st.integers(0, 11), longer=st.one_of(st.integers(0, 12), st.just(np.inf)))
def test_watching_an_unsolved_seed_longer_never_makes_the_median_earlier(seeds, which, longer):
    times, observed = (list(column) for column in zip(*seeds, strict=True))
    observed[which % len(seeds)] = False
    before = stats.kaplan_meier_median(times, observed).value
    times[which % len(seeds)] += longer
    after = stats.kaplan_meier_median(times, observed).value
    assert (after or np.inf) >= (before or np.inf)


def test_the_interval_of_the_kaplan_meier_median_covers_about_as_often_as_it_says():
    rng = np.random.default_rng(4)
    hits, open_ends = 0, 0
    for _ in range(500):
        success, end = rng.exponential(size=30), rng.uniform(0.5, 3, size=30)
        _, low, high = stats.kaplan_meier_median(np.minimum(success, end), success <= end)
        hits += low <= math.log(2) <= (np.inf if high is None else high)
        open_ends += high is None
    assert 0.92 <= hits / 500 <= 0.98
    assert open_ends < 50


def test_the_area_under_a_learning_curve_by_hand():
    # 0 for 100 steps, 1 for 200 and 4 for 100: 600 / 400
    assert stats.area_under_curve([100, 200, 400], [0, 1, 4], 500) == 1.5
    assert stats.area_under_curve([100, 200, 400], [0, 1, 4], 400) == 200 / 300  # the last value for no step
    assert stats.area_under_curve([100, 200, 400], [np.nan, 1, np.nan], 500) == 1
    assert stats.area_under_curve([100, 200, 400], [0, np.nan, 4], 500) == 1
    assert stats.area_under_curve([100], [7], 100) == 7
    assert stats.area_under_curve([], [], 10) is None
    assert stats.area_under_curve([3], [np.nan], 10) is None


@QUICK
@given(curve=st.dictionaries(st.integers(0, 40), st.integers(-50, 50).map(float), min_size=1), longer=st.integers(0, 9))
def test_the_area_under_a_curve_is_the_average_over_its_steps(curve, longer):
    steps = sorted(curve)
    end, value, held = steps[-1] + longer, None, []
    for step in range(steps[0], end):
        value = curve.get(step, value)
        held.append(value)
    expected = np.mean(held or [curve[steps[0]]])
    assert stats.area_under_curve(steps, [curve[step] for step in steps], end) == pytest.approx(expected, abs=1e-9)


@QUICK
@given(seeds=SEEDS, other=NUMBERS, order=st.randoms())
def test_the_order_of_the_seeds_is_nothing(seeds, other, order):
    shuffled = order.sample(seeds, len(seeds))
    (times, observed), (times2, observed2) = zip(*seeds, strict=True), zip(*shuffled, strict=True)
    for statistic in (stats.mean, stats.median, stats.interquartile_mean, stats.time_to_success):
        assert statistic(times) == statistic(times2)
    assert stats.paired_difference(times, observed) == stats.paired_difference(times2, observed2)
    for a, b in ((times, times2), (other, other[::-1])):
        assert stats.probability_of_improvement(a, other) == stats.probability_of_improvement(b, other)
        assert stats.probability_of_improvement(other, a) == stats.probability_of_improvement(other, b)
    assert stats.kaplan_meier_median(times, observed) == stats.kaplan_meier_median(times2, observed2)
    for row, row2 in zip(stats.survival(times, observed), stats.survival(times2, observed2), strict=True):
        np.testing.assert_array_equal(row, row2)


@pytest.mark.parametrize("statistic", [stats.mean, stats.median, stats.interquartile_mean])
def test_one_seed_has_a_value_and_no_interval(statistic):
    assert statistic([3.0]) == (3.0, None, None)
    assert statistic(np.array([])) == statistic([]) == (None, None, None)


def test_one_seed_of_two_settings_or_of_a_clock_has_a_value_and_no_interval():
    assert stats.paired_difference([3], [1]) == (2, None, None)
    assert stats.paired_difference([], []) == (None, None, None)
    assert stats.probability_of_improvement([3], [1, 3, 5]) == (0.5, None, None)
    assert stats.probability_of_improvement([1, 3, 5], [3]) == (0.5, None, None)
    assert stats.probability_of_improvement([], [3, 4]) == (None, None, None)
    assert stats.probability_of_improvement([3, 4], []) == (None, None, None)
    assert stats.kaplan_meier_median([5], [True]) == (5, None, None)
    assert stats.kaplan_meier_median([5], [False]) == (None, None, None)
    assert stats.kaplan_meier_median([], []) == (None, None, None)
    assert [row.tolist() for row in stats.survival([5], [True])[:2]] == [[0, 5], [1, 0]]
    assert np.isnan(stats.survival([5], [True])[2:]).all()
    assert [row.size for row in stats.survival([], [])] == [0, 0, 0, 0]


NAN, INF = math.nan, math.inf


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda: stats.mean([1, NAN]), r"values\[1\]: nan must be a finite number"),
        (lambda: stats.mean([NAN]), r"values\[0\]: nan"),
        (lambda: stats.median([INF, 1]), r"values\[0\]: inf"),
        (lambda: stats.interquartile_mean([1, 2, NAN]), r"values\[2\]: nan"),
        (lambda: stats.paired_difference([1, NAN], [1, 2]), r"a\[1\]: nan"),
        (lambda: stats.paired_difference([1, 2], [NAN, 2]), r"b\[0\]: nan"),
        (lambda: stats.paired_difference([1, 2], [1]), "b: 1 values must be as many as those of a, 2"),
        (lambda: stats.probability_of_improvement([NAN], [1]), r"a\[0\]: nan must be a number"),
        (lambda: stats.probability_of_improvement([], [NAN]), r"b\[0\]: nan"),
        (lambda: stats.median_time([1, NAN, 2]), r"times\[1\]: nan"),
        (lambda: stats.time_to_success([1, NAN, 2]), r"times\[1\]: nan"),
        (lambda: stats.survival([1, NAN], [True, False]), r"times\[1\]: nan"),
        (lambda: stats.survival([1, -2], [True, False]), "times: -2.0 must be at least 0"),
        (lambda: stats.kaplan_meier_median([1, INF], [True, True]), "times: inf must not be observed"),
        (lambda: stats.kaplan_meier_median([1, 2], [True]), "observed: 1 values must be as many as the times, 2"),
        (lambda: stats.area_under_curve([1, NAN], [1, 2], 3), r"steps\[1\]: nan"),
        (lambda: stats.area_under_curve([1, 2, 3], [NAN, 2, INF], 3), r"values\[2\]: inf"),
        (lambda: stats.area_under_curve([1, 2], [1, 2], NAN), r"end\[0\]: nan"),
        (lambda: stats.area_under_curve([1, 1], [1, 2], 3), "must rise"),
        (lambda: stats.area_under_curve([1, 2], [1, 2], 1.5), "end: 1.5 must be at least the last step, 2.0"),
        (lambda: stats.area_under_curve([1, 2], [1], 3), "values: 1 must be as many as the steps, 2"),
    ],
)
def test_what_has_no_meaning_is_refused(call, message):
    with pytest.raises(ValueError, match=message):
        call()


def test_an_average_needs_no_scipy():
    code = "import sys; from jaxq import stats; stats.mean([1, 2]); sys.exit('scipy.stats' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0
