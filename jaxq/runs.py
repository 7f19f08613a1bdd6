"""The run directory: what a sweep leaves on disk, written so that a kill loses only the lanes under way.

``manifest.json`` says what was asked for and with what; ``parts/`` holds batches of rows, ``policies/`` the weights.
Every file is written under a temporary name, synced and renamed. A batch's ``lanes`` part is written last and is the
commit: rows without it never happened.
"""

from __future__ import annotations

import contextlib
import hashlib
import json
import os
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import filelock
import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import safetensors.numpy

from jaxq import manifest, run_files
from jaxq.manifest import Manifest, RunError
from jaxq.plans import Plan
from jaxq.tables import Row

#: Columns of each table that may be all None in a batch, and so must be told their type.
_COUNT, _REAL = pa.int64(), pa.float64()
_TYPES = {
    "lanes": {
        "learning_rate_end": _REAL,
        "solved_at_episode": _COUNT,
        "solved_at_step": _COUNT,
        "diverged_at_step": _COUNT,
        "stopped_at_rung": _COUNT,
        "final_return": _REAL,
        "eval_return": _REAL,
    },
    "curves": dict.fromkeys(("train_return", "eval_return", "loss", "max_q", "epsilon"), _REAL),
    "episodes": dict.fromkeys(("return", "max_q"), _REAL),
}


class Locked(RunError):
    """Another process has the run directory."""


class WriteError(RunError):
    """The disk does not take what is written."""


class RunDirectory:
    """One sweep's directory, locked while it is open. Use as a context manager.

    ``resumed`` tells whether it holds an earlier run.
    """

    def __init__(self, path: Path, held: Manifest, lock: filelock.BaseFileLock, resumed: bool):
        self.path, self.manifest, self._lock, self.resumed = path, held, lock, resumed

    @classmethod
    def open(cls, path: Path, plan: Plan, *, resume: bool = False, overwrite: bool = False) -> RunDirectory:
        """Creates the directory, or opens it again for the same plan; a vacant one is begun whatever is asked.

        Raises RunError when it holds a run and neither ``resume`` nor ``overwrite`` is given, when it holds something
        else, when it cannot be made, when a file is damaged, or when it was made for another plan; Locked when another
        process has it.
        """
        try:
            _goes_on(path, resume, overwrite)
            made = [folder for folder in (path, *path.parents) if not folder.exists()]
            path.mkdir(parents=True, exist_ok=True)
            lock = filelock.FileLock(path / run_files.LOCK)
            lock.acquire(timeout=0)
        except filelock.Timeout:
            raise Locked(f"{path}: another process is writing to it") from None
        except OSError as error:
            raise RunError(f"{path}: {error.strerror}") from None
        try:
            goes_on = _goes_on(path, resume, overwrite)  # again: another process may have had it in between
            found = manifest.read(path / run_files.MANIFEST) if goes_on else None
            if found is not None:
                manifest.agree(path, found, plan)
            for file in run_files.temporaries(path):
                file.unlink()
            if found is not None:
                run = cls(path, found, lock, resumed=True)
                run._settle()
                return run
            for file in run_files.own_files(path):
                file.unlink()
            run = cls(path, manifest.new(plan), lock, resumed=False)
            try:
                for folder in run_files.FOLDERS:
                    (path / folder).mkdir(exist_ok=True)
                run._write_manifest()
            except (OSError, RunError):
                _unmake(path, made)
                raise
            return run
        except OSError as error:
            lock.release()
            raise WriteError(f"{path}: {error.strerror}") from None
        except BaseException:
            lock.release()
            raise

    def __enter__(self) -> RunDirectory:
        return self

    def __exit__(self, *error: object) -> None:
        self._lock.release()

    def write(
        self,
        lanes: Sequence[Row],
        curves: Sequence[Row],
        policies: dict[tuple[int, int], dict[str, np.ndarray]],
        episodes: Sequence[Row] = (),
    ) -> None:
        """Adds a batch of lanes that ended. Raises WriteError when it cannot be written."""
        # From the files, not the manifest: a kill between a commit and the manifest must not reuse its number.
        number = f"{1 + max((int(batch) for batch, _ in run_files.batches(self.path)), default=-1):05d}"
        tensors = {
            f"{config}/{seed}/{name}": np.ascontiguousarray(array)
            for (config, seed), arrays in policies.items()
            for name, array in arrays.items()
        }
        self._keep(f"policies/{number}.safetensors", safetensors.numpy.save(tensors))
        for kind, rows in (("curves", curves), ("episodes", episodes), ("lanes", lanes)):
            if rows:
                sink = pa.BufferOutputStream()
                pq.write_table(_table(kind, rows), sink, write_page_checksum=True, compression="zstd")
                self._keep(f"parts/{number}-{kind}.parquet", sink.getvalue().to_pybytes())
        self._write_manifest()

    def agree_width(self, config: int, width: int) -> None:
        """Records how many lanes run together in the program of setting ``config``, which decides their bits.

        Raises RunError where the run was begun with another width.
        """
        widths = self.manifest["widths"]
        if widths.setdefault(str(config), width) != width:
            raise RunError(
                f"{self.path}: was made with width {widths[str(config)]}, this is {width}; choose another --out"
            )
        self._write_manifest()

    def rows(self, kind: str) -> list[Row]:
        """The committed rows of one table, ``lanes``, ``curves`` or ``episodes``."""
        return read_rows(self.path, kind)

    def policy(self, config: int, seed: int) -> dict[str, np.ndarray]:
        """A lane's final weights by the names that ``flatten`` gives them, ``table`` for a table; {} without any."""
        prefix = f"{config}/{seed}/"
        found: dict[str, np.ndarray] = {}
        for _, file in run_files.batches(self.path):
            if file.suffix == ".safetensors":
                with safetensors.safe_open(file, "numpy") as tensors:
                    names = [name for name in tensors.keys() if name.startswith(prefix)]  # noqa: SIM118
                    found |= {name.removeprefix(prefix): tensors.get_tensor(name) for name in names}
        return found

    def _settle(self) -> None:
        """Drops what a kill left of a batch before its commit, and sees that all else is as it was written."""
        batches = list(run_files.batches(self.path))
        committed = {number for number, file in batches if file.name.endswith("-lanes.parquet")}
        for number, file in batches:
            if number not in committed:
                file.unlink()
        hashes = self.manifest["files"]
        hashes = {name: digest for name, digest in hashes.items() if run_files.batch(Path(name)) in committed}
        for name, digest in hashes.items():
            file = self.path / name
            if not file.is_file() or _sha256(file.read_bytes()) != digest:
                raise RunError(f"{file}: is damaged; --overwrite starts anew")
        for number, file in batches:
            name = f"{file.parent.name}/{file.name}"
            if number in committed and name not in hashes:  # a kill came between the commit and the manifest
                _check(file)
                hashes[name] = _sha256(file.read_bytes())
        self.manifest["files"] = hashes

    def _keep(self, name: str, data: bytes) -> None:
        self._replace(name, data)
        self.manifest["files"][name] = _sha256(data)

    def _replace(self, name: str, data: bytes) -> None:
        target = self.path / name
        temporary = run_files.temporary(target)
        try:
            with open(temporary, "wb") as file:
                file.write(data)
                file.flush()
                os.fsync(file.fileno())
            temporary.replace(target)
        except OSError as error:
            with contextlib.suppress(OSError):
                temporary.unlink()
            raise WriteError(f"{target}: {error.strerror}") from None

    def _write_manifest(self) -> None:
        self._replace(run_files.MANIFEST, json.dumps(self.manifest, indent=1).encode())


def read_rows(path: Path, kind: str) -> list[Row]:
    """The committed rows of one table of a run directory, sorted by setting and seed."""
    committed = {number for number, file in run_files.batches(path) if file.name.endswith("-lanes.parquet")}
    files = [
        file
        for number, file in run_files.batches(path)
        if number in committed and file.name.endswith(f"-{kind}.parquet")
    ]
    rows = [row for file in files for row in pq.read_table(file).to_pylist()]
    return sorted(rows, key=lambda row: (row["config"], row["seed"]))


def flatten(policy: Any) -> dict[str, np.ndarray]:
    """A policy's arrays by path: ``table`` for a table, ``params.Linear_0.kernel`` and so on for a network."""
    if isinstance(policy, dict):
        return {
            f"{name}.{rest}" if rest else name: array
            for name, branch in policy.items()
            for rest, array in flatten(branch).items()
        }
    if isinstance(policy, (list, tuple)):
        return flatten({str(i): branch for i, branch in enumerate(policy)})
    return {"": np.asarray(policy)}


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
    with contextlib.suppress(OSError):
        (path / run_files.LOCK).unlink()
    for folder in (*(path / name for name in run_files.FOLDERS), *made):
        with contextlib.suppress(OSError):
            folder.rmdir()  # leaves one that holds anything


def _check(file: Path) -> None:
    """Raises RunError for a file without a hash that cannot be read."""
    try:
        if file.suffix == ".parquet":
            pq.read_table(file, page_checksum_verification=True)
        else:
            safetensors.numpy.load_file(file)
    except (OSError, pa.ArrowException, safetensors.SafetensorError):
        raise RunError(f"{file}: is damaged; --overwrite starts anew") from None


def _sha256(data: bytes) -> str:
    return hashlib.sha256(data).hexdigest()


def _table(kind: str, rows: Sequence[Row]) -> pa.Table:
    """Rows as a table whose types do not depend on which values happen to be None."""
    types = _TYPES[kind]
    return pa.table({name: pa.array([row[name] for row in rows], types.get(name)) for name in rows[0]})
