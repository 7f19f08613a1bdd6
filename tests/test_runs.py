"""The run directory: commits, locks, refusals."""

import hashlib
import json

import numpy as np
import pytest
import safetensors.numpy

from jaxq.manifest import RunError
from jaxq.plans import plan
from jaxq.runs import Locked, RunDirectory, WriteError, flatten, read_rows

PLAN = plan("article-q", seeds=2)


def lane(seed):
    return {"config": 0, "seed": seed, "status": "finished", "solved_at_episode": None, "final_return": 1.5}


def curve(seed):
    return {"config": 0, "seed": seed, "env_steps": 10, "loss": None}


def test_what_is_written_is_read_back_and_nothing_else_is(tmp_path):
    with RunDirectory.open(tmp_path / "run", PLAN) as run:
        run.write([lane(1)], [curve(1)], {(0, 1): {"table": np.eye(2, dtype=np.float32)}})
        run.write([lane(0)], [curve(0)], {})
        assert run.rows("lanes") == [lane(0), lane(1)]
    # A batch without its lanes part, the commit, never happened.
    (tmp_path / "run/parts/00000-lanes.parquet").unlink()
    assert read_rows(tmp_path / "run", "curves") == [curve(0)]


def test_policies_can_be_read_with_numpy_alone(tmp_path):
    with RunDirectory.open(tmp_path / "run", PLAN) as run:
        run.write([lane(1)], [], {(0, 1): {"table": np.eye(2, dtype=np.float32)}})
    loaded = safetensors.numpy.load_file(tmp_path / "run/policies/00000.safetensors")
    np.testing.assert_array_equal(loaded["0/1/table"], np.eye(2))


def test_the_manifest_says_what_ran_and_holds_the_hashes(tmp_path):
    with RunDirectory.open(tmp_path / "run", PLAN) as run:
        run.write([lane(0)], [curve(0)], {})
    manifest = json.loads((tmp_path / "run/manifest.json").read_text())
    assert manifest["spec"] == PLAN.spec()
    wrote = {"parts/00000-lanes.parquet", "parts/00000-curves.parquet", "policies/00000.safetensors"}
    assert set(manifest["files"]) == wrote
    for name, digest in manifest["files"].items():
        assert hashlib.sha256((tmp_path / "run" / name).read_bytes()).hexdigest() == digest
    assert {"jaxq", "jax", "python"} <= set(manifest["versions"])
    assert not list((tmp_path / "run").rglob("*.tmp"))


def test_an_existing_directory_needs_resume_or_overwrite(tmp_path):
    RunDirectory.open(tmp_path / "run", PLAN).__exit__()
    with pytest.raises(RunError, match="--resume"):
        RunDirectory.open(tmp_path / "run", PLAN)
    with RunDirectory.open(tmp_path / "run", PLAN, resume=True):
        pass


def test_resume_refuses_another_plan(tmp_path):
    RunDirectory.open(tmp_path / "run", PLAN).__exit__()
    with pytest.raises(RunError, match="another sweep"):
        RunDirectory.open(tmp_path / "run", plan("article-q", seeds=3), resume=True)


def test_overwrite_replaces_a_run_and_nothing_that_is_not_one(tmp_path):
    with RunDirectory.open(tmp_path / "run", PLAN) as run:
        run.write([lane(0)], [], {})
    with RunDirectory.open(tmp_path / "run", PLAN, overwrite=True) as run:
        assert run.rows("lanes") == []
    precious = tmp_path / "photos"
    precious.mkdir()
    (precious / "cat.png").write_bytes(b"meow")
    with pytest.raises(RunError, match="not a run directory"):
        RunDirectory.open(precious, PLAN, overwrite=True)
    assert (precious / "cat.png").read_bytes() == b"meow"


def test_a_second_process_is_told_that_the_directory_is_taken(tmp_path):
    with RunDirectory.open(tmp_path / "run", PLAN), pytest.raises(Locked):
        RunDirectory.open(tmp_path / "run", PLAN, resume=True)


def test_a_broken_manifest_is_an_error_in_words(tmp_path):
    RunDirectory.open(tmp_path / "run", PLAN).__exit__()
    (tmp_path / "run/manifest.json").write_text("{")
    with pytest.raises(RunError, match=r"manifest\.json: cannot be read"):
        RunDirectory.open(tmp_path / "run", PLAN, resume=True)
    with RunDirectory.open(tmp_path / "run", PLAN, overwrite=True) as run:  # nothing in it but a run's files
        assert run.rows("lanes") == []


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
        RunDirectory.open(theirs, PLAN, **{how: True})
    assert {file: file.read_bytes() for file in files} == files


def test_overwrite_removes_only_what_a_run_writes(tmp_path):
    with RunDirectory.open(tmp_path / "run", PLAN) as run:
        run.write([lane(0)], [], {})
    (tmp_path / "run" / "notes.txt").write_text("mine")
    (tmp_path / "run" / "mine.png").write_text("mine")
    RunDirectory.open(tmp_path / "run", PLAN, overwrite=True).__exit__()
    assert (tmp_path / "run" / "notes.txt").read_text() == "mine"
    assert (tmp_path / "run" / "mine.png").read_text() == "mine"


def test_a_kill_between_the_commit_and_the_manifest_loses_and_doubles_nothing(tmp_path):
    with RunDirectory.open(tmp_path / "run", PLAN) as run:
        run.write([lane(0)], [curve(0)], {})
        before = (tmp_path / "run/manifest.json").read_bytes()
        run.write([lane(1)], [curve(1)], {})
    (tmp_path / "run/manifest.json").write_bytes(before)
    with RunDirectory.open(tmp_path / "run", PLAN, resume=True) as run:
        run.write([lane(2)], [curve(2)], {})
        assert [row["seed"] for row in run.rows("lanes")] == [0, 1, 2]


def test_what_a_kill_left_of_a_batch_is_removed(tmp_path):
    with RunDirectory.open(tmp_path / "run", PLAN) as run:
        run.write([lane(0)], [curve(0)], {})
    (tmp_path / "run/parts/00000-lanes.parquet").unlink()
    with RunDirectory.open(tmp_path / "run", PLAN, resume=True) as run:
        assert run.rows("lanes") == run.rows("curves") == []
        run.write([lane(0)], [curve(0)], {})
        assert run.rows("curves") == [curve(0)]


@pytest.mark.parametrize(
    "name", ["parts/00000-lanes.parquet", "parts/00000-curves.parquet", "policies/00000.safetensors"]
)
def test_a_flipped_byte_is_an_error_in_words(tmp_path, name):
    with RunDirectory.open(tmp_path / "run", PLAN) as run:
        run.write([lane(0)], [curve(0)], {(0, 0): {"table": np.eye(2, dtype=np.float32)}})
    part = tmp_path / "run" / name
    data = bytearray(part.read_bytes())
    data[len(data) // 2] ^= 1
    part.write_bytes(bytes(data))
    with pytest.raises(RunError, match="damaged"):
        RunDirectory.open(tmp_path / "run", PLAN, resume=True)


@pytest.mark.parametrize("name", ["parts/00000-curves.parquet", "policies/00000.safetensors"])
def test_a_missing_file_is_an_error_in_words(tmp_path, name):
    with RunDirectory.open(tmp_path / "run", PLAN) as run:
        run.write([lane(0)], [curve(0)], {})
    (tmp_path / "run" / name).unlink()
    with pytest.raises(RunError, match="damaged"):
        RunDirectory.open(tmp_path / "run", PLAN, resume=True)


@pytest.mark.parametrize(
    "damage", [{"files": None}, {"files": []}, {"widths": 3}, {"spec_hash": None}, {"versions": ""}]
)
def test_a_manifest_with_wrong_kinds_is_an_error_in_words(tmp_path, damage):
    RunDirectory.open(tmp_path / "run", PLAN).__exit__()
    file = tmp_path / "run/manifest.json"
    file.write_text(json.dumps(json.loads(file.read_text()) | damage))
    with pytest.raises(RunError, match="is damaged; --overwrite"):
        RunDirectory.open(tmp_path / "run", PLAN, resume=True)


@pytest.mark.parametrize("name", ["parts/00001-lanes.parquet", "policies/00001.safetensors"])
def test_a_batch_that_the_manifest_does_not_know_is_checked_and_then_known(tmp_path, name):
    with RunDirectory.open(tmp_path / "run", PLAN) as run:
        run.write([lane(0)], [curve(0)], {})
        before = (tmp_path / "run/manifest.json").read_bytes()
        run.write([lane(1)], [curve(1)], {})
    (tmp_path / "run/manifest.json").write_bytes(before)  # as a kill between the commit and the manifest leaves it
    RunDirectory.open(tmp_path / "run", PLAN, resume=True).__exit__()
    with RunDirectory.open(tmp_path / "run", PLAN, resume=True) as run:
        assert name in run.manifest["files"]
    (tmp_path / "run/manifest.json").write_bytes(before)
    file = tmp_path / "run" / name
    file.write_bytes(file.read_bytes()[:10])
    with pytest.raises(RunError, match="is damaged"):
        RunDirectory.open(tmp_path / "run", PLAN, resume=True)


def test_a_run_that_could_not_begin_leaves_nothing_behind(tmp_path, monkeypatch):
    def full(_):
        raise OSError(28, "No space left on device")

    with monkeypatch.context() as patch:
        patch.setattr("os.fsync", full)
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


def test_a_run_tells_whether_it_goes_on(tmp_path):
    with RunDirectory.open(tmp_path / "run", PLAN, resume=True) as run:
        assert not run.resumed
    with RunDirectory.open(tmp_path / "run", PLAN, resume=True) as run:
        assert run.resumed


def test_resume_on_other_versions_is_refused_with_the_difference(tmp_path):
    RunDirectory.open(tmp_path / "run", PLAN).__exit__()
    manifest = json.loads((tmp_path / "run/manifest.json").read_text())
    manifest["versions"]["jax"] = "0.0.1"
    (tmp_path / "run/manifest.json").write_text(json.dumps(manifest))
    with pytest.raises(RunError, match=r"0\.0\.1"):
        RunDirectory.open(tmp_path / "run", PLAN, resume=True)


def test_a_full_disk_is_an_error_in_words(tmp_path, monkeypatch):
    with RunDirectory.open(tmp_path / "run", PLAN) as run:

        def full(_):
            raise OSError(28, "No space left on device")

        monkeypatch.setattr("os.fsync", full)
        with pytest.raises(RunError, match="No space left"):
            run.write([lane(0)], [], {})
        assert run.rows("lanes") == []
    assert not list((tmp_path / "run").rglob("*.tmp"))


def test_resume_with_another_width_is_refused(tmp_path):
    with RunDirectory.open(tmp_path / "run", PLAN) as run:
        run.agree_width(0, 16)
    with RunDirectory.open(tmp_path / "run", PLAN, resume=True) as run:
        run.agree_width(0, 16)
        with pytest.raises(RunError, match="width 16, this is 8"):
            run.agree_width(0, 8)


def test_a_parent_that_cannot_hold_a_directory_is_an_error_in_words(tmp_path):
    (tmp_path / "file").write_text("")
    with pytest.raises(RunError, match="file"):
        RunDirectory.open(tmp_path / "file" / "run", PLAN)


def test_policies_are_flattened_by_path():
    flat = flatten({"params": {"Linear_0": {"bias": np.zeros(2)}, "layers": [np.ones(1)]}})
    assert set(flat) == {"params.Linear_0.bias", "params.layers.0"}
    assert set(flatten(np.zeros(3))) == {""}
