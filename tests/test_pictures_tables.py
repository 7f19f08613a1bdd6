"""Tables that pictures are drawn from, made up, what is read back from figures, and how columns are read."""

import itertools
import math

import numpy as np
import pyarrow as pa
import pytest

from jaxq.pictures.columns import by_setting, can_rank, metric_of, numbers, rungs

NAN, INF = math.nan, math.inf
LIMIT = 100_000
INTEGERS = (
    "config seed episodes env_steps updates max_env_steps max_episodes solved_at_episode solved_at_step "
    "diverged_at_step stopped_at_rung"
).split()
FLOATS = "final_return eval_return area_under_curve train_return loss max_q epsilon".split()


def table(rows):
    """Rows as a table; what is None is null, and a column of nothing but null has its type."""

    def kind(name):
        return pa.int64() if name in INTEGERS else pa.float64() if name in FLOATS else None

    return pa.table({name: pa.array([row[name] for row in rows], kind(name)) for name in rows[0]})


def lane(config, seed, steps=1000, *, status="solved", value=100.0, **other):
    solved, diverged = status == "solved", status == "diverged"
    row = {
        "config": config,
        "seed": seed,
        "stop": "streak",
        "max_env_steps": LIMIT,
        "max_episodes": LIMIT,
        "status": status,
        "episodes": steps // 10,
        "env_steps": steps,
        "updates": steps,
        "solved_at_episode": steps // 10 if solved else None,
        "solved_at_step": steps if solved else None,
        "diverged_at_step": steps if diverged else None,
        "stopped_at_rung": 0 if status == "stopped" else None,
        "final_return": value,
        "eval_return": None if diverged else value,
        "area_under_curve": value,
    }
    return row | other


def point(config, seed, steps, value, evaluated=None):
    return {"config": config, "seed": seed, "env_steps": steps, "train_return": value, "eval_return": evaluated}


EMPTY_CURVES = table([point(0, 0, 0, None)]).slice(0, 0)
EMPTY_LANES = pa.table({"config": pa.array([], pa.int64()), "seed": pa.array([], pa.int64())})


def product(**axes):
    return [dict(zip(axes, values, strict=True)) for values in itertools.product(*axes.values())]


def sobol(settings):
    """Settings with numbers of their own, as a sweep over ranges has them."""
    rng = np.random.default_rng(0)
    names = ["64,64", "128,128", "256"]
    return [
        {
            "learning_rate": float(10 ** rng.uniform(-5, -2)),
            "gamma": float(rng.uniform(0.9, 0.999)),
            "hidden": names[rng.integers(3)],
            "double": bool(rng.integers(2)),
        }
        for _ in range(settings)
    ]


def swept(settings, seeds, status=None, went=None, **other):
    """Lanes of settings; returns and statuses by chance unless all have one status. With halving the first ``went``
    settings went on, and the others were stopped at rung 0.
    """
    rng = np.random.default_rng(1)
    rows = []
    for config, setting in enumerate(settings):
        for seed in range(seeds):
            which = status or str(rng.choice(["solved", "finished", "diverged"], p=[0.6, 0.3, 0.1]))
            steps = LIMIT if which == "finished" else int(rng.integers(1000, LIMIT))
            if went is not None and config >= went:
                which, steps = "stopped", 1000
            rows.append(lane(config, seed, steps, status=which, value=float(rng.uniform(9, 500)), **setting, **other))
    return table(rows)


def curves_of(lanes):
    """Five rows for each lane, the last of which, and the second, are evaluated."""
    rows = []
    for row in lanes.select(["config", "seed", "env_steps", "final_return"]).to_pylist():
        for part in range(1, 6):
            value = part / 5 * row["final_return"]
            steps = part * row["env_steps"] // 5
            rows.append(point(row["config"], row["seed"], steps, value, value if part in (2, 5) else None))
    return table(rows)


def labels_of(settings):
    return {
        config: ", ".join(f"{name} {value}" for name, value in setting.items())
        for config, setting in enumerate(settings)
    }


def drawn(figure):
    """The figure after its layout; warnings on the way are errors."""
    figure.draw_without_rendering()
    return figure


def note(figure):
    return figure.legends[0].get_title().get_text() if figure.legends else ""


def keys(figure):
    """What the legend says, as it is without broken lines."""
    return [entry.get_text().replace("\n", " ") for entry in figure.legends[0].get_texts()] if figure.legends else []


def texts(figure):
    """Everything written in the axes, and the title of the legend."""
    notes = [legend.get_title().get_text() for legend in figure.legends]
    return [text.get_text() for axes in figure.axes for text in axes.texts] + notes


def ticks(axis):
    low, high = axis.get_view_interval()
    return [place for place in axis.get_majorticklocs() if low <= place <= high]


def names(axis):
    return [text.get_text().replace("\n", "") for text in axis.get_ticklabels()]


def artists(figure):
    return sum(len(a.lines) + len(a.collections) + len(a.patches) + len(a.texts) + len(a.images) for a in figure.axes)


def inside(figure):
    """Whether everything that is written lies inside the figure."""
    written = [text for axes in figure.axes for text in (axes.title, axes.xaxis.label, axes.yaxis.label, *axes.texts)]
    for axis in (axis for axes in figure.axes for axis in (axes.xaxis, axes.yaxis)):
        low, high = sorted(axis.get_view_interval())
        pairs = zip(axis.get_majorticklocs(), axis.get_ticklabels(), strict=False)  # shared axes have no labels
        written += [label for place, label in pairs if low <= place <= high]
    boxes = [text.get_window_extent() for text in written if text.get_text() and text.get_visible()]
    boxes += [legend.get_window_extent() for legend in figure.legends]
    width, height = figure.bbox.width + 1, figure.bbox.height + 1  # a pixel
    return all(box.x0 >= -1 and box.y0 >= -1 and box.x1 <= width and box.y1 <= height for box in boxes)


def test_a_column_is_numbers_with_nan_for_null():
    np.testing.assert_array_equal(numbers(table([lane(0, 0, status="finished")]), "solved_at_step"), [NAN])


def test_rows_by_setting_are_in_the_order_of_the_settings_whatever_that_of_the_table():
    lanes = table([lane(config, seed) for seed in range(2) for config in (2, 0)])
    groups = by_setting(lanes)
    assert {config: rows.tolist() for config, rows in groups.items()} == {0: [1, 3], 2: [0, 2]}
    assert list(groups) == [0, 2]
    assert by_setting(EMPTY_LANES) == {}


def test_a_setting_came_as_far_as_the_last_rung_that_stopped_a_lane_of_it():
    rows = [lane(0, 0), lane(1, 0), lane(1, 1, status="stopped"), lane(2, 0, status="stopped", stopped_at_rung=3)]
    assert rungs(table(rows)) == {0: INF, 1: 0.0, 2: 3.0}
    assert rungs(pa.table({"config": [0, 1], "seed": [0, 0], "status": ["finished"] * 2})) == {0: INF, 1: INF}


def test_one_seed_ranks_nothing():
    assert can_rank({0: np.arange(2), 1: np.arange(3)})
    assert not can_rank({0: np.arange(2), 1: np.arange(1)})


@pytest.mark.parametrize("least", [20.0, -20.0])
@pytest.mark.parametrize("metric", ["eval_return", "final_return"])
def test_a_diverged_lane_counts_as_0_or_the_least_whatever_it_had_returned(metric, least):
    lanes = table([lane(0, 0, value=least), lane(0, 1, value=400.0), lane(0, 2, status="diverged", value=300.0)])
    found = metric_of(lanes, metric)
    assert found.values.tolist() == [least, 400.0, min(0.0, least)]
    assert found.note == "1 of 3 lanes diverged and count as the worst"
    assert found.more_is_better


def test_a_lane_without_a_return_counts_as_the_worst_and_this_is_said():
    lanes = table([lane(0, 0), lane(0, 1, status="stopped", eval_return=None), lane(0, 2, status="diverged")])
    found = metric_of(lanes, "eval_return")
    assert found.values.tolist() == [100.0, 0.0, 0.0]
    worst, stopped = found.note.split("\n")
    assert worst == "1 of 3 lanes diverged, 1 of 3 lanes have no greedy return and count as the worst"
    assert stopped == "1 of 3 lanes were stopped at a rung: they have their return of then"


def test_the_training_return_stands_in_where_there_is_no_greedy_one():
    lanes = table([lane(0, seed, value=10.0 + seed, eval_return=None) for seed in range(2)])
    assert metric_of(lanes, "eval_return").name == "training return"
    assert metric_of(lanes, "eval_return").values.tolist() == [10.0, 11.0]


def test_all_diverged_count_as_0():
    found = metric_of(table([lane(0, seed, status="diverged", value=50.0) for seed in range(2)]), "eval_return")
    assert found.values.tolist() == [0.0, 0.0]


def test_a_lane_that_was_never_solved_counts_as_the_longest():
    lanes = table([lane(0, 0, 500), lane(0, 1, 2000, status="finished"), lane(0, 2, 300, status="diverged")])
    found = metric_of(lanes, "solved_at_step")
    assert found.values.tolist() == [500.0, 2000.0, 2000.0]
    assert found.note == "2 of 3 lanes were not solved and count as the longest"
    assert not found.more_is_better
    assert metric_of(lanes, "solved_at_episode").values.tolist() == [50.0, 200.0, 200.0]
    found = metric_of(table([lane(0, 0, 500), lane(0, 1, 200, status="stopped")]), "solved_at_step")
    assert found.note.startswith("1 of 2 lanes were not solved and count as the longest, 1 of them because a rung stop")


def test_where_no_lane_was_solved_the_greedy_return_stands_in_for_the_time():
    lanes = table([lane(0, seed, status="finished") for seed in range(2)])
    assert metric_of(lanes, "solved_at_step").name == "greedy return"


def test_a_metric_that_is_no_column_is_refused():
    with pytest.raises(
        ValueError, match="metric: 'reward' is no column of numbers of the lanes; known: episodes, env_"
    ):
        metric_of(table([lane(0, 0)]), "reward")
    with pytest.raises(ValueError, match=r"'eval_retrun' is no column .*; did you mean 'eval_return'\?"):
        metric_of(table([lane(0, 0)]), "eval_retrun")
    with pytest.raises(ValueError, match="metric: 'many' is no column of numbers"):
        metric_of(pa.table({"config": [0], "seed": [0], "status": ["finished"], "many": [[1.0]]}), "many")
