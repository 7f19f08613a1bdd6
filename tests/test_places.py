"""Where a run directory may be, and what it leaves alone there."""

import os
import shutil
import tempfile
from pathlib import Path

import pyarrow as pa
import pytest

from jaxq import parts, run_files
from jaxq.manifest import RunError
from jaxq.plans import plan
from jaxq.runs import RunDirectory, WriteError

PLAN = plan("article-q", seeds=2)


def begun(path, *batches):
    """A run directory with lanes of these seeds, a batch each."""
    with RunDirectory.open(path, PLAN) as run:
        for seed in batches:
            run.write({"lanes": pa.Table.from_pylist([{"config": 0, "seed": seed}])}, {})
    return path


def seeds(run):
    table = run.table("lanes")
    return [] if table is None else table["seed"].to_pylist()


@pytest.fixture
def path(tmp_path):
    return tmp_path / "run"


def test_overwrite_replaces_a_run_and_nothing_that_is_not_one(tmp_path, path):
    begun(path, 0)
    with RunDirectory.open(path, PLAN, overwrite=True) as run:
        assert seeds(run) == []
    precious = tmp_path / "photos"
    precious.mkdir()
    (precious / "cat.png").write_bytes(b"meow")
    with pytest.raises(RunError, match="not a run directory"):
        RunDirectory.open(precious, PLAN, overwrite=True)
    assert (precious / "cat.png").read_bytes() == b"meow"


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
    begun(path, 0)
    (path / "notes.txt").write_text("mine")
    (path / "mine.png").write_text("mine")
    begun_again = RunDirectory.open(path, PLAN, overwrite=True)
    begun_again.__exit__()
    assert (path / "notes.txt").read_text() == "mine"
    assert (path / "mine.png").read_text() == "mine"
    assert not list((path / "parts").iterdir())


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
        patch.setattr(
            run_files, "replace", lambda file, data: full(0) if file.name == "sweep.toml" else replace(file, data)
        )
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


@pytest.mark.parametrize("name", ["run", "a run with spaces", "läufe/über 東京", "up/../run", "./run", "new/deep/er"])
def test_a_directory_may_have_any_name(tmp_path, monkeypatch, name):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "up").mkdir()
    begun(Path(name), 0)
    with RunDirectory.open(tmp_path / name, PLAN, resume=True) as run:
        assert seeds(run) == [0]
    assert (tmp_path / name / "manifest.json").exists()


def test_a_link_to_a_directory_is_one(tmp_path, path):
    path.mkdir()
    (tmp_path / "link").symlink_to(path)
    begun(tmp_path / "link", 0)
    assert parts.read(path, "lanes").to_pylist() == [{"config": 0, "seed": 0}]


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
