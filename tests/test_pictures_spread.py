"""The spread of the seeds: rows of dots for a few settings, ranks for many."""

import numpy as np
import pytest
from matplotlib.collections import LineCollection
from test_pictures_tables import (
    EMPTY_LANES,
    artists,
    drawn,
    inside,
    keys,
    labels_of,
    lane,
    names,
    note,
    product,
    sobol,
    swept,
    table,
    texts,
    ticks,
)

from jaxq import pictures, stats


def returns(lanes):
    found = {}
    for row in lanes.to_pylist():
        value = 0.0 if row["status"] == "diverged" else row["eval_return"]
        found.setdefault(row["config"], []).append(value)
    return found


def test_rows_are_seeds_with_their_interquartile_mean_and_interval_the_best_on_top():
    lanes = swept(product(x=list(range(6))), 7)
    figure = drawn(pictures.spread(lanes, {c: f"s {c}" for c in range(6)}))
    axes = figure.axes[0]
    found = returns(lanes)
    estimates = {c: stats.interquartile_mean(values) for c, values in found.items()}
    order = sorted(found, key=lambda c: -estimates[c].value)
    assert names(axes.yaxis) == [f"s {c}" for c in order]
    low, high = axes.get_ylim()
    assert low > high  # row 0 is on top
    dots, middles = axes.lines[::2], axes.lines[1::2]
    intervals = [one for one in axes.collections if isinstance(one, LineCollection)]
    for row, config in enumerate(order):
        assert sorted(dots[row].get_xdata()) == sorted(found[config])
        assert np.abs(np.asarray(dots[row].get_ydata()) - row).max() < 0.25
        np.testing.assert_allclose(middles[row].get_xydata(), [[estimates[config].value, row]])
        (segment,) = intervals[row].get_segments()
        np.testing.assert_allclose(segment[:, 0], [estimates[config].low, estimates[config].high])
    assert keys(figure) == ["a seed", "interquartile mean, 95 % interval"]


def test_the_quickest_is_on_top_where_less_is_better():
    lanes = table([lane(c, s, 1000 * (3 - c) + s) for c in range(3) for s in range(3)])
    figure = pictures.spread(lanes, {c: f"s {c}" for c in range(3)}, metric="solved_at_step")
    assert names(figure.axes[0].yaxis) == ["s 2", "s 1", "s 0"]
    assert figure.axes[0].get_xlabel() == "environment steps until solved"


@pytest.mark.parametrize("settings", [6, 60])
def test_one_seed_is_a_value_without_rank_mean_or_interval(settings):
    rows = [lane(c, 0, value=float((7 * c) % settings), gamma=c) for c in range(settings)]
    figure = drawn(pictures.spread(table(rows), {c: f"s {c}" for c in range(settings)}))
    assert note(figure) == "one seed: in the order of the sweep, not by rank"
    assert not figure.axes[0].collections
    values = np.concatenate([np.asarray(line.get_xdata()) for line in figure.axes[0].lines])
    if settings == 60:
        values = np.asarray(figure.axes[0].lines[0].get_ydata())
        assert figure.axes[0].get_xlabel() == "setting"
    else:
        assert names(figure.axes[0].yaxis) == [f"s {c}" for c in range(settings)]
    assert values.tolist() == [(7 * c) % settings for c in range(settings)]
    assert keys(figure) == ["a seed" if settings == 6 else "the setting's one seed"]


def test_one_lane_says_nothing_of_ranks():
    assert note(pictures.spread(table([lane(0, 0)]), {0: "s"})) == ""


def test_many_settings_are_ranked_with_the_quartiles_and_the_range_of_their_seeds():
    settings = sobol(100)
    lanes = swept(settings, 8)
    labels = labels_of(settings)
    figure = drawn(pictures.spread(lanes, labels))
    axes = figure.axes[0]
    found = returns(lanes)
    middle = {c: stats.interquartile_mean(values).value for c, values in found.items()}
    order = sorted(found, key=lambda c: (-middle[c], c))
    x, y = axes.lines[0].get_data()
    assert x.tolist() == list(range(1, 101))
    np.testing.assert_allclose(y, [middle[c] for c in order])
    for band, (low, high) in zip(axes.collections, ((0, 100), (25, 75)), strict=True):
        heights = band.get_paths()[0].vertices[:, 1]
        for end in (low, high):
            expected = [np.percentile(found[c], end) for c in order]
            assert all(np.abs(heights - value).min() < 1e-6 for value in expected)
    assert keys(figure) == ["range of the seeds", "quartiles of the seeds", "interquartile mean"]
    assert f"first: {labels[order[0]]}" in note(figure)
    assert f"last: {labels[order[-1]]}" in note(figure)


def test_settings_that_were_stopped_come_last_and_have_crosses():
    lanes = table(
        [lane(c, s, value=value) for c, value in ((0, 100.0), (1, 200.0)) for s in range(3)]
        + [lane(c, s, status="stopped", value=500.0 - c, stopped_at_rung=c - 2) for c in (2, 3) for s in range(3)]
    )
    figure = drawn(pictures.spread(lanes, {c: f"s {c}" for c in range(4)}))
    assert names(figure.axes[0].yaxis) == ["s 1", "s 0", "s 3", "s 2"]
    assert [line.get_marker() for line in figure.axes[0].lines[::2]] == [".", ".", "x", "x"]
    assert keys(figure)[1] == "a seed of a setting that was stopped at a rung"
    assert note(figure) == "6 of 12 lanes were stopped at a rung: they have their return of then"


def test_many_settings_that_were_stopped_stand_right_of_a_line():
    settings = sobol(100)
    figure = drawn(pictures.spread(swept(settings, 4, went=30), labels_of(settings)))
    means, line = figure.axes[0].lines
    assert line.get_xdata() == [30.5, 30.5]
    found = returns(swept(settings, 4, went=30))
    middle = {c: stats.interquartile_mean(values).value for c, values in found.items()}
    order = sorted(found, key=lambda c: (c >= 30, -middle[c], c))
    np.testing.assert_allclose(means.get_ydata(), [middle[c] for c in order])
    assert "right of the line: settings that were stopped at a rung" in note(figure)


def test_every_line_of_the_note_has_its_own_line_and_lies_inside():
    settings = product(**{f"some_rather_long_hyperparameter_{i}": [1] for i in range(9)}, last=list(range(50)))
    figure = drawn(pictures.spread(swept(settings, 3), labels_of(settings)))
    lines = note(figure).split("\n")
    assert "diverged" in lines[0]
    assert "first" not in lines[0]
    assert sum(line.startswith(("first: ", "last: ")) for line in lines) == 2
    assert inside(figure)


@pytest.mark.parametrize(("count", "rows"), [(40, True), (41, False)])
def test_up_to_forty_settings_have_rows(count, rows):
    figure = pictures.spread(swept(product(x=list(range(count))), 2), {c: f"s {c}" for c in range(count)})
    assert (len(names(figure.axes[0].yaxis)) == count) == rows


def test_equal_values_do_not_lie_on_the_edge():
    lanes = table([lane(c, s, value=500.0) for c in range(2) for s in range(3)])
    low, high = pictures.spread(lanes, {0: "a", 1: "b"}).axes[0].get_xlim()
    assert low < 500 < high


def test_values_below_one_have_ticks_as_they_are():
    lanes = table([lane(c, s, value=0.1 * s) for c in range(2) for s in range(5)])
    axes = drawn(pictures.spread(lanes, {0: "a", 1: "b"})).axes[0]
    np.testing.assert_allclose(
        [float(name.replace("\N{MINUS SIGN}", "-")) for name in names(axes.xaxis)], axes.get_xticks()
    )
    assert len(ticks(axes.xaxis)) > 3


@pytest.mark.parametrize("metric", ["eval_return", "final_return", "solved_at_step"])
@pytest.mark.parametrize("status", [None, "finished", "diverged"])
@pytest.mark.parametrize(("settings", "seeds"), [(1, 1), (1, 8), (30, 2), (300, 1), (300, 3)])
def test_odd_sweeps_are_drawn_inside_the_figure(settings, seeds, status, metric):
    rows = sobol(settings)
    figure = drawn(pictures.spread(swept(rows, seeds, status=status), labels_of(rows), metric=metric))
    assert inside(figure)


def test_no_lanes_say_so():
    assert texts(drawn(pictures.spread(EMPTY_LANES, {}))) == ["no lanes"]


def test_a_thousand_settings_draw_three_artists():
    settings = sobol(1000)
    assert artists(drawn(pictures.spread(swept(settings, 2), labels_of(settings)))) == 3
