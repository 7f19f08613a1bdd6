"""Pictures: what the reader sees stands on the figure's artists."""

import math

import numpy as np
import pytest
from matplotlib.figure import Figure
from matplotlib.image import imread

from jaxq import plots

NAN, INF = math.nan, math.inf


def lane(config, seed, steps, *, solved=True, final_return=100.0, status=None):
    return {
        "config": config,
        "seed": seed,
        "env_steps": steps,
        "solved_at_step": steps if solved else None,
        "final_return": final_return,
        "status": status or ("solved" if solved else "finished"),
    }


def point(config, seed, steps, value):
    return {"config": config, "seed": seed, "env_steps": steps, "train_return": value}


def sweep(settings, seeds=3):
    """Lanes of one length, whose returns grow with the setting, and their curves."""
    pairs = [(c, s) for c in range(settings) for s in range(seeds)]
    lanes = [lane(c, s, 1000, final_return=100.0 + c) for c, s in pairs]
    return lanes, [point(c, s, steps, steps / 10 + c + s) for c, s in pairs for steps in range(100, 1001, 100)]


def long_tail(final=1.0):
    """One setting of 100 lanes: 98 solved at 1000 steps, two that ran twenty times longer, of which some solved."""
    late = [lane(0, 98 + i, 20_000, solved=i < round(100 * final) - 98) for i in range(2)]
    lanes = [lane(0, seed, 1000) for seed in range(98)] + late
    return lanes, [point(0, row["seed"], 500, 20.0) for row in lanes]


def label(axes):
    return ", ".join(f"some_hyperparameter_{i} 0.12{i}" for i in range(axes))


def drawn(figure):
    figure.draw_without_rendering()
    return figure


def size_of(axes):
    box = axes.get_window_extent()
    return [box.width, box.height]


def texts(figure):
    """Everything written in the axes, and the title of the legend."""
    notes = [legend.get_title().get_text() for legend in figure.legends]
    return [text.get_text() for axes in figure.axes for text in axes.texts] + notes


def ticks(axis):
    low, high = axis.get_view_interval()
    return [place for place in axis.get_majorticklocs() if low <= place <= high]


LEGENDS = [(1, 1), (3, 1), (8, 1), (12, 1), (2, 3), (8, 3), (8, 7), (8, 30)]


@pytest.mark.parametrize(("settings", "axes"), LEGENDS, ids=str)
def test_the_legend_covers_no_panel_lies_inside_the_figure_and_leaves_the_panels_their_size(settings, axes):
    lanes, curves = sweep(settings)
    figure = drawn(plots.learning_curves(lanes, curves, {c: f"{label(axes)}, s {c}" for c in range(settings)}))
    (legend,) = figure.legends
    box = legend.get_window_extent()
    assert all(panel.get_legend() is None for panel in figure.axes)
    assert not any(box.overlaps(panel.get_tightbbox()) for panel in figure.axes)
    assert box.x0 >= 0
    assert box.y0 >= 0
    assert box.x1 <= figure.bbox.width
    small = drawn(plots.learning_curves(*sweep(1), {0: "s"}))
    for one, other in zip(figure.axes, small.axes, strict=True):
        np.testing.assert_allclose(size_of(one), size_of(other), rtol=0.04)


def test_the_legend_has_as_many_columns_as_fit_and_every_setting_once():
    lanes, curves = sweep(8)
    columns = {}
    for axes in (1, 3, 7):
        figure = drawn(plots.learning_curves(lanes, curves, {c: f"{label(axes)}, s {c}" for c in range(8)}))
        entries = figure.legends[0].get_texts()
        columns[axes] = len({round(entry.get_window_extent().x0) for entry in entries})
        assert [entry.get_text().replace("\n", " ")[-3:] for entry in entries] == [f"s {c}" for c in range(8)]
    assert columns[1] > columns[3] > 0
    assert columns[7] == 1


def test_a_name_is_never_parted_from_its_value():
    lanes, curves = sweep(1)
    figure = plots.learning_curves(lanes, curves, {0: label(30)})
    lines = figure.legends[0].get_texts()[0].get_text().split("\n")
    assert len(lines) > 1
    assert all(line.rstrip(",").split(" ")[-1].startswith("0.12") for line in lines)


def test_settings_that_are_left_out_are_said_and_the_best_are_kept():
    figure = plots.learning_curves(*sweep(12), {c: f"s {c}" for c in range(12)})
    assert texts(figure) == ["8 of 12 settings, those of highest return"]
    assert [entry.get_text() for entry in figure.legends[0].get_texts()] == [f"s {c}" for c in range(4, 12)]


def test_a_setting_without_a_return_comes_last():
    lanes, curves = sweep(8)
    lanes += [lane(c, 0, 1000, final_return=value) for c, value in ((8, None), (9, NAN), (10, INF))]
    figure = plots.learning_curves(lanes, curves, {c: f"s {c}" for c in range(11)})
    assert [entry.get_text() for entry in figure.legends[0].get_texts()] == [f"s {c}" for c in range(8)]


def test_nothing_is_said_when_nothing_is_left_out():
    figure = plots.learning_curves(*sweep(8), {c: f"s {c}" for c in range(8)})
    assert texts(figure) == [""]


def test_no_two_settings_look_alike():
    right = plots.learning_curves(*sweep(8), {c: f"s {c}" for c in range(8)}).axes[1]
    assert len({line.get_color() for line in right.lines}) == 8
    assert {line.get_linestyle() for line in right.lines} == {"-", "--"}


@pytest.mark.parametrize("final", [0.98, 0.99, 1.0])
def test_the_final_share_can_be_read_where_the_axis_is_cut(final):
    figure = drawn(plots.learning_curves(*long_tail(final), {0: "s"}))
    right = figure.axes[1]
    assert right.get_xlim()[1] < 1100
    written = [text.get_text() for text in right.texts]
    assert written == ([f"{final:.2f}"] if final > 0.98 else [])
    assert right.lines[-1].get_ydata()[-1] == pytest.approx(final)
    (note,) = (text for text in texts(figure) if "axes end" in text)
    assert note.startswith("the axes end where 98 of 100 lanes have ended; the longest ran 20.0k steps")
    assert ("final shares" in note) == (final > 0.98)


def test_final_shares_lie_on_neither_each_other_nor_the_panel_and_inside_the_figure():
    rng = np.random.default_rng(0)
    lanes = [
        lane(c, s, int(rng.integers(500, 1000)) if s < 980 else 20_000, solved=s < 982 + 2 * c)
        for c in range(8)
        for s in range(1000)
    ]
    figure = drawn(
        plots.learning_curves(lanes, [point(c, 0, 100, 9.0) for c in range(8)], dict.fromkeys(range(8), "s"))
    )
    right = figure.axes[1]
    written = [text.get_text() for text in right.texts]
    assert sorted(written) == ["0.99", "1.00"]
    boxes = [text.get_window_extent() for text in right.texts]
    assert all(right.bbox.x1 <= box.x0 < box.x1 <= figure.bbox.width for box in boxes)
    assert not any(one.overlaps(other) for i, one in enumerate(boxes) for other in boxes[:i])


def test_the_axis_is_whole_when_the_longest_lane_is_not_much_longer():
    lanes = [lane(0, seed, 1000 if seed < 98 else 1400) for seed in range(100)]
    figure = plots.learning_curves(lanes, [point(0, 0, 500, 20.0)], {0: "s"})
    assert figure.axes[1].get_xlim()[1] >= 1400
    assert texts(figure) == [""]


def test_a_setting_that_is_not_shown_does_not_stretch_the_axis():
    lanes, curves = sweep(8)
    lanes += [lane(8, seed, 50_000, solved=False, final_return=1.0) for seed in range(3)]
    figure = plots.learning_curves(lanes, curves, dict.fromkeys(range(9), "s"))
    assert figure.axes[1].get_xlim()[1] < 1100


def test_a_curve_begins_at_its_first_point_and_is_the_median_of_the_latest_returns():
    lanes = [lane(0, seed, 1000) for seed in range(3)]
    curves = [point(0, seed, steps, steps / 10 + seed) for seed in range(3) for steps in (500, 1000)]
    x, y = plots.learning_curves(lanes, curves, {0: "s"}).axes[0].lines[0].get_data()
    assert 500 <= x[0] < 510
    np.testing.assert_allclose(y, np.where(x < 1000, 51, 101))


def test_a_median_does_not_dip_where_no_lane_half_way_does():
    """Three of five lanes have 500 at one point, three others at the next: between them the median stays."""
    lanes = [lane(0, seed, 2000) for seed in range(5)]
    high = {1000: (0, 1, 2), 2000: (2, 3, 4)}
    curves = [point(0, seed, at, 500.0 if seed in high[at] else 0.0) for seed in range(5) for at in high]
    _, y = plots.learning_curves(lanes, curves, {0: "s"}).axes[0].lines[0].get_data()
    assert set(y) == {500.0}


def test_who_does_not_look_for_success_has_no_share():
    def labels(windows):
        lanes = [
            {**lane(c, seed, 1000), "success_window": window} for c, window in enumerate(windows) for seed in range(3)
        ]
        figure = plots.learning_curves(lanes, [], {0: "a", 1: "b"})
        right = figure.axes[1]
        shown = [line for line in right.lines if len(line.get_xdata())]
        (legend,) = figure.legends
        return len(shown), [text.get_text() for text in right.texts], [text.get_text() for text in legend.get_texts()]

    assert labels([0, 0]) == (0, ["no setting looks for success"], ["a", "b"])
    assert labels([50, 0]) == (1, [], ["a", "b"])


def test_a_curve_of_one_point_can_be_seen():
    line = plots.learning_curves([lane(0, 0, 20)], [point(0, 0, 20, 20.0)], {0: "s"}).axes[0].lines[0]
    assert line.get_xydata().tolist() == [[20.0, 20.0]]
    assert line.get_marker() == "o"


def test_diverged_lanes_are_counted_and_their_values_are_left_out():
    lanes = [lane(0, 0, 900, solved=False, final_return=NAN, status="diverged"), lane(0, 1, 900)]
    curves = [point(0, 0, 300, 20.0), point(0, 0, 600, INF), point(0, 0, 900, NAN), point(0, 1, 300, None)]
    figure = drawn(plots.learning_curves(lanes, curves, {0: "s"}))
    assert texts(figure) == ["1 of 2 lanes diverged and keep their last return"]
    assert set(figure.axes[0].lines[0].get_ydata()) == {20.0}


def test_a_sweep_without_a_finished_episode_or_a_lane_says_so():
    figure = drawn(plots.learning_curves([lane(0, 0, 40, solved=False)], [point(0, 0, 40, None)], {0: "s"}))
    assert texts(figure) == ["no finished episode", ""]
    assert not ticks(figure.axes[0].yaxis)
    assert figure.axes[1].lines
    figure = drawn(plots.learning_curves([], [], {}))
    assert texts(figure) == ["no lanes", "no lanes"]


def test_the_labels_say_what_is_counted():
    left, right = plots.learning_curves(*sweep(2), {0: "a", 1: "b"}).axes
    assert left.get_ylabel() == "return: median, quartiles of 3 lanes"
    assert right.get_ylabel() == "share of 3 lanes"
    left, right = plots.learning_curves(*sweep(1, seeds=1), {0: "a"}).axes
    assert left.get_ylabel() == "return per episode"
    assert right.get_ylabel() == "share of 1 lane"


@pytest.mark.parametrize("count", [1, 2, 5, 29, 30, 50, 300, 12_345])
@pytest.mark.parametrize("success_at", [None, 450])
@pytest.mark.parametrize("length", [1, 12])
def test_episodes_have_whole_ticks_visible_points_and_a_legend_of_what_is_drawn(count, success_at, length):
    figure = drawn(plots.episode_lengths(np.full(count, length), success_at=success_at))
    (axes,) = figure.axes
    for axis in (axes.xaxis, axes.yaxis):
        places = ticks(axis)
        assert len(places) >= 2
        assert all(place == round(place) for place in places)
    low, high = axes.get_xlim()
    assert low < 1 <= count < high
    assert (axes.lines[0].get_marker() == "o") == (count < 30)
    expected = ["each episode", *["mean of 50"] * (count >= 50), *["success: 450 steps"] * (success_at is not None)]
    assert [entry.get_text() for entry in figure.legends[0].get_texts()] == expected
    assert all(line.get_marker() == "o" for line in axes.lines if len(line.get_xdata()) == 1)
    assert not figure.legends[0].get_window_extent().overlaps(axes.get_tightbbox())


def test_short_sweeps_have_whole_ticks():
    figure = drawn(plots.learning_curves([lane(0, 0, 1)], [point(0, 0, 1, 1.0)], {0: "s"}))
    places = ticks(figure.axes[0].xaxis)
    assert [place for place in places if 0 <= place <= 1] == [0, 1]
    assert all(place == round(place) for place in places)


EMPTY = [
    (lambda: plots.episode_lengths(np.array([], int), success_at=450), "no finished episode"),
    (lambda: plots.q_values(np.array([])), "no updates"),
    (lambda: plots.q_values(np.full(100, NAN, np.float32)), "no update with a finite value"),
    (lambda: plots.q_values(np.array([INF, -INF, NAN])), "no update with a finite value"),
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
    figure = drawn(plots.q_values(np.array([value], np.float32)))
    (axes,) = figure.axes
    assert axes.lines[0].get_marker() == "o"
    low, high = axes.get_ylim()
    assert low < value < high
    assert high - low >= 2
    assert ticks(axes.xaxis) == [0, 1, 2]


def test_values_that_diverge_are_drawn_to_the_last_and_their_end_is_marked():
    values = np.concatenate([np.full(100, NAN), 1.5 ** np.arange(200), [INF, NAN]]).astype(np.float32)
    figure = drawn(plots.q_values(values))
    (axes,) = figure.axes
    assert axes.get_yscale() == "symlog"
    assert [entry.get_text() for entry in figure.legends[0].get_texts()] == [
        "each step",
        "mean of 50",
        "not finite from step 301",
    ]
    assert np.isfinite(axes.lines[0].get_ydata()).sum() == 200
    assert not any(np.isinf(line.get_ydata()).any() for line in axes.lines)


def test_a_warm_up_is_no_divergence():
    figure = drawn(plots.q_values(np.concatenate([np.full(100, NAN), np.linspace(0, 100, 300)])))
    assert [entry.get_text() for entry in figure.legends[0].get_texts()] == ["each step", "mean of 50"]
    assert figure.axes[0].get_yscale() == "linear"


def test_a_mean_without_a_finite_window_has_no_entry():
    figure = drawn(plots.q_values(np.array([NAN] * 60 + [1.0, 2.0])))
    assert [entry.get_text() for entry in figure.legends[0].get_texts()] == ["each step"]


def test_the_arrays_that_are_drawn_stay_as_they_are():
    values = np.array([1.0, INF, NAN])
    plots.q_values(values)
    np.testing.assert_array_equal(values, [1.0, INF, NAN])


def test_a_picture_is_a_png_and_nothing_else_is_left(tmp_path):
    target = tmp_path / "picture.png"
    figure = plots.q_values(np.arange(100.0))
    assert plots.save(figure, target) == target
    height, width, _ = imread(target).shape
    np.testing.assert_allclose([width, height], 120 * figure.get_size_inches(), atol=1)
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
        plots.save(plots.q_values(np.zeros(3)), target)
    assert {file.name: file.read_bytes() for file in tmp_path.iterdir()} == ({target.name: before} if before else {})
