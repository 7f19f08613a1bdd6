"""Small sweeps into a directory, the death of the process at any disk operation, and what makes two runs the same."""

import contextlib
import errno
import io
import os
import pathlib
import threading
from dataclasses import replace

import pyarrow as pa
import pytest
import safetensors.numpy

from jaxq import batches, executables, parts, programs, run_files, stages, sweeps
from jaxq.plans import plan
from jaxq.runs import RunDirectory

SHORT = {"max_episodes": 50, "success_steps": 30, "success_streak": 2, "eval_episodes": 3}
LONG = {"max_env_steps": 18_000, "max_episodes": 10_000, "stop": "none", "eval_episodes": 3}  # five segments
NETWORK = {"hidden": (8,), "learning_starts": 32, "batch_size": 16, "buffer_size": 200, "eval_episodes": 3}
NETWORK |= {"max_env_steps": 1000, "epsilon_decay": 500.0, "target_period": 10}  # four segments


def tables(**values):
    """A sweep of table learners that end within a segment or two."""
    return plan("q-learning", **{**SHORT, **values})


def long_tables(**values):
    """A sweep of table learners under way for five segments."""
    return plan("q-learning", **{**LONG, **values})


def networks(**values):
    """A sweep of small networks under way for four segments."""
    return plan("dqn", **{**NETWORK, **values})


_programs, _built, _build = {}, {}, executables.build
_each_segment = []


def program(settings, impl):
    """The program of a structure, the same each time."""
    return _programs.setdefault((settings.structural(), impl), programs.program(settings, impl))


def build(made, example, impl, cache=None):
    """Its executables, compiled once for all tests; who watches is told of each segment."""
    if id(made) not in _built:
        built = _build(made, example, impl)

        def advance(*arguments):
            for told in _each_segment:
                told()
            return built.advance(*arguments)

        _built[id(made)] = replace(built, advance=advance)
    return _built[id(made)]


def quickly(patch: pytest.MonkeyPatch) -> None:
    """Compiles a structure once for all tests, writes batches of three lanes, and waits for no disk."""
    patch.setattr(stages, "program", program)
    patch.setattr(executables, "build", build)
    patch.setattr(batches, "BATCH_LANES", 3)
    patch.setattr(batches, "BATCH_SECONDS", 1e9)  # so that a run makes the same files whenever it is made
    patch.setattr(os, "fsync", lambda handle: None)


class Watched:
    """A sweep into a directory, and what it told: ``ran`` the lanes that ended in it, ``said`` its talk, ``rungs`` what
    halving decided. It is stopped in its segment ``stop_in``, counted from 1.
    """

    def __init__(self, path, planned, *, allow=False, stop_in=None, **options):
        self.ran, self.said, self.rungs, self.segments, stop = [], [], [], 0, threading.Event()

        def segment():
            self.segments += 1
            if self.segments == stop_in:
                stop.set()

        def result(one):
            self.ran.append(one.lane[:2])

        options = {"keep_episodes": True, "workers": 1, "stop": stop} | options
        with RunDirectory.open(path, planned, resume=True, allow_mismatch=allow, say=self.said.append) as directory:
            _each_segment[:] = [segment]
            tell = sweeps.Listeners(result=result, rung=self.rungs.append)
            self.outcome = sweeps.run(planned, directory=directory, tell=tell, **options)


def rows(path):
    """The three tables of a run directory, by name."""
    return {kind: parts.read(path, kind) for kind in ("lanes", "curves", "episodes")}


def policies(path):
    """Every saved array by its name. Fails where one is there twice."""
    found = {}
    for number, file in run_files.batches(path):
        if file.suffix == ".safetensors":
            assert number in run_files.committed(path)
            for name, array in safetensors.numpy.load_file(file).items():
                assert name not in found
                found[name] = array
    return found


def assert_same(path, other):
    """Two run directories hold the same rows, each once, and the same policies, bit for bit, and nothing half-done."""
    left, right = rows(path), rows(other)
    keys = list(zip(*(left["lanes"][name].to_pylist() for name in ("config", "seed")), strict=True))
    assert len(keys) == len(set(keys))
    for kind, table in left.items():
        assert bits(table).equals(bits(right[kind])), kind
    mine, theirs = policies(path), policies(other)
    assert mine.keys() == theirs.keys()
    for name, array in mine.items():
        assert array.dtype == theirs[name].dtype
        assert array.tobytes() == theirs[name].tobytes()
    assert not run_files.temporaries(path)
    assert not list((path / run_files.CHECKPOINTS).iterdir())


def bits(table):
    """The table with floats as the words that they are: -0.0 is not 0.0."""
    columns = {
        name: column.combine_chunks().view(pa.int64()) if pa.types.is_float64(column.type) else column
        for name, column in zip(table.column_names, table.columns, strict=True)
    }
    return pa.table(columns)


def contents(path):
    """Every file below a directory with its bytes, but the lock."""
    return {file: file.read_bytes() for file in path.rglob("*") if file.is_file() and file.name != run_files.LOCK}


class Killed(BaseException):
    """The process is dead."""


@contextlib.contextmanager
def full_disk(at):
    """The disk is full at the write ``at``, counted from 0, and from then on. Yields a list, an entry per write."""
    tried = []

    def fsync(handle):
        tried.append(handle)
        if len(tried) > at:
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(os, "fsync", fsync)
        yield tried


@contextlib.contextmanager
def death(at):
    """The process dies at disk operation ``at``, counted from 0: before a temporary file is there, with half of it
    written, before a rename, before a removal. From then on nothing reaches the disk. Yields the operations' names.
    """
    done = []

    def step(name):
        dead = len(done) >= at
        done.append(name)
        return dead

    class Torn(io.BufferedWriter):
        def write(self, data):
            if step("write"):
                super().write(data[: len(data) // 2])
                raise Killed
            return super().write(data)

    def opened(name, mode):
        assert mode == "wb"
        if step(f"open {name}"):
            raise Killed
        return Torn(io.FileIO(name, "w"))

    def before(name, work):
        def stepped(*arguments, **options):
            if step(f"{name} {arguments[0]}"):
                raise Killed
            return work(*arguments, **options)

        return stepped

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(run_files, "open", opened, raising=False)
        for name in ("replace", "unlink"):
            patch.setattr(pathlib.Path, name, before(name, getattr(pathlib.Path, name)))
        yield done


def flip(file):
    """Another bit in the middle of a file."""
    data = bytearray(file.read_bytes())
    data[len(data) // 2] ^= 1
    file.write_bytes(bytes(data))


#: What may happen to a file.
DAMAGES = {
    "a flipped bit": flip,
    "the end cut off": lambda file: file.write_bytes(file.read_bytes()[: file.stat().st_size // 2]),
    "nothing in it": lambda file: file.write_bytes(b""),
    "deleted": lambda file: file.unlink(),
}
