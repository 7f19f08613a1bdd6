"""The run directory: commits, locks, refusals."""

import hashlib
import json
import os
import shutil
import tempfile
from pathlib import Path

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


def test_overwrite_replaces_a_run_and_nothing_that_is_not_one(tmp_path, path):
    begun(path, [0])
    with RunDirectory.open(path, PLAN, overwrite=True) as run:
        assert seeds(run) == []
    precious = tmp_path / "photos"
    precious.mkdir()
    (precious / "cat.png").write_bytes(b"meow")
    with pytest.raises(RunError, match="not a run directory"):
        RunDirectory.open(precious, PLAN, overwrite=True)
    assert (precious / "cat.png").read_bytes() == b"meow"


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


@pytest.mark.parametrize("how", ["resume", "overwrite"])
@pytest.mark.parametrize("manifest", [None, '{"name": "an app of the web", "format": "x"}'])
def test_a_directory_of_somebody_else_is_never_touched(tmp_path, how, manifest):
    theirs = tmp_path / "photos"
    (theirs / "parts").mkdir(parents=True)
    (theirs / "policies" / "deep").mkdir(parents=True)
    files = {theirs / "cat.png": b"meow", theirs / "parts" / "engine.parquet": b"brrr"}
    if manifest:
        files[theirs / "manifest.json"] = manifest.encode()
    for file, data in files.items():
        file.write_bytes(data)
    with pytest.raises(RunError):
        RunDirectory.open(theirs, PLAN, allow_mismatch=how == "resume", **{how: True})
    assert {file: file.read_bytes() for file in theirs.rglob("*") if file.is_file()} == files


def test_overwrite_removes_only_what_a_run_writes(path):
    begun(path, [0])
    (path / "notes.txt").write_text("mine")
    (path / "mine.png").write_text("mine")
    begun_again = RunDirectory.open(path, PLAN, overwrite=True)
    begun_again.__exit__()
    assert (path / "notes.txt").read_text() == "mine"
    assert (path / "mine.png").read_text() == "mine"
    assert not list((path / "parts").iterdir())


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


@pytest.mark.parametrize("name", ["parts/00001-lanes.parquet", "parts/00001-curves.parquet", "policies/00001.safetensors"])
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


def test_a_run_that_could_not_begin_leaves_nothing_behind(tmp_path, monkeypatch):
    def full(_):
        raise OSError(28, "No space left on device")

    with monkeypatch.context() as patch:
        patch.setattr("os.fsync", full)
        with pytest.raises(WriteError, match="No space left"):
            RunDirectory.open(tmp_path / "a" / "run", PLAN)
    assert not (tmp_path / "a").exists()
    replace = run_files.replace
    with monkeypatch.context() as patch:
        patch.setattr(run_files, "replace", lambda file, data: full(0) if file.name == "sweep.toml" else replace(file, data))
        with pytest.raises(WriteError, match="No space left"):
            RunDirectory.open(tmp_path / "a" / "run", PLAN)
    assert not (tmp_path / "a").exists()
    # A kill at the same moment leaves files that count as nothing.
    (tmp_path / "run" / "parts").mkdir(parents=True)
    (tmp_path / "run" / ".manifest.json.tmp").write_text("{")
    (tmp_path / "run" / "lock").touch()
    with RunDirectory.open(tmp_path / "run", PLAN) as run:
        assert not run.resumed
    assert not list((tmp_path / "run").glob(".*.tmp"))


def test_what_is_no_run_is_said_at_once(tmp_path):
    (tmp_path / "file").write_text("mine")
    (tmp_path / "other").mkdir()
    (tmp_path / "other" / "cat.png").write_text("meow")
    for name in ("file", "other"):
        with pytest.raises(RunError, match="is not a run directory; choose another --out"):
            RunDirectory.open(tmp_path / name, PLAN)


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


@pytest.mark.parametrize("name", ["run", "a run with spaces", "läufe/über 東京", "up/../run", "./run", "new/deep/er"])
def test_a_directory_may_have_any_name(tmp_path, monkeypatch, name):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "up").mkdir()
    begun(Path(name), [0])
    with RunDirectory.open(tmp_path / name, PLAN, resume=True) as run:
        assert seeds(run) == [0]
    assert (tmp_path / name / "manifest.json").exists()


def test_a_link_to_a_directory_is_one(tmp_path, path):
    path.mkdir()
    (tmp_path / "link").symlink_to(path)
    begun(tmp_path / "link", [0])
    assert parts.read(path, "lanes").to_pylist() == [lane(0)]


@pytest.mark.parametrize("where", ["file/run", "file/deep/run", "/proc/nonexistent/run", "/proc/1/run", "x" * 300])
def test_a_place_that_cannot_hold_a_directory_is_an_error_in_words(tmp_path, where):
    (tmp_path / "file").write_text("")
    with pytest.raises(RunError) as refused:
        RunDirectory.open(tmp_path / where, PLAN)
    assert str(refused.value).startswith(str(tmp_path / where))
    assert list(tmp_path.iterdir()) == [tmp_path / "file"]


def test_a_directory_that_may_not_be_written_is_an_error_in_words():
    where = Path(tempfile.mkdtemp())  # a nobody may not even look below pytest's
    try:
        (where / "run").mkdir()
        where.chmod(0o555)
        (where / "run").chmod(0o555)
        mine = os.geteuid()
        if mine == 0:  # whom nothing is forbidden
            os.seteuid(65534)
        try:
            for path in (where / "new", where / "run", where / "run" / "deep"):
                with pytest.raises(RunError, match="Permission denied"):
                    RunDirectory.open(path, PLAN)
        finally:
            os.seteuid(mine)
        assert [file.name for file in where.rglob("*")] == ["run"]
    finally:
        where.chmod(0o755)
        shutil.rmtree(where)


def test_policies_are_flattened_by_path():
    flat = flatten({"params": {"Linear_0": {"bias": np.zeros(2)}, "layers": [np.ones(1)]}})
    assert set(flat) == {"params.Linear_0.bias", "params.layers.0"}
    assert set(flatten(np.zeros(3))) == {"table"}
