"""Axes and the points that a method takes on them: inside their ranges, evenly, and the same for one seed."""

import itertools
import math
from collections import Counter

import pytest
from hypothesis import assume, given
from hypothesis import strategies as st

from jaxq.axes import MAX_SETTINGS, Range, points

UNIT = st.floats(0, 1, exclude_max=True)
REAL = st.floats(-1e30, 1e30, allow_subnormal=False)


@pytest.mark.parametrize(
    ("ends", "said"),
    [
        ((math.nan, 1.0), "nan is not allowed: a finite number"),
        ((0.0, math.nan), "nan is not allowed"),
        ((0.0, math.inf), "inf is not allowed"),
        ((-math.inf, 0.0), "-inf is not allowed"),
        ((0, 10**400), "is not allowed: a finite number"),
        ((False, True), "False is not allowed"),
        ((0, True), "True is not allowed"),
        (("0", 1), "'0' is not allowed"),
        ((None, 1), "None is not allowed"),
        ((1.0, 1.0), "min 1.0 must be below max 1.0"),
        ((2, 1), "min 2 must be below max 1"),
        ((0.0, 1.0, "log"), "min 0.0 must be above 0 on a log scale"),
        ((-1.0, 1.0, "log"), "min -1.0 must be above 0"),
        ((1.0, 2.0, "logarithmic"), "known: linear, log"),
        ((1.0, 2.0, "liner"), "did you mean 'linear'"),
        ((1.0, 2.0, 3), "scale: 3 is unknown"),
    ],
)
def test_a_range_that_cannot_be_is_refused_in_one_line(ends, said):
    with pytest.raises(ValueError, match=r"^(range|scale): ") as error:
        Range(*ends)
    assert said in str(error.value)
    assert "\n" not in str(error.value)


@given(REAL, REAL, UNIT, UNIT)
def test_a_linear_range_rises_evenly_from_end_to_end(low, high, u, v):
    assume(low < high)
    axis = Range(low, high)
    value = axis.at(u)
    assert low <= value <= high
    assert value == pytest.approx((1 - u) * low + u * high, rel=1e-5, abs=1e-5 * max(abs(low), abs(high)))
    assert axis.at(min(u, v)) <= axis.at(max(u, v))


@given(st.floats(1e-30, 1e30), st.floats(1e-30, 1e30), UNIT)
def test_a_logarithmic_range_is_linear_in_the_logarithm(low, high, u):
    assume(low < high)
    value = Range(low, high, "log").at(u)
    assert low <= value <= high
    assert math.log(value) == pytest.approx((1 - u) * math.log(low) + u * math.log(high), abs=1e-5)


@given(st.floats(0.001, 1000), UNIT)
def test_a_value_has_six_digits_at_most(low, u):
    value = Range(low, 2 * low).at(u)
    assert value in (low, 2 * low) or value == float(f"{value:.6g}")


@given(st.integers(-50, 50), st.integers(1, 12), st.integers(1, 9))
def test_whole_numbers_are_equally_likely_both_ends_included(low, count, each):
    axis = Range(low, low + count)
    drawn = Counter(axis.at((i + 0.5) / (each * (count + 1))) for i in range(each * (count + 1)))
    assert drawn == dict.fromkeys(range(low, low + count + 1), each)
    assert all(isinstance(value, int) for value in drawn)


def test_whole_numbers_on_a_log_scale_are_as_likely_as_their_share_of_it():
    drawn = Counter(Range(1, 4, "log").at((i + 0.5) / 9000) for i in range(9000))
    whole = math.log(4.5 / 0.5)
    for number in (1, 2, 3, 4):
        assert drawn[number] == pytest.approx(9000 * math.log((number + 0.5) / (number - 0.5)) / whole, abs=2)


def test_one_real_end_makes_a_range_of_real_numbers():
    assert Range(0, 1.0).at(0.25) == Range(0.0, 1).at(0.25) == 0.25


@given(st.lists(st.lists(st.integers(), min_size=1, max_size=4, unique=True), min_size=1, max_size=4))
def test_a_grid_is_the_product_with_the_last_axis_fastest(values):
    axes = {f"axis{i}": axis for i, axis in enumerate(values)}
    found = points(axes, "grid", samples=3, seed=1)
    assert [tuple(point.values()) for point in found] == list(itertools.product(*values))
    assert all(list(point) == list(axes) for point in found)


def test_a_grid_refuses_a_range_and_more_settings_than_anyone_runs():
    with pytest.raises(ValueError, match="rate: a range needs the method random or sobol"):
        points({"gamma": [0.9], "rate": Range(0.0, 1.0)}, "grid", 4, 0)
    edge = {"a": list(range(1000)), "b": list(range(1001))}
    with pytest.raises(ValueError, match=f"settings: 1001000 is not allowed: at most {MAX_SETTINGS}"):
        points(edge, "grid", 4, 0)
    assert len(points({"a": edge["a"], "b": edge["b"][:3]}, "grid", 4, 0)) == 3000


BOTH = pytest.mark.parametrize("method", ["random", "sobol"])
MIXED = {"real": Range(-2.0, 3.0), "rate": Range(1e-4, 1e-2, "log"), "whole": Range(3, 9), "word": ["a", "b", "c", "d"]}


@BOTH
def test_the_seed_alone_decides_the_points(method):
    first = points(MIXED, method, 16, 5)
    assert points(MIXED, method, 16, 5) == first
    assert points(MIXED, method, 16, 6) != first
    assert len(first) == 16


@BOTH
@pytest.mark.parametrize("seed", range(4))
def test_points_lie_inside_their_axes(method, seed):
    for point in points(MIXED, method, 37, seed):
        assert list(point) == list(MIXED)
        assert -2 <= point["real"] <= 3
        assert 1e-4 <= point["rate"] <= 1e-2
        assert point["whole"] in range(3, 10)
        assert point["word"] in MIXED["word"]


@BOTH
def test_more_samples_begin_with_the_same_points(method):
    many = points(MIXED, method, 32, 7)
    assert many[:16] == points(MIXED, method, 16, 7)
    assert many[:11] == points(MIXED, method, 11, 7)


@BOTH
def test_what_does_not_vary_changes_no_point(method):
    alone = points({"real": MIXED["real"]}, method, 8, 3)
    beside = points({"fixed": [(64, 64)], "real": MIXED["real"], "none": [None]}, method, 8, 3)
    assert [point["real"] for point in beside] == [point["real"] for point in alone]
    assert {point["fixed"] for point in beside} == {(64, 64)}
    assert points({"fixed": [1]}, method, 8, 3) == [{"fixed": 1}]


@BOTH
def test_what_is_drawn_twice_stands_once(method):
    few = points({"whole": Range(1, 3), "word": ["a", "b"]}, method, 256, 0)
    assert len(few) == 6
    assert {tuple(point.values()) for point in few} == set(itertools.product((1, 2, 3), "ab"))


def share(point, name):
    """Where a point lies on its axis, in [0, 1]."""
    low, high = MIXED[name].min, MIXED[name].max
    return math.log(point / low) / math.log(high / low) if name == "rate" else (point - low) / (high - low)


@pytest.mark.parametrize("seed", range(12))
def test_every_part_of_every_axis_has_equally_many_sobol_points(seed):
    drawn = points(MIXED, "sobol", 64, seed)
    assert len(drawn) == 64
    for name in ("real", "rate"):
        for parts in (2, 4, 16, 64):
            counts = Counter(int(share(point[name], name) * parts) for point in drawn)
            assert counts == dict.fromkeys(range(parts), 64 // parts)
    assert Counter(point["word"] for point in drawn) == dict.fromkeys("abcd", 16)


@pytest.mark.parametrize("seed", range(12))
def test_sobol_points_cover_the_plane_of_two_axes_too(seed):
    drawn = points({name: MIXED[name] for name in ("real", "rate")}, "sobol", 64, seed)
    for across, along in ((8, 8), (2, 32), (16, 4)):  # 64 boxes of one area, a point in each
        boxes = {(int(share(p["real"], "real") * across), int(share(p["rate"], "rate") * along)) for p in drawn}
        assert len(boxes) == 64


def test_random_points_are_independent_and_uniform_on_their_scale():
    drawn = points(MIXED, "random", 4000, 0)
    for name in ("real", "rate"):
        shares = [share(point[name], name) for point in drawn]
        counts = Counter(int(where * 4) for where in shares)
        assert all(abs(counts[part] - 1000) < 5 * math.sqrt(4000 * 3 / 16) for part in range(4))  # five sigma
        assert max(counts.values()) > 1000  # which no balanced sequence has
        below = sum(a < 0.5 and b < 0.5 for a, b in itertools.pairwise(shares))
        assert abs(below - 1000) < 5 * math.sqrt(4000 * 5 / 16)
    words = Counter(point["word"] for point in drawn)
    assert all(abs(words[word] - 1000) < 5 * math.sqrt(4000 * 3 / 16) for word in "abcd")
