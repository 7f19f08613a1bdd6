"""Checkpoints: a lane that was saved between two segments goes on bit for bit; one that is damaged begins anew."""

import json
import shutil
import threading

import faults
import jax
import numpy as np
import pytest
import safetensors.numpy
from faults import DAMAGES, Watched, assert_same

from jaxq import lanes as engine
from jaxq import programs, run_files
from jaxq.checkpoints import AtRung, Checkpoints
from jaxq.tally import Lane


@pytest.fixture(autouse=True)
def _quick(monkeypatch):
    faults.quickly(monkeypatch)


#: A sweep and the segment in which it is stopped.
SWEEPS = {
    "tables": (faults.long_tables(gamma=[0.9, 0.99], seeds=2), 2),
    "networks": (faults.networks(gamma=[0.9, 0.99], seeds=3), 2),
    "networks that are evaluated": (faults.networks(eval_every=300, seeds=3), 3),
}


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    """Undisturbed runs by name."""
    with pytest.MonkeyPatch.context() as patch:
        faults.quickly(patch)
        made = {name: tmp_path_factory.mktemp("whole") / "run" for name in SWEEPS}
        for name, (planned, _) in SWEEPS.items():
            assert Watched(made[name], planned).outcome.complete
    return made


@pytest.fixture(scope="module")
def stopped(tmp_path_factory):
    """Runs by name that were stopped while lanes were under way."""
    with pytest.MonkeyPatch.context() as patch:
        faults.quickly(patch)
        made = {name: tmp_path_factory.mktemp("stopped") / "run" for name in SWEEPS}
        for name, (planned, stop_in) in SWEEPS.items():
            assert not Watched(made[name], planned, stop_in=stop_in).outcome.complete
    return made


def files(path):
    return sorted((path / run_files.CHECKPOINTS).iterdir())


@pytest.mark.parametrize("workers", [1, 2])
@pytest.mark.parametrize("name", SWEEPS)
def test_lanes_that_were_stopped_on_the_way_go_on_bit_for_bit(tmp_path, whole, stopped, name, workers):
    path = shutil.copytree(stopped[name], tmp_path / "run")
    assert len(files(path)) > 1
    again = Watched(path, SWEEPS[name][0], workers=workers)
    assert again.said == []
    made = sum(faults.rows(whole[name])["lanes"]["env_steps"].to_pylist())
    assert 0 < again.outcome.timing.env_steps < made  # what was done before is not done again
    assert_same(path, whole[name])


@pytest.mark.parametrize("name", SWEEPS)
def test_a_lane_may_be_saved_and_stopped_after_each_of_its_segments(tmp_path, whole, name):
    path, lives = tmp_path / "run", 0
    while not Watched(path, SWEEPS[name][0], stop_in=1, checkpoint_s=0.0).outcome.complete:
        lives += 1
    assert lives >= 3
    assert_same(path, whole[name])


def saved_of(planned, segments):
    """The program of a plan, and what its first lane is after each of so many segments."""
    (settings,) = planned.settings
    stop, saved, begun, numbers = threading.Event(), [], [], programs.hypers(settings)
    built = faults.build(faults.program(settings, planned.prng), numbers, planned.prng)

    def segment():
        begun.append(True)
        if len(begun) > segments:  # told by the worker itself: a listener may hear of a segment when all have run
            stop.set()

    lane = Lane(0, 0, numbers)
    options = {"checkpoint_s": 0.0, "stop": stop, "on_saved": saved.append}
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(faults, "_each_segment", [segment])
        assert list(engine.run(built, iter([lane]), root_seed=0, impl=planned.prng, total=1, **options)) == []
    shapes = jax.tree.map(lambda leaf: jax.ShapeDtypeStruct(leaf.shape[1:], leaf.dtype), built.empty)
    return lane, saved, shapes


@pytest.fixture(scope="module", params=["tables", "networks"])
def lane_saved(request):
    """A lane, what it was after its second segment, and the shapes of its state."""
    made = {"tables": faults.long_tables, "networks": faults.networks}[request.param]
    lane, saved, shapes = saved_of(made(), 2)
    return lane, saved[1], shapes


def same_trees(a, b):
    assert jax.tree.structure(a) == jax.tree.structure(b)
    for left, right in zip(jax.tree.leaves(a), jax.tree.leaves(b), strict=True):
        assert (np.shape(left), left.dtype, left.tobytes()) == (np.shape(right), right.dtype, right.tobytes())


def test_what_is_saved_is_loaded_whole_with_its_replay_and_its_books(tmp_path, lane_saved):
    lane, saved, shapes = lane_saved
    said = []
    checkpoints = Checkpoints(tmp_path, "me", said.append)
    checkpoints.save(saved)
    assert checkpoints.lanes() == [(0, 0)]
    loaded = checkpoints.load(lane, shapes)
    same_trees(loaded.state, saved.state)
    same_trees(loaded.books._replace(max_q=None), saved.books._replace(max_q=None))
    assert checkpoints.at_rung(0, 0) is None
    returns = np.array([1.5, 2.5], np.float32)
    checkpoints.save(saved, AtRung(3, returns, {"table": np.eye(2)}))
    at = checkpoints.at_rung(0, 0)
    assert (at.rung, at.eval_returns.tolist(), at.policy["table"].tolist()) == (3, [1.5, 2.5], np.eye(2).tolist())
    same_trees(checkpoints.load(lane, shapes).state, saved.state)
    checkpoints.save(saved)  # it went on
    assert checkpoints.at_rung(0, 0) is None
    assert said == []
    checkpoints.drop(0, 0)
    checkpoints.drop(0, 0)
    assert checkpoints.lanes() == []
    assert checkpoints.load(lane, shapes) is None


def test_a_checkpoint_holds_words_of_keys_and_no_key(tmp_path, lane_saved):
    _, saved, _ = lane_saved
    for leaf in jax.tree.leaves(saved.state):
        assert isinstance(leaf, (np.ndarray, np.generic))
        assert leaf.dtype.kind in "biuf"
    Checkpoints(tmp_path, "me", print).save(saved)
    held = safetensors.numpy.load_file(tmp_path / "0-0.safetensors")
    words = [name for name, array in held.items() if np.array_equal(array, saved.state.key_words)]
    assert words
    assert all(array.dtype.kind in "biuf" for array in held.values())


@pytest.mark.parametrize("damage", ["a flipped bit", "the end cut off", "nothing in it"])
@pytest.mark.parametrize("name", ["tables", "networks"])
def test_a_damaged_checkpoint_has_its_lane_begin_anew(tmp_path, whole, stopped, name, damage):
    path = shutil.copytree(stopped[name], tmp_path / "run")
    victim = files(path)[0]
    DAMAGES[damage](victim)
    again = Watched(path, SWEEPS[name][0])
    assert again.said == [f"{victim}: is damaged; the lane begins anew"]
    assert_same(path, whole[name])


def test_a_checkpoint_that_is_gone_has_its_lane_begin_anew(tmp_path, whole, stopped):
    path = shutil.copytree(stopped["tables"], tmp_path / "run")
    files(path)[0].unlink()
    assert Watched(path, SWEEPS["tables"][0]).said == []
    assert_same(path, whole["tables"])


def test_a_checkpoint_of_another_run_lane_or_program_is_none(tmp_path, whole, stopped):
    planned, stop_in = SWEEPS["tables"]
    Watched(tmp_path / "other", planned, stop_in=stop_in)  # the same sweep, but not the same run
    path = shutil.copytree(stopped["tables"], tmp_path / "run")
    first, second, *_ = files(path)
    shutil.copy(files(tmp_path / "other")[0], first)
    shutil.copy(files(stopped["tables"])[-1], second)
    again = Watched(path, planned)
    assert sorted(again.said) == [f"{file}: is of another run; the lane begins anew" for file in (first, second)]
    assert_same(path, whole["tables"])

    path = shutil.copytree(stopped["networks"], tmp_path / "program")
    _, saved, _ = saved_of(faults.long_tables(), 1)
    stamp = json.loads((path / "manifest.json").read_text())["id"]
    victim = files(path)[0]
    config, seed = run_files.lane_of(victim)
    lane = saved[0].lane._replace(config=config, seed=seed)
    Checkpoints(victim.parent, stamp, print).save(type(saved[0])(lane, saved[0].state, saved[0].books))
    assert Watched(path, SWEEPS["networks"][0]).said == [f"{victim}: is of another program; the lane begins anew"]
    assert_same(path, whole["networks"])


def test_whatever_bit_flips_is_seen(tmp_path, lane_saved):
    lane, saved, shapes = lane_saved
    said = []
    checkpoints = Checkpoints(tmp_path, "me", said.append)
    checkpoints.save(saved)
    file = tmp_path / "0-0.safetensors"
    data, rng = file.read_bytes(), np.random.default_rng(0)
    header = 8 + int.from_bytes(data[:8], "little")
    places = {*rng.integers(0, header, 150).tolist(), *rng.integers(header, len(data), 150).tolist(), *range(8)}
    for place in sorted(places):
        damaged = bytearray(data)
        damaged[place] ^= 1 << int(rng.integers(8))
        file.write_bytes(damaged)
        loaded = checkpoints.load(lane, shapes)
        if loaded is not None:  # spaces that pad the header, where any other means the same
            same_trees(loaded.state, saved.state)
            assert damaged[place : place + 1].isspace()
    assert len(said) > 0.9 * len(places)


def test_checkpoints_are_gone_once_their_lanes_have_rows(tmp_path, whole):
    planned, stop_in = SWEEPS["tables"]
    path = tmp_path / "run"
    Watched(path, planned, stop_in=stop_in)
    kept = {file.name: file.read_bytes() for file in files(path)}
    Watched(path, planned)
    assert files(path) == []
    for name, data in kept.items():  # as if a kill had come between the commit and the removal
        (path / run_files.CHECKPOINTS / name).write_bytes(data)
    assert Watched(path, planned).ran == []
    assert_same(path, whole["tables"])
