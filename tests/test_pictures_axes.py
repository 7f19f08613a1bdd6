"""What hyperparameters do: dots, lines and cells are the interquartile means of the lanes they stand for."""

import numpy as np
import pytest
from matplotlib.collections import LineCollection, PathCollection
from test_pictures_tables import (
    EMPTY_LANES,
    artists,
    drawn,
    inside,
    keys,
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

GRID = product(learning_rate=[1e-4, 1e-3, 1e-2], gamma=[0.95, 0.99])
WORDS = product(hidden=["64,64", "128,128", "256"], double=[False, True])


def returns(lanes, **where):
    """The greedy returns of the lanes with these values, 0 for a diverged one."""
    rows = [row for row in lanes.to_pylist() if all(row[name] == value for name, value in where.items())]
    return [0.0 if row["status"] == "diverged" else row["eval_return"] for row in rows]


def iqm(values):
    return stats.interquartile_mean(values)


def by_setting(lanes):
    """What a dot stands for, from the lowest setting on."""
    return [iqm(returns(lanes, config=config)) for config in sorted(set(lanes["config"].to_pylist()))]


def ends(lines):
    return [segment[:, 1].tolist() for segment in lines.get_segments()]


@pytest.mark.parametrize(("settings", "axis"), [(GRID, "gamma"), (GRID, "learning_rate"), (WORDS, "hidden")])
def test_dots_are_settings_and_the_line_all_lanes_with_a_value(settings, axis):
    lanes = swept(settings, 5)
    axes = drawn(pictures.sensitivity(lanes, axis, list(settings[0]))).axes[0]
    dots, line = axes.lines
    np.testing.assert_allclose(dots.get_ydata(), [one.value for one in by_setting(lanes)])
    values = list(dict.fromkeys(setting[axis] for setting in settings))
    pooled = [iqm(returns(lanes, **{axis: value})) for value in values]
    np.testing.assert_allclose(line.get_ydata(), [one.value for one in pooled])
    np.testing.assert_allclose(line.get_xdata(), range(3) if axis == "hidden" else values)
    intervals, *of_names = (one for one in axes.collections if isinstance(one, LineCollection))
    np.testing.assert_allclose(ends(intervals), [[one.low, one.high] for one in by_setting(lanes)])
    if axis == "hidden":
        assert line.get_linestyle() == "None"
        np.testing.assert_allclose(ends(*of_names), [[one.low, one.high] for one in pooled])
        return
    (band,) = (one for one in axes.collections if not isinstance(one, LineCollection))
    corners = {round(height, 6) for height in band.get_paths()[0].vertices[:, 1]}
    assert corners == {round(end, 6) for one in pooled for end in (one.low, one.high)}


def test_settings_of_one_value_stand_beside_each_other_and_nearer_to_it_than_to_the_next():
    lanes = swept(product(gamma=[0.9, 0.95, 0.99], alpha=[0.1, 0.2, 0.3]), 2)
    dots, line = pictures.sensitivity(lanes, "gamma", ["gamma", "alpha"]).axes[0].lines
    x = dots.get_xdata()
    assert len(set(x.round(9))) == 9
    nearest = np.abs(x[:, None] - line.get_xdata()).argmin(1)
    assert nearest.tolist() == [0, 0, 0, 1, 1, 1, 2, 2, 2]


def test_numbers_of_their_own_stand_where_they_are():
    settings = sobol(30)
    dots = pictures.sensitivity(swept(settings, 2), "gamma", ["gamma"]).axes[0].lines[0]
    assert dots.get_xdata().tolist() == [setting["gamma"] for setting in settings]


def test_many_values_are_averaged_in_bins_of_equally_many_lanes():
    settings = sobol(80)
    lanes = swept(settings, 3)
    line = pictures.sensitivity(lanes, "gamma", list(settings[0])).axes[0].lines[1]
    order = sorted(range(80), key=lambda config: settings[config]["gamma"])
    bins = [order[10 * i : 10 * (i + 1)] for i in range(8)]
    expected = [iqm([value for config in part for value in returns(lanes, config=config)]).value for part in bins]
    np.testing.assert_allclose(line.get_ydata(), expected)


def test_names_are_never_averaged_together():
    settings = product(name=[f"name {i}" for i in range(30)], x=[1, 2])
    lanes = swept(settings, 3)
    points = pictures.sensitivity(lanes, "name", ["name", "x"]).axes[0].lines[1]
    expected = [iqm(returns(lanes, name=name)).value for name in sorted({row["name"] for row in settings})]
    np.testing.assert_allclose(points.get_ydata(), expected)


def test_the_lanes_of_one_value_are_in_one_bin():
    settings = product(n=list(range(20)))
    line = pictures.sensitivity(swept(settings + [{"n": 0}] * 40, 2), "n", ["n"]).axes[0].lines[1]
    assert len(line.get_xdata()) < 8
    assert line.get_xdata()[0] == 0


def test_the_legend_says_what_a_line_averages_over():
    lanes = swept(product(gamma=[0.9, 0.99], alpha=[0.1, 0.2], n=[1, 3], tau=[1, 2]), 2)
    line = keys(pictures.sensitivity(lanes, "gamma", ["gamma", "alpha"]))[1]
    assert line == "all lanes with this value, whatever alpha, 95 % interval"
    line = keys(pictures.sensitivity(lanes, "gamma", ["gamma", "alpha", "n", "tau"]))[1]
    assert line == "all lanes with this value, whatever the other 3 hyperparameters, 95 % interval"


def test_one_seed_has_no_interval():
    axes = pictures.sensitivity(swept(GRID, 1), "gamma", list(GRID[0])).axes[0]
    assert not axes.collections
    figure = pictures.sensitivity(swept(GRID, 1), "gamma", list(GRID[0]))
    assert not any("95" in key for key in keys(figure))
    assert figure.axes[0].get_ylabel() == "greedy return"


def test_a_sweep_of_one_axis_has_no_line_beside_its_settings():
    figure = pictures.sensitivity(swept(product(gamma=[0.9, 0.99]), 5), "gamma", ["gamma"])
    assert keys(figure) == ["a setting, with its 95 % interval over seeds"]


def test_cells_are_the_interquartile_means_of_all_their_lanes_and_have_their_numbers():
    settings = product(learning_rate=[1e-4, 1e-3, 1e-2], gamma=[0.95, 0.99], alpha=[0.1, 0.2])
    lanes = swept(settings, 4)
    figure = drawn(pictures.heat_map(lanes, "learning_rate", "gamma"))
    axes, bar = figure.axes
    expected = [
        [iqm(returns(lanes, learning_rate=rate, gamma=gamma)).value for rate in (1e-4, 1e-3, 1e-2)]
        for gamma in (0.95, 0.99)
    ]
    np.testing.assert_allclose(axes.images[0].get_array(), expected)
    places = {text.get_position(): text.get_text() for text in axes.texts}
    assert places == {(j, i): f"{expected[i][j]:.0f}" for i in range(2) for j in range(3)}
    assert names(axes.xaxis) == ["0.0001", "0.001", "0.01"]
    assert names(axes.yaxis) == ["0.95", "0.99"]
    assert bar.get_ylabel() == "greedy return, interquartile mean"
    assert inside(figure)


def test_a_cell_without_a_lane_stays_empty():
    lanes = swept(product(x=[1, 2], y=[1, 2])[:3], 2)
    axes = drawn(pictures.heat_map(lanes, "x", "y")).axes[0]
    assert len(axes.texts) == 3
    assert np.isnan(np.ma.filled(axes.images[0].get_array(), np.nan)[1, 1])


def test_a_grid_of_many_cells_has_no_numbers():
    axes = drawn(pictures.heat_map(swept(product(x=list(range(30)), y=list(range(20))), 1), "x", "y")).axes[0]
    assert axes.images[0].get_array().shape == (20, 30)
    assert not axes.texts
    assert len(ticks(axes.xaxis)) <= 20


@pytest.mark.parametrize("settings", [4, 8, 32, 200])
@pytest.mark.parametrize(("x", "y"), [("learning_rate", "gamma"), ("gamma", "double"), ("hidden", "learning_rate")])
def test_scattered_values_are_dots_in_the_colour_of_the_metric(settings, x, y):
    rows = sobol(settings)
    lanes = swept(rows, 3)
    axes = drawn(pictures.heat_map(lanes, x, y)).axes[0]
    assert not axes.images
    (dots,) = (one for one in axes.collections if isinstance(one, PathCollection))
    heights = [one.value for one in by_setting(lanes)]
    order = np.argsort(heights)
    np.testing.assert_allclose(dots.get_array(), np.array(heights)[order])
    at = np.asarray(dots.get_offsets())
    for column, name in ((0, x), (1, y)):
        if name in ("learning_rate", "gamma"):
            np.testing.assert_allclose(at[:, column], [rows[config][name] for config in order])
    assert len(np.unique(at, axis=0)) == settings
    assert not axes.texts


def test_settings_that_were_stopped_have_crosses_and_this_is_said():
    says = "12 of 18 lanes were stopped at a rung: they have their return of then"
    lanes = swept(GRID, 3, status="solved", went=2)
    figure = drawn(pictures.sensitivity(lanes, "gamma", list(GRID[0])))
    heights = [one.value for one in by_setting(lanes)]
    dots, crosses, _ = figure.axes[0].lines
    assert (dots.get_marker(), crosses.get_marker()) == (".", "x")
    np.testing.assert_allclose(dots.get_ydata(), heights[:2])
    np.testing.assert_allclose(crosses.get_ydata(), heights[2:])
    assert keys(figure)[1].startswith("a setting that was stopped at a rung")
    assert note(figure) == says
    figure = drawn(pictures.heat_map(lanes, "learning_rate", "gamma"))
    (crosses,) = (one for one in figure.axes[0].collections if isinstance(one, PathCollection))
    assert sorted(map(tuple, np.round(crosses.get_offsets()).tolist())) == [(1, 0), (1, 1), (2, 0), (2, 1)]
    assert keys(figure) == ["every setting of the cell was stopped at a rung"]
    assert note(figure) == says


def test_scattered_settings_that_were_stopped_are_crosses_in_the_colours_of_the_others():
    rows = sobol(30)
    lanes = swept(rows, 3, status="solved", went=10)
    figure = drawn(pictures.heat_map(lanes, "learning_rate", "gamma"))
    crosses, dots = (one for one in figure.axes[0].collections if isinstance(one, PathCollection))
    heights = np.array([one.value for one in by_setting(lanes)])
    np.testing.assert_allclose(dots.get_array(), np.sort(heights[:10]))
    np.testing.assert_allclose(crosses.get_array(), np.sort(heights[10:]))
    assert crosses.get_clim() == dots.get_clim() == (heights.min(), heights.max())
    assert keys(figure) == ["a setting that was stopped at a rung"]


def test_diverged_lanes_are_said_in_every_picture():
    rows = [lane(c, s, gamma=(0.9, 0.99)[c], x=c) for c in range(2) for s in range(3)]
    rows[0] |= {"status": "diverged", "eval_return": None}
    lanes = table(rows)
    says = "1 of 6 lanes diverged and count as the worst"
    assert note(pictures.sensitivity(lanes, "gamma", ["gamma"])) == says
    assert note(pictures.heat_map(lanes, "gamma", "x")) == says


def test_times_to_success_are_written_with_k():
    settings = product(gamma=[0.9, 0.99], alpha=[0.1, 0.2])
    lanes = table([lane(c, s, 12_345, **row) for c, row in enumerate(settings) for s in range(3)])
    figure = drawn(pictures.heat_map(lanes, "gamma", "alpha", metric="solved_at_step"))
    assert {text.get_text() for text in figure.axes[0].texts} == {"12.3k"}
    figure = drawn(pictures.sensitivity(lanes, "gamma", ["gamma"], metric="solved_at_step"))
    assert figure.axes[0].get_ylabel() == "environment steps until solved,\ninterquartile mean"


ODD = {
    "diverged": (GRID, 4, {"status": "diverged"}),
    "unsolved": (GRID, 4, {"status": "finished"}),
    "one seed": (GRID, 1, {}),
    "one setting": (product(learning_rate=[1e-3], gamma=[0.99]), 8, {}),
    "one lane": (product(learning_rate=[1e-3], gamma=[0.99]), 1, {}),
    "halved": (GRID, 4, {"went": 2}),
    "stopped": (GRID, 4, {"status": "stopped"}),
    "words": (product(learning_rate=["a" * 90, "b_" * 40, "c"], gamma=[True, None]), 3, {}),
}


@pytest.mark.parametrize("metric", ["eval_return", "final_return", "area_under_curve", "solved_at_step"])
@pytest.mark.parametrize("kind", ODD)
def test_odd_sweeps_are_drawn(kind, metric):
    settings, seeds, other = ODD[kind]
    lanes = swept(settings, seeds, **other)
    for figure in (
        pictures.sensitivity(lanes, "learning_rate", list(settings[0]), metric=metric),
        pictures.sensitivity(lanes, "gamma", list(settings[0]), metric=metric),
        pictures.heat_map(lanes, "learning_rate", "gamma", metric=metric),
        pictures.heat_map(lanes, "gamma", "learning_rate", metric=metric),
    ):
        assert inside(drawn(figure))


def test_long_titles_lie_inside():
    long = "env.the_mass_of_the_heavy_cart_in_the_middle"
    lanes = swept(product(**{long: [1, 2], "env.the_length_of_the_other_pole": [1, 2]}), 2)
    figure = drawn(pictures.heat_map(lanes, long, "env.the_length_of_the_other_pole", metric="solved_at_step"))
    assert inside(figure)


def test_no_lanes_say_so():
    assert texts(drawn(pictures.sensitivity(EMPTY_LANES, "gamma", ["gamma"]))) == ["no lanes"]
    assert texts(drawn(pictures.heat_map(EMPTY_LANES, "gamma", "alpha"))) == ["no lanes"]


def test_a_thousand_settings_draw_few_artists():
    settings = sobol(1000)
    lanes = swept(settings, 2)
    for axis in settings[0]:
        assert artists(drawn(pictures.sensitivity(lanes, axis, list(settings[0])))) <= 5
    for x, y in (("learning_rate", "gamma"), ("hidden", "double"), ("gamma", "double")):
        assert artists(drawn(pictures.heat_map(lanes, x, y))) <= 12
