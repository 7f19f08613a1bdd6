"""The run directory: commits, locks, refusals."""

import hashlib
import json
import os

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
import safetensors.numpy

from jaxq import parts, run_files, sweep_files
from jaxq.manifest import RunError
from jaxq.outcome import load
from jaxq.plans import plan
from jaxq.runs import Locked, RunDirectory, WriteError
from jaxq.saved_policy import flatten

PLAN = plan("article-q", seeds=2)


def lane(seed):
    return {"config": 0, "seed": seed, "status": "finished", "solved_at_episode": None, "final_return": 1.5}


def curve(seed):
    return {"config": 0, "seed": seed, "env_steps": 10, "loss": None}


def batch(*seeds):
    """The tables and policies of some lanes."""
    tables = {"lanes": [lane(seed) for seed in seeds], "curves": [curve(seed) for seed in seeds]}
    policies = {(0, seed): {"table": np.full((2, 2), seed, np.float32)} for seed in seeds}
    return {kind: pa.Table.from_pylist(rows) for kind, rows in tables.items()}, policies


def seeds(run):
    table = run.table("lanes")
    return [] if table is None else table["seed"].to_pylist()


def begun(path, *batches):
    """A run directory with these batches."""
    with RunDirectory.open(path, PLAN) as run:
        for one in batches:
            run.write(*batch(*one))
    return path


@pytest.fixture
def path(tmp_path):
    return tmp_path / "run"


def test_what_is_written_is_read_back_in_order_and_nothing_else_is(path):
    with RunDirectory.open(path, PLAN) as run:
        assert run.table("lanes") is None
        run.write(*batch(1))
        run.write(*batch(0))
        assert run.table("lanes").to_pylist() == [lane(0), lane(1)]
        assert run.table("curves").to_pylist() == [curve(0), curve(1)]
        assert run.table("episodes") is None
        assert run.policy(0, 1)[0]["table"].tolist() == [[1, 1], [1, 1]]
        assert run.policy(0, 2) == ({}, {})
    # A batch without its lanes part, the commit, never happened.
    (path / "parts/00000-lanes.parquet").unlink()
    assert parts.read(path, "curves").to_pylist() == [curve(0)]
    assert parts.read_policy(path, 0, 1) == ({}, {})


def test_rows_and_policies_can_be_read_without_jaxq(path):
    begun(path, [1])
    assert pq.read_table(path / "parts/00000-lanes.parquet").to_pylist() == [lane(1)]
    loaded = safetensors.numpy.load_file(path / "policies/00000.safetensors")
    np.testing.assert_array_equal(loaded["0/1/table"], np.ones((2, 2)))


def test_batches_may_have_columns_of_their_own(path):
    with RunDirectory.open(path, PLAN) as run:
        run.write({"lanes": pa.Table.from_pylist([lane(0)])}, {})
        run.write({"lanes": pa.Table.from_pylist([lane(1) | {"more": 1}])}, {})
        assert [row["more"] for row in run.table("lanes").to_pylist()] == [None, 1]


def test_the_manifest_says_what_ran_and_holds_the_hashes(path):
    begun(path, [0])
    manifest = json.loads((path / "manifest.json").read_text())
    assert manifest["spec"] == PLAN.spec()
    wrote = {"parts/00000-lanes.parquet", "parts/00000-curves.parquet", "policies/00000.safetensors"}
    assert set(manifest["files"]) == wrote
    for name, digest in manifest["files"].items():
        assert hashlib.sha256((path / name).read_bytes()).hexdigest() == digest
    assert {"jaxq", "jax", "python"} <= set(manifest["versions"])
    assert manifest["process"] == os.getpid()
    assert not list(path.rglob("*.tmp"))


def test_a_run_holds_its_sweep_as_a_file(path):
    begun(path)
    asked = sweep_files.read(path / "sweep.toml")
    assert plan(**asked).spec() == PLAN.spec()


def test_an_existing_directory_needs_resume_or_overwrite(path):
    begun(path)
    with pytest.raises(RunError, match="--resume"):
        RunDirectory.open(path, PLAN)
    with RunDirectory.open(path, PLAN, resume=True):
        pass


def test_overwrite_begins_what_is_broken_anew(path):
    begun(path, [0])
    (path / "manifest.json").write_text("{")
    with RunDirectory.open(path, PLAN, overwrite=True) as run:  # nothing in it but a run's files
        assert seeds(run) == []
    begun_anew = json.loads((path / "manifest.json").read_text())
    assert begun_anew["files"] == {}


@pytest.mark.parametrize("how", ["resume", "overwrite"])
def test_a_second_holder_is_told_who_has_the_directory(path, how):
    with RunDirectory.open(path, PLAN) as run:
        run.write(*batch(0))
        with pytest.raises(Locked, match=f"process {os.getpid()} is writing to it"):
            RunDirectory.open(path, PLAN, **{how: True})
        assert seeds(run) == [0]
    with RunDirectory.open(path, PLAN, **{how: True}):
        pass


def test_a_kill_between_the_commit_and_the_manifest_loses_and_doubles_nothing(path):
    with RunDirectory.open(path, PLAN) as run:
        run.write(*batch(0))
        before = (path / "manifest.json").read_bytes()
        run.write(*batch(1))
    (path / "manifest.json").write_bytes(before)
    with RunDirectory.open(path, PLAN, resume=True) as run:
        run.write(*batch(2))
        assert seeds(run) == [0, 1, 2]
        assert len(run.manifest["files"]) == 9


def test_what_a_kill_left_of_a_batch_is_removed(path):
    with RunDirectory.open(path, PLAN) as run:
        before = (path / "manifest.json").read_bytes()
        run.write(*batch(0))
    (path / "manifest.json").write_bytes(before)
    (path / "parts/00000-lanes.parquet").unlink()
    said = []
    with RunDirectory.open(path, PLAN, resume=True, say=said.append) as run:
        assert run.table("lanes") is run.table("curves") is None
        assert not list(run_files.batches(path))
        run.write(*batch(0))
        assert run.table("curves").to_pylist() == [curve(0)]
    assert said == []


def test_a_batch_that_could_not_be_committed_is_not_in_the_manifest(path, monkeypatch):
    """Else its remains would count as damaged, or stay for ever."""
    with RunDirectory.open(path, PLAN) as run:
        replace = run_files.replace

        def full(target, data):
            if target.name == "00000-lanes.parquet":
                raise WriteError("full")
            replace(target, data)

        monkeypatch.setattr(run_files, "replace", full)
        with pytest.raises(WriteError):
            run.write(*batch(0))
        run.write(*batch(1))  # as when what has gathered is written in the end
    said = []
    with RunDirectory.open(path, PLAN, resume=True, say=said.append) as run:
        assert seeds(run) == [1]
        assert {number for number, _ in run_files.batches(path)} == {"00001"}
    assert said == []


@pytest.mark.parametrize(
    "name", ["parts/00001-lanes.parquet", "parts/00001-curves.parquet", "policies/00001.safetensors"]
)
def test_a_batch_that_the_manifest_does_not_know_is_checked_and_then_known(path, name):
    with RunDirectory.open(path, PLAN) as run:
        run.write(*batch(0))
        before = (path / "manifest.json").read_bytes()
        run.write(*batch(1))
    (path / "manifest.json").write_bytes(before)  # as a kill between the commit and the manifest leaves it
    RunDirectory.open(path, PLAN, resume=True).__exit__()
    with RunDirectory.open(path, PLAN, resume=True) as run:
        assert name in run.manifest["files"]
    (path / "manifest.json").write_bytes(before)
    data = bytearray((path / name).read_bytes())
    data[len(data) * 2 // 3] ^= 1
    (path / name).write_bytes(data)
    said = []
    with RunDirectory.open(path, PLAN, resume=True, say=said.append) as run:
        assert seeds(run) == [0]
    assert len(said) == 1
    assert "is damaged" in said[0]


def test_who_only_reads_is_told_of_damage(path):
    begun(path, [0], [1])
    assert load(path).lanes["seed"].to_pylist() == [0, 1]
    (path / "parts/00001-curves.parquet").write_bytes(b"")
    with pytest.raises(RunError, match=r"00001-curves\.parquet: is damaged; .* --resume"):
        load(path)
    with pytest.raises(RunError, match="holds no run"):
        load(path / "parts")


def test_a_run_tells_whether_it_goes_on(path):
    with RunDirectory.open(path, PLAN, resume=True) as run:
        assert not run.resumed
    with RunDirectory.open(path, PLAN, resume=True) as run:
        assert run.resumed


def test_a_full_disk_is_an_error_in_words(path, monkeypatch):
    with RunDirectory.open(path, PLAN) as run:

        def full(_):
            raise OSError(28, "No space left on device")

        monkeypatch.setattr("os.fsync", full)
        with pytest.raises(WriteError, match=r"00000\.safetensors: No space left on device"):
            run.write(*batch(0))
        assert seeds(run) == []
    assert not list(path.rglob("*.tmp"))


def test_policies_are_flattened_by_path():
    flat = flatten({"params": {"Linear_0": {"bias": np.zeros(2)}, "layers": [np.ones(1)]}})
    assert set(flat) == {"params.Linear_0.bias", "params.layers.0"}
    assert set(flatten(np.zeros(3))) == {"table"}
