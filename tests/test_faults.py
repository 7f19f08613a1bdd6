"""A sweep that is killed, whose disk is full, or whose files are damaged comes to the tables of an undisturbed one."""

import contextlib
import itertools
import re
import shutil

import faults
import numpy as np
import pyarrow.parquet as pq
import pytest
from faults import DAMAGES, Watched, assert_same, contents, death, full_disk, policies, rows

from jaxq import run_files
from jaxq.cli import main
from jaxq.run_files import WriteError


@pytest.fixture(autouse=True)
def _quick(monkeypatch):
    faults.quickly(monkeypatch)


TABLES = faults.tables(gamma=[0.9, 0.99], seeds=4)
HALVING = faults.networks(gamma=[0.9, 0.95, 0.99, 0.999], halving=2, seeds=1)
SWEEPS = {
    "tables": (TABLES, {}),
    "checkpoints of tables": (faults.long_tables(seeds=2), {"checkpoint_s": 0.0}),
    "checkpoints of networks": (faults.networks(seeds=2), {"checkpoint_s": 0.0}),
    "halving": (HALVING, {}),
}


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    """Undisturbed runs by name."""
    with pytest.MonkeyPatch.context() as patch:
        faults.quickly(patch)
        made = {name: tmp_path_factory.mktemp("whole") / "run" for name in SWEEPS}
        for name, (planned, options) in SWEEPS.items():
            assert Watched(made[name], planned, **options).outcome.complete
    return made


@pytest.fixture
def copied(tmp_path, whole):
    """A copy of the undisturbed run of tables."""
    return shutil.copytree(whole["tables"], tmp_path / "copied")


@pytest.mark.parametrize("name", SWEEPS)
def test_a_kill_at_any_write_loses_and_doubles_nothing(tmp_path, whole, name):
    planned, options = SWEEPS[name]
    for at in itertools.count():
        path = tmp_path / str(at)
        with death(at) as done:
            try:
                Watched(path, planned, **options)
            except faults.Killed:
                assert len(done) > at
            else:
                break
        assert Watched(path, planned, **options).said == []
        assert_same(path, whole[name])
        shutil.rmtree(path)
    assert at == len(done) > 40
    assert_same(path, whole[name])


@pytest.mark.parametrize("name", SWEEPS)
def test_a_run_that_is_killed_again_and_again_gets_there(tmp_path, whole, name):
    planned, options = SWEEPS[name]
    rng = np.random.default_rng(len(name))
    for workers in (1, 2):
        path = tmp_path / str(workers)
        lives, complete = 0, False
        while not complete:
            lives += 1
            with death(int(rng.integers(6, 30))), contextlib.suppress(faults.Killed):
                complete = Watched(path, planned, workers=workers, **options).outcome.complete
        assert lives > 2
        assert_same(path, whole[name])


@pytest.mark.parametrize("name", ["tables", "halving"])
def test_a_full_disk_is_said_and_keeps_what_was_committed(tmp_path, whole, name):
    planned, options = SWEEPS[name]
    for at in itertools.count():
        path = tmp_path / str(at)
        said = None
        with full_disk(at) as tried:
            try:
                Watched(path, planned, **options)
            except WriteError as error:
                said = str(error)
        if said is None:
            break
        assert re.fullmatch(rf"{re.escape(str(path))}.*: No space left on device", said)
        before = run_files.committed(path)
        assert not run_files.temporaries(path)
        again = Watched(path, planned, **options)
        assert before <= run_files.committed(path)
        assert not again.said
        assert_same(path, whole[name])
    assert at == len(tried) > 10


def lanes_of(path, number):
    part = pq.read_table(path / run_files.lanes_part(number))
    return sorted(zip(part["config"].to_pylist(), part["seed"].to_pylist(), strict=True))


FILES = ["parts/00001-lanes.parquet", "parts/00001-curves.parquet", "parts/00001-episodes.parquet"]


@pytest.mark.parametrize("damage", DAMAGES)
@pytest.mark.parametrize("name", [*FILES, "policies/00001.safetensors"])
def test_a_damaged_batch_is_put_aside_and_its_lanes_alone_run_again(copied, whole, name, damage):
    lost = lanes_of(copied, "00001")
    DAMAGES[damage](copied / name)
    left = {file.name: file.read_bytes() for file in copied.glob("p*/00001*")}
    again = Watched(copied, TABLES)
    assert sorted(again.ran) == lost
    assert len(again.said) == 1
    assert f"{copied / name}: is damaged" in again.said[0]
    assert "quarantine" in again.said[0]
    assert {file.name: file.read_bytes() for file in (copied / "quarantine").iterdir()} == left
    assert_same(copied, whole["tables"])
    assert Watched(copied, TABLES).said == []


def test_a_batch_that_is_damaged_twice_is_put_aside_twice(copied, whole):
    for number in ("00001", "00002"):
        for file in copied.glob(f"parts/{number}-*"):
            faults.flip(file)
    assert len(Watched(copied, TABLES).said) == 2
    newest = max(run_files.committed(copied), key=int)
    for file in (copied / "parts").glob(f"{newest}-*"):
        file.rename(file.with_name(file.name.replace(newest, "00001")))
    Watched(copied, TABLES)
    assert {"00001-lanes.parquet", "00001-lanes.parquet.1"} <= {file.name for file in copied.glob("quarantine/*")}
    assert_same(copied, whole["tables"])


def test_any_damaged_batch_of_a_halving_run_comes_back_with_the_decisions_as_they_were(tmp_path, whole):
    for number in sorted(run_files.committed(whole["halving"])):
        path = shutil.copytree(whole["halving"], tmp_path / number)
        lost = lanes_of(path, number)
        faults.flip(path / run_files.lanes_part(number))
        again = Watched(path, HALVING)
        assert sorted(again.ran) == lost
        assert again.rungs == []
        assert_same(path, whole["halving"])


@pytest.mark.parametrize("name", SWEEPS)
def test_a_complete_run_that_is_resumed_runs_nothing_and_changes_no_byte(tmp_path, whole, name):
    planned, options = SWEEPS[name]
    path = shutil.copytree(whole[name], tmp_path / "copied")
    before = contents(path)
    again = Watched(path, planned, **options)
    assert again.ran == again.said == again.rungs == []
    assert again.outcome.complete
    assert again.outcome.timing.programs == 0
    assert contents(path) == before


@pytest.mark.parametrize("k", [1, 3])
def test_keep_saves_the_policies_of_the_best_lanes(tmp_path, whole, k):
    planned = faults.tables(gamma=[0.9, 0.99], seeds=30)
    Watched(tmp_path / "all", planned)
    every, returns = policies(tmp_path / "all"), eval_returns(tmp_path / "all")
    for stop_in in (None, 1):  # at once, and in two lives
        path = tmp_path / str(stop_in)
        first = Watched(path, planned, keep=k, stop_in=stop_in)
        assert first.outcome.complete == (stop_in is None)
        order = first.ran + Watched(path, planned, keep=k).ran
        assert sorted(order) == sorted(returns)
        expected, best = [], []
        for lane in order:  # kept: who is among the best so far
            if len(best) < k or returns[lane] > min(best):
                best = sorted([*best, returns[lane]])[-k:]
                expected.append(lane)
        kept = policies(path)
        assert sorted(kept) == sorted(f"{config}/{seed}/table" for config, seed in expected)
        assert all(kept[name].tobytes() == every[name].tobytes() for name in kept)
        found = sorted((returns[lane] for lane in expected), reverse=True)
        assert found[:k] == sorted(returns.values(), reverse=True)[:k]
        assert len(kept) < len(every)
        assert rows(path)["lanes"].equals(rows(tmp_path / "all")["lanes"])


def eval_returns(path):
    table = rows(path)["lanes"]
    lanes = zip(table["config"].to_pylist(), table["seed"].to_pylist(), strict=True)
    return dict(zip(lanes, table["eval_return"].to_pylist(), strict=True))


def test_a_lane_that_blows_up_changes_no_other_by_a_bit(tmp_path):
    rates = [{"learning_rate": rate} for rate in (1e-3, 1e30, 3e-3)]
    among = Watched(tmp_path / "among", faults.networks(settings=rates, seeds=3), workers=2).outcome
    without = Watched(tmp_path / "without", faults.networks(settings=[rates[0], rates[2]], seeds=3), workers=2).outcome
    for kind in ("lanes", "curves", "episodes"):
        table = getattr(among, kind).to_pylist()
        others = [row | {"config": row["config"] // 2} for row in table if row["config"] != 1]
        assert others == getattr(without, kind).to_pylist()
    lost = [row for row in among.lanes.to_pylist() if row["config"] == 1]
    assert {row["status"] for row in lost} == {"diverged"}
    assert all(0 < row["diverged_at_step"] == row["env_steps"] < 1000 for row in lost)
    assert all(row["eval_return"] is None for row in lost)
    assert {row["diverged_at_step"] for row in without.lanes.to_pylist()} == {None}


def test_a_sweep_of_which_nothing_is_left_is_a_failure(tmp_path, capsys):
    words = "--learning-rate 1e30 --seeds 2 --hidden 8 --learning-starts 32 --batch-size 16 --buffer-size 200".split()
    words += "--eval-episodes 3 --max-env-steps 1000".split()
    assert main(["sweep", "dqn", *words, "--out", str(tmp_path / "run")]) == 1
    assert capsys.readouterr().err.splitlines()[-1] == "jaxq: error: every lane has diverged"
    assert set(rows(tmp_path / "run")["lanes"]["status"].to_pylist()) == {"diverged"}
