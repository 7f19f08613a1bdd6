"""Pictures: what is left out is said, nothing covers anything, and the edges of the data read well."""

import numpy as np
import pytest
from matplotlib.figure import Figure

from jaxq import plots


def sweep(settings, *, seeds=4, ends=(1000,), solved=True, window=50):
    """Rows of a sweep whose lanes gather return up to their ends, which go round."""
    lanes, curves = [], []
    for config in range(settings):
        for seed in range(seeds):
            end = ends[seed % len(ends)]
            key = {"config": config, "seed": seed}
            solved_at = (
                {"status": "solved", "solved_at_step": end}
                if solved
                else {"status": "finished", "solved_at_step": None}
            )
            lanes.append(
                {**key, **solved_at, "env_steps": end, "final_return": float(config), "success_window": window}
            )
            for part in range(1, 5):
                curves.append({**key, "env_steps": end * part // 4, "train_return": float(config * part)})
    return lanes, curves


def drawn(settings=1, label="gamma 0.9", **of):
    figure = plots.learning_curves(*sweep(settings, **of), {c: f"{label} {c}" for c in range(settings)})
    figure.draw_without_rendering()
    return figure


def words(axes):
    return [text.get_text() for text in axes.texts]


@pytest.mark.parametrize(("settings", "axes"), [(1, 1), (3, 1), (8, 3), (12, 3), (12, 9)])
def test_the_legend_covers_nothing_and_stays_inside(settings, axes):
    figure = drawn(settings, label=", ".join(["velocity_bound 0.5"] * axes))
    (legend,) = figure.legends
    box, whole = legend.get_window_extent(), figure.bbox
    assert whole.x0 <= box.x0 < box.x1 <= whole.x1
    assert whole.y0 <= box.y0
    for panel in figure.axes:
        below = panel.get_tightbbox()
        assert box.y1 <= below.y0 + 1
        assert panel.get_window_extent().height > 250  # of 100 pixels an inch: it has not given way to the legend


def test_settings_that_are_not_drawn_are_counted():
    (legend,) = drawn(12).legends
    assert legend.get_title().get_text() == "8 of 12 settings, those of highest return"
    assert [text.get_text().split(":")[0] for text in legend.get_texts()] == [f"gamma 0.9 {c}" for c in range(4, 12)]
    (legend,) = drawn(8).legends
    assert legend.get_title().get_text() == ""


def test_what_lies_beyond_the_axis_is_said_and_the_legend_has_the_share_in_the_end():
    ends = [1000] * 99 + [50_000]
    for axes in (figure := drawn(seeds=100, ends=ends)).axes:
        assert axes.get_xlim() == (0, 1000)
        assert "run on to the right" in axes.get_xlabel()
    assert figure.axes[1].lines[0].get_ydata()[-1] == 0.99
    assert figure.legends[0].get_texts()[0].get_text().endswith("1.00 solved")
    assert drawn().axes[0].get_xlabel() == "environment steps"


def test_a_curve_begins_with_its_first_point():
    left, _ = drawn().axes
    assert left.lines[0].get_xdata()[0] == pytest.approx(250, rel=0.03)


def test_who_does_not_look_for_success_has_no_share():
    figure = drawn(solved=False, window=0)
    assert words(figure.axes[1]) == ["no setting ends by success"]
    assert figure.legends[0].get_texts()[0].get_text() == "gamma 0.9 0"
    assert drawn(solved=False).axes[1].lines[0].get_ydata().max() == 0


def test_a_sweep_without_a_finished_episode_says_so():
    lanes, _ = sweep(2, solved=False)
    figure = plots.learning_curves(lanes, [], {0: "a", 1: "b"})
    figure.draw_without_rendering()
    assert words(figure.axes[0]) == ["no episode ended"]


@pytest.mark.parametrize("count", [1, 2, 3, 29, 600])
def test_ticks_are_whole_and_few_points_are_marked(count):
    for figure in (
        plots.episode_lengths(np.full(count, 20), success_at=450.0),
        plots.q_values(np.linspace(0, 1, count)),
    ):
        figure.draw_without_rendering()
        (axes,) = figure.axes
        ticks = axes.get_xticks()
        np.testing.assert_array_equal(ticks, np.round(ticks))
        assert (axes.lines[0].get_marker() == "o") == (count < plots.FEW)


@pytest.mark.parametrize("values", [[], [np.nan] * 127, [np.inf] * 3])
def test_no_value_is_said_and_not_drawn(values):
    figure = plots.q_values(np.array(values))
    figure.draw_without_rendering()
    assert words(figure.axes[0]) == ["no finite value"]
    assert not len(figure.axes[0].get_xticks())
    empty = plots.episode_lengths(np.array([]), success_at=450.0)
    assert words(empty.axes[0]) == ["no episode ended"]


def test_what_is_finite_of_a_diverged_training_is_drawn():
    figure = plots.q_values(np.array([np.nan] * 100 + [1.0, 2.0, np.inf, np.nan]))
    figure.draw_without_rendering()
    (line,) = figure.axes[0].lines  # no mean: every window of it holds a value that is none
    assert np.nanmax(line.get_ydata()) == 2
    assert line.get_marker() == "o"


def test_a_picture_is_written_whole_or_not_at_all(tmp_path, monkeypatch):
    path = plots.save(plots.q_values(np.arange(5.0)), tmp_path / "q_values.png")
    before = path.read_bytes()
    assert before.startswith(b"\x89PNG")

    def half(figure, file, **_):
        file.write_bytes(b"half")
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(Figure, "savefig", half)
    with pytest.raises(OSError, match="No space"):
        plots.save(plots.q_values(np.arange(5.0)), path)
    assert path.read_bytes() == before
    assert list(tmp_path.iterdir()) == [path]
