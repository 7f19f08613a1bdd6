"""The run directory: commits, locks, refusals."""

import json

import numpy as np
import pytest
import safetensors.numpy

from jaxq.plans import plan
from jaxq.runs import Locked, RunDirectory, RunError, flatten, read_rows

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
    assert set(manifest["parts"]) == {"00000-lanes.parquet", "00000-curves.parquet"}
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


def test_a_parent_that_cannot_hold_a_directory_is_an_error_in_words(tmp_path):
    (tmp_path / "file").write_text("")
    with pytest.raises(RunError, match="file"):
        RunDirectory.open(tmp_path / "file" / "run", PLAN)


def test_policies_are_flattened_by_path():
    flat = flatten({"params": {"Linear_0": {"bias": np.zeros(2)}, "layers": [np.ones(1)]}})
    assert set(flat) == {"params.Linear_0.bias", "params.layers.0"}
    assert set(flatten(np.zeros(3))) == {""}
