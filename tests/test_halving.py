"""Successive halving: what it decides by hand, and that it decides the same however it comes to run."""

import contextlib
import itertools
import json
import math
import shutil

import faults
import numpy as np
import pytest
import scipy.stats
from faults import Watched, assert_same, bits, death
from hypothesis import given
from hypothesis import strategies as st

from jaxq import halving, run_files, stages, sweeps
from jaxq.plans import plan
from jaxq.settings import NO_LIMIT


@pytest.mark.parametrize(
    ("settings", "factor", "most", "parts"),
    [
        (27, 3, None, [27, 9, 3]),
        (26, 3, None, [9, 3]),
        (4, 2, None, [4, 2]),
        (5, 2, None, [4, 2]),
        (8, 2, 2, [4, 2]),
        (8, 2, 99, [8, 4, 2]),
        (3, 3, None, [3]),
        (2, 3, None, []),
    ],
)
def test_the_rungs_are_as_counted_by_hand(settings, factor, most, parts):
    rungs = halving.rungs(settings, factor, most)
    assert [rung.number for rung in rungs] == list(range(len(parts)))
    assert [rung.fraction for rung in rungs] == [1 / part for part in parts]


@given(st.integers(1, 5000), st.integers(2, 9))
def test_settings_last_for_all_rungs_and_no_further(settings, factor):
    left = settings
    for rung in halving.rungs(settings, factor):
        assert left > 1
        assert rung.fraction >= 1 / settings
        left = len(halving.kept(dict.fromkeys(range(left), 0.0), factor))
    assert left <= factor


@pytest.mark.parametrize(
    ("returns", "score"),
    [
        ([7.0], 7.0),
        ([1.0, 2.0], 1.5),
        ([1.0, 2.0, 6.0], 3.0),
        ([100.0, 1.0, 0.0, 3.0], 2.0),
        ([None, 1.0, 3.0, 3.0], 2.0),  # the diverged one is the quarter that is cut off
        ([None, 5.0], -math.inf),
        ([None, None, 5.0, 5.0], -math.inf),
    ],
)
def test_the_score_is_as_computed_by_hand(returns, score):
    assert halving.score(returns) == score


FINITE = st.floats(-1e6, 1e6)


@given(st.lists(FINITE, min_size=1, max_size=30), st.randoms())
def test_the_score_is_the_interquartile_mean_in_any_order(returns, random):
    score = halving.score(returns)
    assert score == pytest.approx(scipy.stats.trim_mean(returns, 0.25), rel=1e-9, abs=1e-6)
    random.shuffle(returns)
    assert halving.score(returns) == score
    assert halving.score([*returns[1:], None]) <= halving.score(returns) or returns[0] == min(returns)


def test_what_is_kept_is_as_chosen_by_hand():
    assert halving.kept({0: 1.0, 1: 3.0, 2: 2.0, 3: 0.0}, 2) == [1, 2]
    assert halving.kept({4: 1.0, 7: 1.0, 9: 1.0}, 2) == [4, 7]  # of equals those that come first
    assert halving.kept({0: 1.0, 1: -math.inf, 2: -math.inf}, 3) == [0]
    assert halving.kept({0: -math.inf, 1: -math.inf}, 2) == [0]


@given(st.dictionaries(st.integers(0, 99), FINITE | st.just(-math.inf), min_size=1), st.integers(2, 5))
def test_the_best_part_is_kept(scores, factor):
    kept = halving.kept(scores, factor)
    assert kept == sorted(kept)
    assert len(kept) == math.ceil(len(scores) / factor)
    stopped = set(scores) - set(kept)
    assert all((scores[k], -k) > (scores[s], -s) for k in kept for s in stopped)


def test_what_halving_cannot_do_is_refused():
    with pytest.raises(ValueError, match="halving: 3 is not allowed: at most as many as there are settings, 2"):
        plan("dqn", gamma=[0.9, 0.99], halving=3)
    with pytest.raises(ValueError, match="halving: 1 is not allowed"):
        plan("dqn", gamma=[0.9, 0.99], halving=1)
    with pytest.raises(ValueError, match="halving: 2 is not allowed without a limit, max_env_steps or max_episodes"):
        plan("q-learning", gamma=[0.9, 0.99], halving=2, max_episodes=NO_LIMIT)
    with pytest.raises(ValueError, match="rungs: 1 is not allowed without halving"):
        plan("dqn", gamma=[0.9, 0.99], rungs=1)


GAMMAS = [0.0, 0.5, 0.9, 0.95, 0.99]
NETWORKS = {"gamma": GAMMAS, "seeds": 3, "max_env_steps": 2000, "eval_every": 500, "learning_rate": 1e-2}
PLANS = {
    "networks": (faults.networks(**NETWORKS, halving=2), faults.networks(**NETWORKS)),
    "tables": (faults.long_tables(gamma=GAMMAS, seeds=3, halving=2), faults.long_tables(gamma=GAMMAS, seeds=3)),
    "two programs": (
        faults.long_tables(bootstrap_terminal=[False, True], gamma=[0.9, 0.99], seeds=2, halving=2),
        faults.long_tables(bootstrap_terminal=[False, True], gamma=[0.9, 0.99], seeds=2),
    ),
}


@pytest.fixture(autouse=True)
def _quick(monkeypatch):
    faults.quickly(monkeypatch)


@pytest.fixture(scope="module", params=PLANS)
def case(request, tmp_path_factory):
    """A plan with halving, its run, and the run of the same without."""
    halved, full = PLANS[request.param]
    where = tmp_path_factory.mktemp("halving")
    with pytest.MonkeyPatch.context() as patch:
        faults.quickly(patch)
        for name, planned in (("halved", halved), ("full", full)):
            assert Watched(where / name, planned).outcome.complete
    return halved, where / "halved", where / "full"


def decided(path):
    return json.loads((path / "manifest.json").read_text())["rungs"]


def test_the_worst_settings_stop_at_the_rungs_and_their_rows_say_so(case):
    planned, path, _ = case
    rungs, left = decided(path), set(range(len(planned.settings)))
    lanes = faults.rows(path)["lanes"].to_pylist()
    assert [rung["rung"] for rung in rungs] == [0, 1]
    for rung, expected in zip(rungs, halving.rungs(len(planned.settings), planned.halving), strict=True):
        assert rung["fraction"] == expected.fraction
        assert set(rung["kept"]) | set(rung["stopped"]) == left == {int(config) for config in rung["scores"]}
        assert rung["kept"] == halving.kept({int(c): s for c, s in rung["scores"].items()}, planned.halving)
        for config in rung["stopped"]:
            mine = [row for row in lanes if row["config"] == config]
            assert {(row["status"], row["stopped_at_rung"]) for row in mine} == {("stopped", rung["rung"])}
            assert halving.score([row["eval_return"] for row in mine]) == rung["scores"][str(config)]
            limit = planned.settings[config].max_env_steps
            assert all(limit * rung["fraction"] <= row["env_steps"] < limit for row in mine)
        left = set(rung["kept"])
    assert {row["status"] for row in lanes if row["config"] in left} == {"finished"}
    assert len(lanes) == planned.lanes
    assert {name.rpartition("/")[0] for name in faults.policies(path)} == {
        f"{config}/{seed}" for config in range(len(planned.settings)) for seed in planned.seeds
    }


def of(table, lanes):
    """The rows of these lanes."""
    keys = zip(table["config"].to_pylist(), table["seed"].to_pylist(), strict=True)
    return table.filter([key in lanes for key in keys])


def test_who_survives_has_the_same_bits_as_without_halving(case):
    planned, path, full = case
    survivors = {(config, seed) for config in decided(path)[-1]["kept"] for seed in planned.seeds}
    mine, theirs = faults.rows(path), faults.rows(full)
    for kind, table in mine.items():
        assert len(of(table, survivors)) > 0
        assert bits(of(table, survivors)).equals(bits(of(theirs[kind], survivors))), kind
    kept, every = faults.policies(path), faults.policies(full)
    alive = [name for name in kept if tuple(map(int, name.split("/")[:2])) in survivors]
    assert alive
    assert all(kept[name].tobytes() == every[name].tobytes() for name in alive)


def test_who_is_stopped_has_the_beginning_of_what_it_would_have_had(case):
    planned, path, full = case
    mine, theirs = faults.rows(path), faults.rows(full)
    for config, seed in itertools.product(decided(path)[0]["stopped"], planned.seeds):
        for kind in ("curves", "episodes"):
            here, there = (of(tables[kind], {(config, seed)}) for tables in (mine, theirs))
            assert 0 < len(here) < len(there)
            if kind == "curves":  # the last row has the evaluation at the rung
                here, there = here.drop_columns("eval_return"), there.drop_columns("eval_return")
            assert bits(here).equals(bits(there.slice(0, len(here))))


@pytest.mark.parametrize("how", ["two workers", "three workers", "the other way round", "in memory"])
def test_the_same_is_decided_however_it_is_run(case, tmp_path, monkeypatch, how):
    planned, path, _ = case
    if how == "in memory":
        outcome = sweeps.run(planned, keep_episodes=True)
        assert outcome.store.manifest["rungs"] == decided(path)
        assert bits(outcome.lanes).equals(bits(faults.rows(path)["lanes"]))
        assert bits(outcome.curves).equals(bits(faults.rows(path)["curves"]))
        assert outcome.policy(0, 0).weights.keys() == {
            name.removeprefix("0/0/") for name in faults.policies(path) if name.startswith("0/0/")
        }
        return
    if how == "the other way round":
        run = stages.engine.run
        monkeypatch.setattr(stages.engine, "run", lambda built, lanes, **o: run(built, [*lanes][::-1], **o))
    again = Watched(tmp_path / "run", planned, workers={"two workers": 2, "three workers": 3}.get(how, 1))
    assert again.rungs == decided(tmp_path / "run") == decided(path)
    assert sorted(again.ran) == sorted(set(again.ran))
    assert len(again.ran) == planned.lanes
    assert_same(tmp_path / "run", path)


def test_the_same_is_decided_after_any_stop(case, tmp_path):
    planned, path, _ = case
    lives = 0
    while not Watched(tmp_path / "run", planned, stop_in=1, checkpoint_s=0.0).outcome.complete:
        lives += 1
    assert lives > 3
    assert decided(tmp_path / "run") == decided(path)
    assert_same(tmp_path / "run", path)


def test_decisions_outlast_the_manifest(case, tmp_path):
    planned, path, _ = case
    for at in range(20, 200, 30):
        run = tmp_path / str(at)
        with death(at), contextlib.suppress(faults.Killed):
            Watched(run, planned)
        (run / "manifest.json").unlink(missing_ok=True)
        Watched(run, planned, allow=True)
        assert decided(run) == decided(path)
        assert_same(run, path)
    complete = shutil.copytree(path, tmp_path / "complete")
    (complete / "manifest.json").unlink()
    assert Watched(complete, planned, allow=True).ran == []
    assert decided(complete) == decided(path)


def test_a_checkpoint_that_is_damaged_where_it_waits_is_made_again(case, tmp_path):
    planned, path, _ = case
    run = tmp_path / "run"
    with death(30), pytest.raises(faults.Killed):
        Watched(run, planned)
    waiting = sorted((run / run_files.CHECKPOINTS).glob("*.safetensors"))
    assert len(waiting) > 1
    for file in waiting:
        faults.flip(file)
    assert len(Watched(run, planned).said) == len(waiting)
    assert decided(run) == decided(path)
    assert_same(run, path)


def test_a_diverged_lane_scores_worst(tmp_path):
    rates = [{"learning_rate": rate} for rate in (1e30, 1e-3)]
    Watched(tmp_path / "run", faults.networks(settings=rates, seeds=2, halving=2))
    (rung,) = decided(tmp_path / "run")
    assert rung["scores"]["0"] is None
    assert rung["scores"]["1"] > 0
    assert (rung["kept"], rung["stopped"]) == ([1], [0])
    lanes = faults.rows(tmp_path / "run")["lanes"].to_pylist()
    assert [row["status"] for row in lanes] == ["diverged"] * 2 + ["finished"] * 2
    assert np.isfinite([row["eval_return"] for row in lanes[2:]]).all()
