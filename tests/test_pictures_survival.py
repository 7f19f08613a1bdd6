"""Survival: curves, bands and ticks are Kaplan and Meier's of the lanes."""

import numpy as np
import pytest
from matplotlib.collections import LineCollection
from test_pictures_tables import (
    EMPTY_LANES,
    LIMIT,
    artists,
    drawn,
    inside,
    keys,
    labels_of,
    lane,
    note,
    product,
    sobol,
    swept,
    table,
    texts,
)

from jaxq import pictures, stats


def at(line, times):
    """The height of a step function just after each time."""
    x, y = line.get_data()
    return y[np.searchsorted(x, times, side="right") - 1]


def curves(axes):
    return [line for line in axes.lines if line.get_marker() == "None"]


@pytest.mark.parametrize(("clock", "scale"), [("env_steps", 1), ("episodes", 10)])
def test_the_curve_and_its_band_are_those_of_the_statistics(clock, scale):
    times, solved = [1000, 3000, 5000, LIMIT, 8000], [True, True, False, False, True]
    status = ["solved", "solved", "stopped", "finished", "solved"]
    rows = [lane(0, s, steps, status=one) for s, (steps, one) in enumerate(zip(times, status, strict=True))]
    rows = [row | ({"episodes": row["max_episodes"]} if row["status"] == "finished" else {}) for row in rows]
    axes = drawn(pictures.survival(table(rows), {0: "s"}, clock=clock)).axes[0]
    ends = [LIMIT * scale if time == LIMIT else time for time in times]
    expected = stats.survival([time / scale for time in ends], solved)
    (line,) = curves(axes)
    np.testing.assert_allclose(at(line, expected.times), expected.share)
    (band,) = (one for one in axes.collections if not isinstance(one, LineCollection))
    heights = np.concatenate([path.vertices[:, 1] for path in band.get_paths()])
    known = np.isfinite(expected.low)
    for end in (*expected.low[known], *expected.high[known]):
        assert np.abs(heights - end).min() < 1e-9
    assert axes.get_xlabel() == {"env_steps": "environment steps", "episodes": "episodes"}[clock]


def test_a_tick_marks_a_seed_that_was_watched_no_longer_and_none_one_that_diverged():
    rows = [lane(0, 0, 1000), lane(0, 1, 2000, status="stopped"), lane(0, 2, 500, status="diverged")]
    figure = drawn(pictures.survival(table(rows), {0: "s"}))
    (ticks,) = (line for line in figure.axes[0].lines if line.get_marker() == "|")
    np.testing.assert_allclose(ticks.get_xydata(), [[2000, 2 / 3]])
    assert "|: a seed watched no longer" in note(figure)
    assert "1 of 3 seeds diverged and count as never solved\n1 of 3 lanes were stopped at a rung" in note(figure)


def test_why_a_seed_counts_as_never_solved_is_said():
    rows = [lane(0, 0, 1000), lane(0, 1, 2000, status="finished", episodes=LIMIT), lane(0, 2, 500, status="diverged")]
    says = note(pictures.survival(table(rows), {0: "s"}))
    assert "1 of 3 seeds diverged, 1 of 3 seeds reached max_episodes and count as never solved" in says
    says = note(pictures.survival(table(rows[:2]), {0: "s"}))
    assert "1 of 2 seeds reached max_episodes and count as never solved" in says
    assert "diverged" not in says
    rows = [lane(0, 0, 1000), lane(0, 1, LIMIT, status="finished")]
    assert "never" not in note(pictures.survival(table(rows), {0: "s"}))
    says = note(pictures.survival(table(rows), {0: "s"}, clock="episodes"))
    assert "1 of 2 seeds reached max_env_steps and count as never solved" in says


def halved(solved):
    """Settings that went to the end, of which some were solved, and as many as make 30 that were stopped early."""
    rows = [lane(c, s, 90_000 + c, status="solved" if c in solved else "finished") for c in range(3) for s in range(2)]
    return rows + [lane(c, s, 1000 + c, status="stopped") for c in range(3, 30) for s in range(2)]


def test_only_settings_with_a_solved_seed_have_colours_where_some_are_grey():
    figure = drawn(pictures.survival(table(halved({0, 2})), {c: f"s {c}" for c in range(30)}))
    assert keys(figure) == ["s 0", "s 2"]
    first, *_, last = note(figure).split("\n")
    assert first == "2 of 30 settings, those with a solved seed; the others are grey"
    assert last == "54 of 60 lanes were stopped at a rung: watched until then"
    ends = sorted(segment[-1, 0] for segment in figure.axes[0].collections[0].get_segments())
    assert ends == [*range(1003, 1030), 90_002]  # none goes on after its last seed was watched
    none = drawn(pictures.survival(table(halved(())), {c: f"s {c}" for c in range(30)}))
    assert keys(none) == []
    assert note(none).startswith("no seed of the 30 settings was solved")


def test_what_was_stopped_is_not_among_the_quickest_where_eight_went_to_the_end():
    rows = [lane(c, s, 90_000) for c in range(8) for s in range(2)]
    rows += [lane(c, 0, 500) for c in (8, 9)] + [lane(c, 1, 1000, status="stopped") for c in (8, 9)]
    figure = drawn(pictures.survival(table(rows), {c: f"s {c}" for c in range(10)}))
    assert keys(figure) == [f"s {c}" for c in range(8)]


def test_bands_are_named_only_where_one_was_computed():
    assert "bands: 95 % intervals" in note(pictures.survival(swept(product(x=[1]), 5, status="solved"), {0: "s"}))
    for seeds, status in ((1, "solved"), (5, "finished"), (5, "diverged")):
        figure = drawn(pictures.survival(swept(product(x=[1]), seeds, status=status), {0: "s"}))
        assert "bands" not in note(figure)


def test_eight_settings_have_colours_the_quickest_and_the_others_are_grey():
    rows = [lane(c, s, 1000 * (12 - c) + s) for c in range(12) for s in range(3)]
    figure = drawn(pictures.survival(table(rows), {c: f"s {c}" for c in range(12)}))
    assert keys(figure) == [f"s {c}" for c in range(4, 12)]
    assert note(figure).startswith("8 of 12 settings, the quickest; the others are grey")
    grey = figure.axes[0].collections[0]
    assert len(grey.get_segments()) == 4
    assert len({line.get_color() for line in curves(figure.axes[0])}) == 8
    ends = sorted(segment[segment[:, 1] == 0][0, 0] for segment in grey.get_segments())
    assert ends == [9002, 10002, 11002, 12002]


def test_one_seed_picks_no_quickest_settings():
    rows = [lane(c, 0, 1000 * (12 - c)) for c in range(12)]
    figure = drawn(pictures.survival(table(rows), {c: f"s {c}" for c in range(12)}))
    assert keys(figure) == [f"s {c}" for c in range(8)]
    assert note(figure).startswith("8 of 12 settings, the first with a solved seed, as one seed ranks nothing; the oth")


def test_settings_that_do_not_look_for_success_have_no_curve():
    rows = [lane(c, s, stop=("none", "window")[c]) for c in range(2) for s in range(3)]
    assert keys(pictures.survival(table(rows), {0: "a", 1: "b"})) == ["b"]
    none = table([lane(0, s, stop="none") for s in range(3)])
    assert texts(drawn(pictures.survival(none, {0: "a"}))) == ["no setting looks for success"]
    assert texts(drawn(pictures.survival(EMPTY_LANES, {}))) == ["no lanes"]


def test_another_clock_is_refused():
    with pytest.raises(ValueError, match="clock: 'updates' is not one of env_steps, episodes"):
        pictures.survival(swept(product(x=[1]), 2), {0: "s"}, clock="updates")


@pytest.mark.parametrize("clock", ["env_steps", "episodes"])
@pytest.mark.parametrize(("settings", "seeds"), [(1, 1), (1, 8), (8, 1), (40, 3), (1000, 4)])
@pytest.mark.parametrize("status", [None, "finished", "diverged"])
def test_every_sweep_is_drawn_by_few_artists_inside_the_figure(settings, seeds, status, clock):
    rows = sobol(settings)
    figure = drawn(pictures.survival(swept(rows, seeds, status=status), labels_of(rows), clock=clock))
    assert artists(figure) <= 3 * 8 + 1
    assert inside(figure)
