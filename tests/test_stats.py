"""Statistics against hand-worked and published numbers."""

import numpy as np
import pytest

from jaxq import stats


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


def test_the_interquartile_mean_drops_a_quarter_at_each_end():
    values = [1e9, 1, 2, 3, 4, 5, 6, -1e9]
    assert stats.interquartile_mean(values).value == np.mean([2, 3, 4, 5])


def test_one_seed_has_a_value_and_no_interval():
    assert stats.interquartile_mean([3.0]) == (3.0, None, None)
    assert stats.interquartile_mean([]) == (None, None, None)


def test_the_bootstrap_interval_covers_about_as_often_as_it_says():
    rng = np.random.default_rng(1)
    hits = 0
    for _ in range(200):
        low, high = stats.interquartile_mean(rng.normal(size=40))[1:]
        hits += low <= 0 <= high
    assert 0.88 <= hits / 200 <= 0.99


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


def test_the_mean_and_its_interval_move_with_the_values():
    values = np.array([3.0, 1.0, 4.0, 1.0, 5.0])
    value, low, high = stats.mean(values.tolist())
    assert value == np.mean(values)
    assert min(values) <= low < value < high <= max(values)
    np.testing.assert_allclose(stats.mean((10 * values + 7).tolist()), [10 * end + 7 for end in (value, low, high)])
    assert stats.mean([2.0]) == (2.0, None, None)
    assert stats.mean([]) == (None, None, None)
