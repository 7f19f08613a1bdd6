"""The two pictures of one training, and how a picture is written."""

import xml.etree.ElementTree as ET

import numpy as np
import pytest
from matplotlib.figure import Figure
from matplotlib.image import imread
from test_pictures_tables import INF, NAN, drawn, keys, texts, ticks

from jaxq import pictures


@pytest.mark.parametrize("count", [1, 2, 5, 29, 30, 50, 300, 12_345])
@pytest.mark.parametrize("success_at", [None, 450])
@pytest.mark.parametrize("length", [1, 12])
def test_episodes_have_whole_ticks_visible_points_and_a_legend_of_what_is_drawn(count, success_at, length):
    figure = drawn(pictures.episode_lengths(np.full(count, length), success_at=success_at))
    (axes,) = figure.axes
    for axis in (axes.xaxis, axes.yaxis):
        places = ticks(axis)
        assert len(places) >= 2
        assert all(place == round(place) for place in places)
    low, high = axes.get_xlim()
    assert low < 1 <= count < high
    assert (axes.lines[0].get_marker() == "o") == (count < 30)
    expected = ["each episode", *["mean of 50"] * (count >= 50), *["success: 450 steps"] * (success_at is not None)]
    assert keys(figure) == expected
    assert all(line.get_marker() == "o" for line in axes.lines if len(line.get_xdata()) == 1)
    assert not figure.legends[0].get_window_extent().overlaps(axes.get_tightbbox())


def test_the_lengths_and_their_mean_are_what_is_drawn():
    lengths = np.arange(1, 101)
    each, mean = pictures.episode_lengths(lengths).axes[0].lines
    np.testing.assert_array_equal(each.get_xydata(), np.column_stack([np.arange(1, 101), lengths]))
    np.testing.assert_allclose(mean.get_xdata(), np.arange(50, 101))
    np.testing.assert_allclose(mean.get_ydata(), np.arange(25.5, 76))


EMPTY = [
    (lambda: pictures.episode_lengths(np.array([], int), success_at=450), "no finished episode"),
    (lambda: pictures.q_values(np.array([])), "no updates"),
    (lambda: pictures.q_values(np.full(100, NAN, np.float32)), "no update with a finite value"),
    (lambda: pictures.q_values(np.array([INF, -INF, NAN])), "no update with a finite value"),
]


@pytest.mark.parametrize(("draw", "says"), EMPTY, ids=["episodes", "updates", "warm-up", "infinite"])
def test_a_picture_of_nothing_says_so_and_has_no_ticks(draw, says):
    figure = drawn(draw())
    (axes,) = figure.axes
    assert texts(figure) == [says]
    assert not axes.lines
    assert not ticks(axes.xaxis)
    assert not ticks(axes.yaxis)


@pytest.mark.parametrize("value", [0.0, 20.0, -3e21])
def test_one_update_can_be_seen(value):
    figure = drawn(pictures.q_values(np.array([value], np.float32)))
    (axes,) = figure.axes
    assert axes.lines[0].get_marker() == "o"
    low, high = axes.get_ylim()
    assert low < value < high
    assert high - low >= 2
    assert ticks(axes.xaxis) == [0, 1, 2]


def test_values_that_diverge_are_drawn_to_the_last_and_their_end_is_marked():
    values = np.concatenate([np.full(100, NAN), 1.5 ** np.arange(200), [INF, NAN]]).astype(np.float32)
    figure = drawn(pictures.q_values(values))
    (axes,) = figure.axes
    assert axes.get_yscale() == "symlog"
    assert keys(figure) == ["each step", "mean of 50", "not finite from step 301"]
    assert np.isfinite(axes.lines[0].get_ydata()).sum() == 200
    assert not any(np.isinf(line.get_ydata()).any() for line in axes.lines)


def test_a_warm_up_is_no_divergence():
    figure = drawn(pictures.q_values(np.concatenate([np.full(100, NAN), np.linspace(0, 100, 300)])))
    assert keys(figure) == ["each step", "mean of 50"]
    assert figure.axes[0].get_yscale() == "linear"


def test_a_mean_without_a_finite_window_has_no_entry():
    assert keys(drawn(pictures.q_values(np.array([NAN] * 60 + [1.0, 2.0])))) == ["each step"]


def test_the_arrays_that_are_drawn_stay_as_they_are():
    values = np.array([1.0, INF, NAN])
    pictures.q_values(values)
    np.testing.assert_array_equal(values, [1.0, INF, NAN])


def test_a_picture_is_a_png_and_nothing_else_is_left(tmp_path):
    target = tmp_path / "picture.png"
    figure = pictures.q_values(np.arange(100.0))
    assert pictures.save(figure, target) == target
    height, width, _ = imread(target).shape
    np.testing.assert_allclose([width, height], 120 * figure.get_size_inches(), atol=1)
    assert list(tmp_path.iterdir()) == [target]


def test_a_picture_is_an_svg_by_its_ending(tmp_path):
    target = pictures.save(pictures.q_values(np.arange(100.0)), tmp_path / "picture.svg")
    assert ET.parse(target).getroot().tag.endswith("svg")
    assert list(tmp_path.iterdir()) == [target]


@pytest.mark.parametrize("before", [b"the old one", None])
def test_a_full_disk_leaves_the_old_picture_and_no_half_one(tmp_path, monkeypatch, before):
    target = tmp_path / "picture.png"
    if before:
        target.write_bytes(before)

    def full(self, file, **_):
        with open(file, "wb") as out:
            out.write(b"\x89PNG")
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(Figure, "savefig", full)
    with pytest.raises(OSError, match="No space left"):
        pictures.save(pictures.q_values(np.zeros(3)), target)
    assert {file.name: file.read_bytes() for file in tmp_path.iterdir()} == ({target.name: before} if before else {})
