"""Pictures of a trained agent: what is drawn is what its action values say."""

import numpy as np
import pytest
from matplotlib.collections import PolyCollection
from test_pictures_tables import INF, NAN, drawn, inside, keys, note, texts

from jaxq import pictures


def q(observations):
    """Values of which the angle is worth as much for the right as the speed."""
    assert observations.shape[1] == 4
    assert not observations[:, :2].any()  # the cart at rest in the middle
    left = -observations[:, 2] - observations[:, 3]
    return np.stack([left, 3 * observations[:, 2] + observations[:, 3]], axis=1)


def at(image, angle, speed):
    """The value that an image shows at a place."""
    values = image.get_array()
    left, right, low, high = image.get_extent()
    column = round((angle - left) / (right - left) * (values.shape[1] - 1))
    row = round((speed - low) / (high - low) * (values.shape[0] - 1))
    return values[row, column]


def test_panels_are_both_values_in_one_scale_and_their_difference():
    figure = drawn(pictures.action_values(q, angle=0.2, angular_velocity=2.0))
    left, right, less = (axes.images[0] for axes in figure.axes[:3])
    for angle, speed in ((0.2, 2.0), (-0.2, 2.0), (0.0, 0.0), (0.1, -1.0)):
        assert at(left, angle, speed) == pytest.approx(-angle - speed, abs=1e-6)
        assert at(right, angle, speed) == pytest.approx(3 * angle + speed, abs=1e-6)
        assert at(less, angle, speed) == pytest.approx(4 * angle + 2 * speed, abs=1e-6)
    assert list(left.get_extent()) == [-0.2, 0.2, -2.0, 2.0]
    assert left.get_clim() == right.get_clim() == pytest.approx((-2.6, 2.6))
    assert less.get_clim() == pytest.approx((-4.8, 4.8))
    assert figure.axes[0].get_xlabel() == "pole angle [rad]"
    assert figure.axes[0].get_ylabel() == "angular velocity [rad/s]"
    assert note(figure) == "the cart at rest in the middle"
    assert inside(figure)


def test_a_line_parts_the_two_actions_where_there_are_two():
    panel = pictures.action_values(q, 0.2, 2.0).axes[2]
    points = np.concatenate([path.vertices for path in panel.collections[0].get_paths()])
    np.testing.assert_allclose(4 * points[:, 0] + 2 * points[:, 1], 0, atol=1e-6)
    one = drawn(pictures.action_values(lambda obs: np.stack([np.ones(len(obs)), np.zeros(len(obs))], 1), 0.2, 2.0))
    assert not one.axes[2].collections


def test_one_value_has_one_colour_in_both_panels():
    figure = drawn(pictures.action_values(lambda obs: np.full((len(obs), 2), 7.0), 0.2, 2.0))
    left, right = (axes.images[0] for axes in figure.axes[:2])
    assert left.get_clim() == right.get_clim()
    assert left.get_clim()[0] < 7 < left.get_clim()[1]


def test_the_map_is_the_larger_value():
    figure = drawn(pictures.greedy_map(q, angle=0.2, angular_velocity=2.0))
    (image,) = figure.axes[0].images
    assert at(image, 0.1, 1.0) == 1
    assert at(image, -0.1, -1.0) == 0
    assert at(image, 0.1, -1.0) == 0
    assert keys(figure) == ["push left", "push right"]
    colours = [image.cmap(action) for action in (0, 1)]
    assert [handle.get_color() for handle in figure.axes[0].lines] == [
        "#{:02X}{:02X}{:02X}".format(*(round(255 * part) for part in colour[:3])) for colour in colours
    ]


def test_values_that_are_not_finite_say_so():
    for draw in (pictures.action_values, pictures.greedy_map):
        figure = drawn(draw(lambda obs: np.full((len(obs), 2), NAN), 0.2, 2.0))
        assert set(texts(figure)) == {"action values that are not finite"}
        assert not any(axes.images for axes in figure.axes)


def test_points_are_the_states_and_the_note_the_mean_bias():
    followed = np.linspace(0, 50, 100)
    predicted = followed + np.tile([1.0, 3.0], 50)
    figure = drawn(pictures.overestimation(predicted, followed))
    points, diagonal = figure.axes[0].lines
    np.testing.assert_allclose(points.get_xydata(), np.column_stack([followed, predicted]))
    np.testing.assert_allclose(*diagonal.get_data())
    assert note(figure) == "over 100 states the values are 2 too high on average"
    assert figure.axes[0].get_xlim() == figure.axes[0].get_ylim()
    assert note(pictures.overestimation(followed - 2, followed)).endswith("2 too low on average")
    assert inside(figure)


def test_many_points_are_a_density_that_counts_them_all():
    rng = np.random.default_rng(0)
    followed = rng.uniform(0, 100, 10_000)
    figure = drawn(pictures.overestimation(followed + 1, followed))
    (density,) = (one for one in figure.axes[0].collections if isinstance(one, PolyCollection))
    assert density.get_array().sum() == 10_000
    assert len(figure.axes[0].lines) == 1


def test_values_that_are_not_finite_are_left_out_and_none_say_so():
    figure = drawn(pictures.overestimation(np.array([1.0, INF, NAN, 5.0]), np.array([1.0, 1.0, 1.0, INF])))
    assert figure.axes[0].lines[0].get_xydata().tolist() == [[1.0, 1.0]]
    assert note(figure) == "over 1 state the values are right on average"
    assert texts(drawn(pictures.overestimation(np.array([]), np.array([])))) == ["no state with a finite value"]
