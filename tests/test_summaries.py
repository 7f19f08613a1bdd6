"""A row per setting: what is counted, what is censored, and what ranks."""

import numpy as np
import pyarrow as pa
import pytest

from jaxq import stats, summaries

BASE = {
    "config": 0,
    "stop": "streak",
    "max_episodes": 100,
    "max_env_steps": 10_000,
    "status": "finished",
    "episodes": 100,
    "env_steps": 5_000,
    "solved_at_episode": None,
    "solved_at_step": None,
    "final_return": 100.0,
    "eval_return": 200.0,
    "area_under_curve": 50.0,
    "gamma": 0.9,
    "stopped_at_rung": None,
}
COUNTS = ("solved_at_episode", "solved_at_step", "stopped_at_rung")
REALS = ("final_return", "eval_return", "area_under_curve")


def table(*rows):
    found = pa.Table.from_pylist([{**BASE, "seed": i, **row} for i, row in enumerate(rows)])
    for name in (*COUNTS, *REALS):
        column = found[name].cast(pa.int64() if name in COUNTS else pa.float64())
        found = found.set_column(found.column_names.index(name), name, column)
    return found


def solved(episode, step, **more):
    at = {"status": "solved", "solved_at_episode": episode, "solved_at_step": step}
    return {**at, "episodes": episode, "env_steps": step, **more}


def diverged(**more):
    lost = {"status": "diverged", "episodes": 3, "env_steps": 60, "final_return": 1.0, "eval_return": None}
    return {**lost, **more}


def only(*rows, **options):
    (row,) = summaries.summary(table(*rows), [], **options)
    return row


def test_shares_have_wilsons_interval_and_returns_leave_diverged_lanes_out():
    row = only(solved(10, 1000, eval_return=500.0), {}, {"eval_return": 480.0}, diverged(), threshold=475.0)
    assert (row["seeds"], row["diverged"], row["stopped"]) == (4, 1, 0)
    assert (row["solved"], row["solved_low"], row["solved_high"]) == stats.share(1, 4)
    assert (row["reached"], row["reached_low"], row["reached_high"]) == stats.share(2, 4)
    assert row["eval_return"] == stats.interquartile_mean([500.0, 200.0, 480.0]).value
    assert (row["eval_median"], row["eval_mean"]) == (480.0, pytest.approx(1180 / 3))
    assert row["final_return"] == 100.0


def test_nobody_who_does_not_look_for_success_has_a_share_of_it():
    row = only({"stop": "none"}, {"stop": "none"})
    assert row["solved"] is row["median_episodes"] is row["median_env_steps"] is row["reached"] is None


def test_one_seed_has_values_and_no_interval():
    row = only(solved(10, 1000), threshold=475.0)
    assert (row["solved"], row["reached"], row["median_episodes"], row["eval_return"]) == (1.0, 0.0, 10.0, 200.0)
    assert not [name for name in row if name.endswith(("_low", "_high")) and row[name] is not None]


def test_a_lane_that_ran_out_of_the_other_clock_is_later_than_all():
    """It ended after 50 steps, out of episodes: by the clock of steps it is not censored there, it was never solved."""
    short = {"episodes": 100, "env_steps": 50}
    row = only(solved(10, 1000), solved(20, 2000), short, short, short)
    assert row["median_env_steps"] is None  # censored at 50 the median of the two that are left would be 1000
    assert row["median_episodes"] is None
    times, observed = [1000, 2000, np.inf, np.inf, np.inf], [True, True, False, False, False]
    assert (row["median_env_steps"], row["median_env_steps_low"]) == stats.kaplan_meier_median(times, observed)[:2]


def test_a_lane_that_halving_stopped_was_watched_until_then():
    stopped = {"status": "stopped", "episodes": 5, "env_steps": 50, "stopped_at_rung": 0}
    row = only(solved(10, 1000), solved(20, 2000), stopped)
    assert row["stopped"] == 1
    wanted = stats.kaplan_meier_median([1000, 2000, 50], [True, True, False])
    assert (row["median_env_steps"], row["median_env_steps_low"], row["median_env_steps_high"]) == wanted


STOPPED = {"status": "stopped", "episodes": 5, "env_steps": 50, "stopped_at_rung": 0}


def test_a_lane_that_halving_stopped_is_no_failure_and_no_success():
    row = only(solved(10, 1000), {}, STOPPED, STOPPED)
    assert (row["solved"], row["solved_low"], row["solved_high"]) == stats.share(1, 2)
    assert (row["stopped"], row["stopped_at_rung"]) == (2, 0)
    row = only(STOPPED, STOPPED | {"stopped_at_rung": 1})
    assert row["solved"] is row["solved_low"] is row["solved_high"] is None
    assert (row["stopped"], row["stopped_at_rung"]) == (2, 1)
    assert only(solved(10, 1000), {})["stopped_at_rung"] is None


def test_settings_that_went_to_the_end_come_before_those_that_were_stopped_the_further_the_sooner():
    ended = [{"eval_return": value} for value in (100.0, 200.0)]
    early, late = ({**STOPPED, "eval_return": value, "stopped_at_rung": k} for value, k in ((500.0, 0), (300.0, 1)))
    rows = [{**one, "config": c} for c, one in enumerate([early, late, *ended]) for _ in range(2)]
    found = summaries.summary(table(*rows), [])
    assert [row["config"] for row in summaries.ranked(found)] == [3, 2, 1, 0]
    assert summaries.best(found)["config"] == 3
    lost = [{**row, "eval_return": None} if row["config"] >= 2 else row for row in found]
    assert summaries.best(lost)["config"] == 1  # there is no other with a return


def test_rows_come_in_the_order_of_the_settings_with_what_varied():
    rows = table({"config": 1, "gamma": 0.99}, {"config": 0}, {"config": 1, "gamma": 0.99})
    found = summaries.summary(rows, ["gamma"])
    assert [(row["config"], row["gamma"], row["seeds"]) for row in found] == [(0, 0.9, 1), (1, 0.99, 2)]


def test_no_lanes_have_no_rows():
    assert summaries.summary(pa.table({"config": pa.array([], pa.int64()), "seed": pa.array([], pa.int64())}), []) == []


def settings(*values):
    names = ("eval_return", "eval_mean", "median_env_steps", "seeds")
    rows = [dict(zip(names, one, strict=True)) for one in values]
    return [{"config": i, "seeds": row["seeds"], **row} for i, row in enumerate(rows)]


def test_ties_are_ranked_by_the_mean_then_by_the_time_then_by_the_order():
    rows = settings((500, 440, 10, 4), (500, 490, 90, 4), (500, 490, 80, 4), (None, None, None, 4), (500, 490, None, 4))
    assert [row["config"] for row in summaries.ranked(rows)] == [2, 1, 4, 0, 3]
    assert summaries.best(rows)["config"] == 2


def test_one_seed_ranks_nothing_and_a_column_must_be_there():
    with pytest.raises(ValueError, match="one seed ranks no settings"):
        summaries.best(settings((500, 500, 1, 1)))
    with pytest.raises(ValueError, match=r"'eval_retrun' is no column of the summary; did you mean 'eval_return'\?"):
        summaries.best(settings((500, 500, 1, 2)), "eval_retrun")
    with pytest.raises(ValueError, match="'x' is no column of the summary; known: eval_return, eval_mean, median_env"):
        summaries.best(settings((500, 500, 1, 2)), "x")
    with pytest.raises(ValueError, match="no setting has eval_return"):
        summaries.best(settings((None, None, None, 2)))


def test_a_functions_outputs_are_averaged_each():
    rows = [
        {"config": c, "seed": s, "r": c, "status": "finished", "area": c + s, "word": "x"}
        for c in (0, 1)
        for s in (0, 2)
    ]
    first, second = summaries.summary(pa.Table.from_pylist(rows), ["r"])
    assert (first["area"], second["area"], first["r"], second["r"]) == (1.0, 2.0, 0, 1)
    assert (first["area_low"], first["area_high"]) == stats.interquartile_mean([0.0, 2.0])[1:]
    assert "word" not in first


def test_the_default_metric_of_a_function_is_the_first_number_that_it_returned():
    rows = [
        {"config": c, "seed": s, "r": c, "status": "finished", "word": "x", "area": -c, "deep": [1.0], "other": c + s}
        for c in (0, 1)
        for s in (0, 2)
    ]
    lanes = pa.Table.from_pylist(rows)
    assert summaries.outputs(lanes) == ["area", "other"]
    assert summaries.outputs(table({})) is None
    found = summaries.summary(lanes, ["r"])
    assert (summaries.best(found)["config"], summaries.best(found, "other")["config"]) == (0, 1)
    with pytest.raises(ValueError, match="'eval_return' is no column of the summary; known: area, other"):
        summaries.best(found, "eval_return")
    with pytest.raises(ValueError, match="metric: no setting has a number to be ranked by"):
        summaries.best(summaries.summary(lanes.drop_columns(["area", "other"]), ["r"]))
