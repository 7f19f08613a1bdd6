"""The scale of an axis, and its ticks."""

import itertools

import pytest
from test_pictures_tables import drawn, inside, names, product, swept, ticks

from jaxq import axes, pictures
from jaxq.axes import Range

WORDS = product(hidden=["64,64", "128,128", "256"], double=[False, True])


@pytest.mark.parametrize(
    ("values", "scale"),
    [
        ([1e-4, 1e-2], "log"),
        ([16, 1024], "log"),
        ([0.9, 0.99], "linear"),
        ([0.0, 1.0], "linear"),
        ([-1.0, 100.0], "linear"),
        ([1e-4, 3e-4, 1e-3, 3e-3, 1e-2], "log"),
        ([1, 25, 50, 75, 100], "linear"),
    ],
)
def test_the_scale_is_logarithmic_where_positive_values_span_much_and_each_value_has_its_tick(values, scale):
    lanes = swept(product(axis=values, other=[1, 2]), 2)
    axes = drawn(pictures.sensitivity(lanes, "axis", ["axis", "other"])).axes[0]
    assert axes.get_xscale() == scale
    assert ticks(axes.xaxis) == values
    assert names(axes.xaxis) == [f"{value:.6g}" for value in values]


def test_names_are_ticks_and_layer_sizes_in_the_order_of_their_numbers():
    axes = drawn(pictures.sensitivity(swept(WORDS, 2), "hidden", ["hidden", "double"])).axes[0]
    assert names(axes.xaxis) == ["64,64", "128,128", "256"]
    axes = drawn(pictures.sensitivity(swept(WORDS, 2), "double", ["hidden", "double"])).axes[0]
    assert names(axes.xaxis) == ["False", "True"]


def test_a_value_that_is_not_set_has_a_place_of_its_own():
    lanes = swept(product(clip=[1.0, 10.0, None]), 3)
    assert names(drawn(pictures.sensitivity(lanes, "clip", ["clip"])).axes[0].xaxis) == ["1", "10", "none"]


def test_long_names_are_broken_and_inside():
    long = ["sgd_with_nesterov_momentum_and_decay", "adam_with_a_very_long_name_of_its_own", "rmsprop"]
    figure = drawn(pictures.sensitivity(swept(product(optimiser=long, x=[1, 2]), 3), "optimiser", ["optimiser", "x"]))
    assert names(figure.axes[0].xaxis) == sorted(long)
    labels = figure.axes[0].get_xticklabels()
    boxes = [label.get_window_extent() for label in labels]
    assert all(label.get_rotation() == 0 for label in labels)
    assert not any(one.overlaps(other) for one, other in itertools.pairwise(boxes))
    assert inside(figure)


@pytest.mark.parametrize(("drawn_from", "scale"), [("linear", "linear"), ("log", "log")])
@pytest.mark.parametrize("settings", [10, 150])
def test_what_was_drawn_from_a_range_has_the_ranges_scale(drawn_from, scale, settings):
    points = axes.points({"decay": Range(5.0, 75.0, drawn_from)}, "sobol", settings, 0)
    found = drawn(pictures.sensitivity(swept(points, 2), "decay", ["decay"])).axes[0]
    assert found.get_xscale() == scale
