"""The run directory: what a sweep leaves on disk, written so that a kill loses only the lanes under way.

``manifest.json`` says what was asked for and with what, ``sweep.toml`` is the sweep as a file; ``parts/`` holds batches
of rows, ``policies/`` the weights, ``checkpoints/`` long lanes under way. Every file is written under a temporary name,
synced and renamed. A batch's ``lanes`` part is written last and is the commit: rows without it never happened.
"""

from __future__ import annotations

import contextlib
import json
import os
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path

import filelock
import numpy as np
import pyarrow as pa

from jaxq import manifest, parts, repair, run_files, sweep_files
from jaxq.checkpoints import Checkpoints
from jaxq.manifest import BrokenManifest, Manifest, RunError
from jaxq.plans import Plan
from jaxq.run_files import WriteError
from jaxq.store import Weights


class Locked(RunError):
    """Another process has the run directory; the message says which."""


class RunDirectory:
    """One sweep's directory, locked while it is open. Use as a context manager.

    ``resumed`` tells whether it holds an earlier run, ``checkpoints`` are those of its lanes under way.
    """

    def __init__(self, path: Path, held: Manifest, lock: filelock.BaseFileLock, resumed: bool, allow: bool, say: Say):
        self.path, self.manifest, self._lock, self.resumed = path, held, lock, resumed
        self._allow = allow
        self.checkpoints = Checkpoints(path / run_files.CHECKPOINTS, held["id"], say)

    @classmethod
    def open(
        cls,
        path: Path,
        plan: Plan,
        *,
        resume: bool = False,
        overwrite: bool = False,
        allow_mismatch: bool = False,
        say: Say = lambda text: None,
    ) -> RunDirectory:
        """Creates the directory, or opens it again for the same plan; a vacant one is begun whatever is asked.

        What is damaged is put aside and told to ``say``. ``allow_mismatch`` goes on with a run that was made otherwise,
        and notes it. Raises RunError when it holds a run and neither ``resume`` nor ``overwrite`` is given, when it
        holds something else, when it cannot be made, or when it was made otherwise; Locked when another process has it;
        WriteError when the disk does not take it.
        """
        try:
            _goes_on(path, resume, overwrite)
            made = [folder for folder in (path, *path.parents) if not folder.exists()]
            path.mkdir(parents=True, exist_ok=True)
            lock = _locked(path)
        except OSError as error:
            raise RunError(f"{path}: {error.strerror}") from None
        try:
            if _goes_on(path, resume, overwrite):  # again: another process may have had it in between
                run = cls._again(path, plan, lock, allow_mismatch, say)
            else:
                run = cls._anew(path, plan, lock, say, made)
            return run
        except OSError as error:
            lock.release()
            raise WriteError(f"{path}: {error.strerror}") from None
        except BaseException:
            lock.release()
            raise

    @classmethod
    def _again(cls, path: Path, plan: Plan, lock: filelock.BaseFileLock, allow: bool, say: Say) -> RunDirectory:
        before = None
        try:
            found = manifest.read(path / run_files.MANIFEST)
            before = found["spec_hash"]
            manifest.agree(path, found, plan, allow)
        except BrokenManifest as error:
            if not allow:
                raise
            say(f"{str(error).split(';')[0]}; it is made again of the parts that are sound")
            found = manifest.new(plan)
            manifest.note(found, [("manifest", "damaged", "made of the parts")])
            repair.rebuild(path, plan, found, say)
            with contextlib.suppress(FileNotFoundError):
                repair.put_aside(path, path / run_files.MANIFEST)
        for folder in run_files.FOLDERS:
            (path / folder).mkdir(exist_ok=True)
        for file in run_files.temporaries(path):
            file.unlink()
        repair.settle(path, found, say)
        run = cls(path, found, lock, resumed=True, allow=allow, say=say)
        run._write_manifest()
        if before != plan.hash() or not (path / run_files.SWEEP).exists():
            run._write_sweep(plan)
        return run

    @classmethod
    def _anew(cls, path: Path, plan: Plan, lock: filelock.BaseFileLock, say: Say, made: list[Path]) -> RunDirectory:
        for file in (*run_files.temporaries(path), *run_files.own_files(path)):
            file.unlink()
        run = cls(path, manifest.new(plan), lock, resumed=False, allow=False, say=say)
        try:
            for folder in run_files.FOLDERS:
                (path / folder).mkdir(exist_ok=True)
            run._write_manifest()  # first: a directory without one is not a run
            run._write_sweep(plan)
        except (OSError, RunError, WriteError):
            _unmake(path, made)
            raise
        return run

    def __enter__(self) -> RunDirectory:
        return self

    def __exit__(self, *error: object) -> None:
        self._lock.release()

    def write(
        self,
        tables: Mapping[str, pa.Table],
        policies: Mapping[tuple[int, int], Weights],
        about: Mapping[str, str] | None = None,
    ) -> None:
        """Adds a batch of lanes that ended: ``tables`` by kind, ``lanes`` among them, and their policies, described by
        ``about``. Raises WriteError when it cannot be written.
        """
        # From the files, not the manifest: a kill between a commit and the manifest must not reuse its number.
        number = f"{1 + max((int(batch) for batch, _ in run_files.batches(self.path)), default=-1):05d}"
        written: dict[str, str] = {}

        def keep(name: str, data: bytes) -> None:
            run_files.replace(self.path / name, data)
            written[name] = run_files.sha256(data)

        if policies:
            keep(f"{run_files.POLICIES}/{number}.safetensors", parts.policies_bytes(policies, about or {}))
        for kind in tables:
            if kind != "lanes" and len(tables[kind]):
                keep(f"{run_files.PARTS}/{number}-{kind}.parquet", parts.table_bytes(tables[kind]))
        says = {"files": dict(written), "sweep": manifest.kin(self.manifest["spec"]), "rungs": self.manifest["rungs"]}
        keep(run_files.lanes_part(number), parts.table_bytes(tables["lanes"], says))
        self.manifest["files"] |= written
        self._write_manifest()

    def agree(self, what: str, value: int | str) -> None:
        """Records what the lanes depend on and no spec holds, such as how many of them run together.

        Raises RunError where the run was begun otherwise.
        """
        agreed = self.manifest["agreed"]
        before = agreed.get(what, value)
        if before != value:
            if not self._allow:
                raise RunError(manifest.otherwise(self.path, f"{what} was {before}, is {value}"))
            manifest.note(self.manifest, [(what, before, value)])
        if agreed.get(what) != value:
            agreed[what] = value
            self._write_manifest()

    def decide(self, rung: Mapping[str, object]) -> None:
        """Records what halving decided at a rung."""
        self.manifest["rungs"].append(dict(rung))
        self._write_manifest()

    def table(self, kind: str, columns: Sequence[str] | None = None) -> pa.Table | None:
        """The committed rows of one table, ``lanes``, ``curves`` or ``episodes``, or some of its columns; None without
        any.
        """
        return parts.read(self.path, kind, columns)

    def policy(self, config: int, seed: int) -> tuple[dict[str, np.ndarray], dict[str, str]]:
        """A lane's final weights by name, and what describes them; both empty where it has none."""
        return parts.read_policy(self.path, config, seed)

    def policies(self) -> set[tuple[int, int]]:
        """The setting and seed of every lane whose policy was kept."""
        return parts.kept_policies(self.path)

    def _write_sweep(self, plan: Plan) -> None:
        with contextlib.suppress(ValueError):  # of a function of the user's own there is no file
            run_files.replace(self.path / run_files.SWEEP, sweep_files.text(plan).encode())

    def _write_manifest(self) -> None:
        self.manifest["process"] = os.getpid()
        run_files.replace(self.path / run_files.MANIFEST, json.dumps(self.manifest, indent=1).encode())


Say = Callable[[str], None]


def _locked(path: Path) -> filelock.BaseFileLock:
    """The directory's lock. The process that has it stands in the manifest: opening the lock's file empties it."""
    lock = filelock.FileLock(path / run_files.LOCK)
    try:
        lock.acquire(timeout=0)
    except filelock.Timeout:
        who = "another process"
        with contextlib.suppress(OSError, ValueError, TypeError, KeyError):
            who = f"process {int(json.loads((path / run_files.MANIFEST).read_text())['process'])}"
        raise Locked(f"{path}: {who} is writing to it") from None
    return lock


def _goes_on(path: Path, resume: bool, overwrite: bool) -> bool:
    """Whether a directory holds a run to go on with, not one to begin. Raises RunError for what is refused."""
    if not path.exists() or (path.is_dir() and not run_files.foreign(path) and not run_files.own_files(path)):
        return False  # nothing, or what a run left that could not even write its manifest
    if not path.is_dir() or (run_files.foreign(path) and not _says_run(path / run_files.MANIFEST)):
        raise RunError(f"{path}: exists and is not a run directory; choose another --out")
    if not (resume or overwrite):
        raise RunError(f"{path}: exists; add --resume to finish it or --overwrite to replace it")
    return not overwrite


def _says_run(marked: Path) -> bool:
    """Whether a manifest, of whatever version, is a run's."""
    try:
        found = json.loads(marked.read_text())
    except (OSError, ValueError):
        return False
    return isinstance(found, dict) and "spec_hash" in found and isinstance(found.get("format"), int)


def _unmake(path: Path, made: list[Path]) -> None:
    """Takes back a directory that could not be begun: the empty folders of a run, and those made on the way."""
    for name in (run_files.LOCK, run_files.MANIFEST, run_files.SWEEP):
        with contextlib.suppress(OSError):
            (path / name).unlink()
    for folder in (*(path / name for name in run_files.FOLDERS), *made):
        with contextlib.suppress(OSError):
            folder.rmdir()  # leaves one that holds anything
