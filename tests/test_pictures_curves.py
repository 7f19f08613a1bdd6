"""Learning curves: what the reader sees stands on the figure's artists."""

import numpy as np
import pytest
import scipy.stats
from test_pictures_tables import (
    EMPTY_CURVES,
    EMPTY_LANES,
    INF,
    NAN,
    artists,
    curves_of,
    drawn,
    inside,
    keys,
    labels_of,
    lane,
    point,
    sobol,
    swept,
    table,
    texts,
    ticks,
)

from jaxq import pictures


def draw(lanes, curves, labels):
    return pictures.learning_curves(table(lanes), table(curves) if curves else EMPTY_CURVES, labels)


def sweep(settings, seeds=3):
    """Lanes of one length, whose returns grow with the setting, and their curves."""
    pairs = [(c, s) for c in range(settings) for s in range(seeds)]
    lanes = [lane(c, s, value=100.0 + c) for c, s in pairs]
    return lanes, [point(c, s, steps, steps / 10 + c + s) for c, s in pairs for steps in range(100, 1001, 100)]


def long_tail(final=1.0):
    """One setting of 100 lanes: 98 solved at 1000 steps, two that ran twenty times longer, of which some solved."""
    status = ["solved" if i < round(100 * final) - 98 else "finished" for i in range(2)]
    late = [lane(0, 98 + i, 20_000, status=status[i]) for i in range(2)]
    lanes = [lane(0, seed, 1000) for seed in range(98)] + late
    return lanes, [point(0, row["seed"], 500, 20.0) for row in lanes]


def label(axes):
    return ", ".join(f"some_hyperparameter_{i} 0.12{i}" for i in range(axes))


def size_of(axes):
    box = axes.get_window_extent()
    return [box.width, box.height]


LEGENDS = [(1, 1), (3, 1), (8, 1), (12, 1), (2, 3), (8, 3), (8, 7), (8, 30)]


@pytest.mark.parametrize(("settings", "axes"), LEGENDS, ids=str)
def test_the_legend_covers_no_panel_lies_inside_the_figure_and_leaves_the_panels_their_size(settings, axes):
    lanes, curves = sweep(settings)
    figure = drawn(draw(lanes, curves, {c: f"{label(axes)}, s {c}" for c in range(settings)}))
    (legend,) = figure.legends
    box = legend.get_window_extent()
    assert all(panel.get_legend() is None for panel in figure.axes)
    assert not any(box.overlaps(panel.get_tightbbox()) for panel in figure.axes)
    assert box.x0 >= 0
    assert box.y0 >= 0
    assert box.x1 <= figure.bbox.width
    small = drawn(draw(*sweep(1), {0: "s"}))
    for one, other in zip(figure.axes, small.axes, strict=True):
        np.testing.assert_allclose(size_of(one), size_of(other), rtol=0.04)


def test_the_legend_has_as_many_columns_as_fit_and_every_setting_once():
    lanes, curves = sweep(8)
    columns = {}
    for axes in (1, 3, 7):
        figure = drawn(draw(lanes, curves, {c: f"{label(axes)}, s {c}" for c in range(8)}))
        entries = figure.legends[0].get_texts()
        columns[axes] = len({round(entry.get_window_extent().x0) for entry in entries})
        assert [key[-3:] for key in keys(figure)] == [f"s {c}" for c in range(8)]
    assert columns[1] > columns[3] > 0
    assert columns[7] == 1


def test_a_name_is_never_parted_from_its_value():
    figure = draw(*sweep(1), {0: label(30)})
    lines = figure.legends[0].get_texts()[0].get_text().split("\n")
    assert len(lines) > 1
    assert all(line.rstrip(",").split(" ")[-1].startswith("0.12") for line in lines)


def test_settings_that_are_left_out_are_said_and_the_best_are_kept():
    figure = draw(*sweep(12), {c: f"s {c}" for c in range(12)})
    assert texts(figure) == ["8 of 12 settings, those of highest return"]
    assert keys(figure) == [f"s {c}" for c in range(4, 12)]


def test_one_seed_picks_no_best_settings():
    figure = draw(*sweep(12, seeds=1), {c: f"s {c}" for c in range(12)})
    assert texts(figure) == ["8 of 12 settings, the first: one seed ranks nothing"]
    assert keys(figure) == [f"s {c}" for c in range(8)]


def test_a_setting_without_a_return_comes_last():
    lanes, curves = sweep(8)
    lanes += [lane(c, s, value=value) for c, value in ((8, None), (9, NAN), (10, INF)) for s in range(2)]
    assert keys(draw(lanes, curves, {c: f"s {c}" for c in range(11)})) == [f"s {c}" for c in range(8)]


def test_nothing_is_said_when_nothing_is_left_out():
    assert texts(draw(*sweep(8), {c: f"s {c}" for c in range(8)})) == [""]


def test_no_two_settings_look_alike():
    right = draw(*sweep(8), {c: f"s {c}" for c in range(8)}).axes[1]
    assert len({line.get_color() for line in right.lines}) == 8
    assert {line.get_linestyle() for line in right.lines} == {"-", "--"}


@pytest.mark.parametrize("final", [0.98, 0.99, 1.0])
def test_the_final_share_can_be_read_where_the_axis_is_cut(final):
    figure = drawn(draw(*long_tail(final), {0: "s"}))
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
        lane(
            c,
            s,
            int(rng.integers(500, 1000)) if s < 980 else 20_000,
            status="solved" if s < 982 + 2 * c else "finished",
        )
        for c in range(8)
        for s in range(1000)
    ]
    figure = drawn(draw(lanes, [point(c, 0, 100, 9.0) for c in range(8)], dict.fromkeys(range(8), "s")))
    right = figure.axes[1]
    assert sorted(text.get_text() for text in right.texts) == ["0.99", "1.00"]
    boxes = [text.get_window_extent() for text in right.texts]
    assert all(right.bbox.x1 <= box.x0 < box.x1 <= figure.bbox.width for box in boxes)
    assert not any(one.overlaps(other) for i, one in enumerate(boxes) for other in boxes[:i])


def test_the_axis_is_whole_when_the_longest_lane_is_not_much_longer():
    lanes = [lane(0, seed, 1000 if seed < 98 else 1400) for seed in range(100)]
    figure = draw(lanes, [point(0, 0, 500, 20.0)], {0: "s"})
    assert figure.axes[1].get_xlim()[1] >= 1400
    assert texts(figure) == [""]


def test_a_setting_that_is_not_shown_does_not_stretch_the_axis():
    lanes, curves = sweep(8)
    lanes += [lane(8, seed, 50_000, status="finished", value=1.0) for seed in range(3)]
    assert draw(lanes, curves, dict.fromkeys(range(9), "s")).axes[1].get_xlim()[1] < 1100


def test_a_curve_begins_at_its_first_point_and_is_the_median_of_the_latest_returns():
    lanes = [lane(0, seed) for seed in range(3)]
    curves = [point(0, seed, steps, steps / 10 + seed) for seed in range(3) for steps in (500, 1000)]
    left = draw(lanes, curves, {0: "s"}).axes[0]
    x, y = left.lines[0].get_data()
    assert 500 <= x[0] < 510
    np.testing.assert_allclose(y, np.where(x < 1000, 51, 101))
    band = left.collections[0].get_paths()[0].vertices[:, 1]
    assert {band.min(), band.max()} == {50, 102}  # three seeds have a range and no interval


@pytest.mark.parametrize("seeds", [2, 5, 6, 17, 100])
def test_the_band_is_the_interval_of_the_median(seeds):
    values = np.random.default_rng(seeds).permutation(np.arange(1.0, seeds + 1))
    lanes = [lane(0, seed) for seed in range(seeds)]
    left = draw(lanes, [point(0, seed, 500, values[seed]) for seed in range(seeds)], {0: "s"}).axes[0]
    band = left.collections[0].get_paths()[0].vertices[:, 1]
    interval = scipy.stats.quantile_test(values, p=0.5).confidence_interval(0.95)
    low, high = np.where(np.isnan(interval), (1, seeds), interval)
    assert (band.min(), band.max()) == (low, high)
    assert np.isnan(interval).any() == (seeds < 6)
    assert left.get_ylabel().endswith("range" if seeds < 6 else "95 % interval")


def test_a_median_does_not_dip_where_no_lane_half_way_does():
    """Three of five lanes have 500 at one point, three others at the next: between them the median stays."""
    lanes = [lane(0, seed, 2000) for seed in range(5)]
    high = {1000: (0, 1, 2), 2000: (2, 3, 4)}
    curves = [point(0, seed, at, 500.0 if seed in high[at] else 0.0) for seed in range(5) for at in high]
    _, y = draw(lanes, curves, {0: "s"}).axes[0].lines[0].get_data()
    assert set(y) == {500.0}


def test_the_rows_of_a_curve_may_stand_in_any_order():
    lanes, curves = sweep(3)
    one, other = (draw(lanes, rows, dict.fromkeys(range(3), "s")) for rows in (curves, curves[::-1]))
    for a, b in zip(one.axes[0].lines, other.axes[0].lines, strict=True):
        np.testing.assert_array_equal(a.get_xydata(), b.get_xydata())


def test_evaluations_while_training_have_a_panel_of_their_own_and_the_one_at_the_end_has_none():
    lanes = [lane(0, seed) for seed in range(3)]
    curves = [point(0, seed, steps, 1.0, steps / 10 + seed) for seed in range(3) for steps in (500, 1000)]
    left, middle, _ = draw(lanes, curves, {0: "s"}).axes
    assert middle.get_title() == "return of greedy episodes"
    assert set(left.lines[0].get_ydata()) == {1.0}
    x, y = middle.lines[0].get_data()
    np.testing.assert_allclose(y, np.where(x < 1000, 51, 101))
    at_the_end = [row | {"eval_return": None} if row["env_steps"] < 1000 else row for row in curves]
    assert len(draw(lanes, at_the_end, {0: "s"}).axes) == 2


def test_who_does_not_look_for_success_has_no_share():
    def labels(stops):
        lanes = [lane(c, seed, stop=stop) for c, stop in enumerate(stops) for seed in range(3)]
        figure = draw(lanes, [], {0: "a", 1: "b"})
        return [len(axes.lines) for axes in figure.axes], keys(figure)

    assert labels(["none", "none"]) == ([0], ["a", "b"])
    assert labels(["streak", "none"]) == ([0, 1], ["a", "b"])
    watched = [point(c, s, steps, 1.0, 1.0) for c in range(2) for s in range(3) for steps in (500, 1000)]
    assert len(draw([lane(c, s, stop="none") for c in range(2) for s in range(3)], watched, "ab").axes) == 2


def test_a_curve_of_one_point_can_be_seen():
    line = draw([lane(0, 0, 20)], [point(0, 0, 20, 20.0)], {0: "s"}).axes[0].lines[0]
    assert line.get_xydata().tolist() == [[20.0, 20.0]]
    assert line.get_marker() == "o"


def test_diverged_lanes_are_counted_and_their_values_are_left_out():
    lanes = [lane(0, 0, 900, status="diverged", value=NAN), lane(0, 1, 900)]
    curves = [point(0, 0, 300, 20.0), point(0, 0, 600, INF), point(0, 0, 900, NAN), point(0, 1, 300, None)]
    figure = drawn(draw(lanes, curves, {0: "s"}))
    assert texts(figure) == ["1 of 2 lanes diverged and keep their last return"]
    assert set(figure.axes[0].lines[0].get_ydata()) == {20.0}


def test_lines_end_where_the_lanes_of_a_setting_were_stopped_and_this_is_said():
    lanes = [lane(0, seed, 1000) for seed in range(3)]
    lanes += [lane(1, seed, 300 + seed, status="stopped", value=400.0) for seed in range(3)]
    curves = [point(c, seed, steps, 10.0 + c, 10.0) for c in range(2) for seed in range(3) for steps in (100, 300)]
    figure = drawn(draw(lanes, curves, {0: "a", 1: "b"}))
    for axes in figure.axes:
        went, stopped = axes.lines
        assert went.get_xdata()[-1] == 1000
        assert went.get_marker() == "None"
        assert stopped.get_xdata()[-1] == 302
        assert (stopped.get_marker(), stopped.get_markevery()) == ("x", [-1])
    assert texts(figure)[-1] == "3 of 6 lanes were stopped at a rung: their settings' lines end there (x)"


def test_settings_that_came_furthest_are_kept_before_those_of_higher_return():
    lanes = [lane(c, s, value=100.0 + c) for c in range(3) for s in range(3)]
    lanes += [
        lane(c, s, status="stopped", value=500.0 - c, stopped_at_rung=c % 2) for c in range(3, 13) for s in (0, 1)
    ]
    figure = draw(lanes, [], {c: f"s {c}" for c in range(13)})
    assert keys(figure) == [f"s {c}" for c in (0, 1, 2, 3, 5, 7, 9, 11)]
    assert texts(figure)[-1].startswith("8 of 13 settings, those that came furthest, of these those of highest return")


def test_a_sweep_without_a_finished_episode_or_a_lane_says_so():
    figure = drawn(draw([lane(0, 0, 40, status="finished")], [point(0, 0, 40, None)], {0: "s"}))
    assert texts(figure) == ["no finished episode", ""]
    assert not ticks(figure.axes[0].yaxis)
    assert figure.axes[1].lines
    figure = drawn(pictures.learning_curves(EMPTY_LANES, EMPTY_CURVES, {}))
    assert texts(figure) == ["no lanes", "no lanes"]


def test_the_labels_say_what_is_counted():
    left, right = draw(*sweep(2), {0: "a", 1: "b"}).axes
    assert left.get_ylabel() == "return: median of 3 lanes, range"
    assert right.get_ylabel() == "share of 3 lanes"
    left, right = draw(*sweep(1, seeds=1), {0: "a"}).axes
    assert left.get_ylabel() == "return per episode"
    assert right.get_ylabel() == "share of 1 lane"


def test_short_sweeps_have_whole_ticks():
    figure = drawn(draw([lane(0, 0, 1)], [point(0, 0, 1, 1.0)], {0: "s"}))
    places = ticks(figure.axes[0].xaxis)
    assert [place for place in places if 0 <= place <= 1] == [0, 1]
    assert all(place == round(place) for place in places)


def test_a_thousand_settings_draw_as_many_artists_as_eight():
    def count(settings):
        lanes = swept(settings, 2)
        figure = drawn(pictures.learning_curves(lanes, curves_of(lanes), labels_of(settings)))
        assert inside(figure)
        return artists(figure)

    assert count(sobol(1000)) <= count(sobol(8)) + 24  # a final share at the edge is three more
