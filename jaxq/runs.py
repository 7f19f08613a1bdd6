"""The run directory: what a sweep leaves on disk, written so that a kill loses only the lanes under way.

``manifest.json`` says what was asked for and with what; ``parts/`` holds batches of rows, ``policies/`` the weights.
Every file is written under a temporary name, synced and renamed. A batch's ``lanes`` part is written last and is the
commit: rows without it never happened.
"""

from __future__ import annotations

import hashlib
import json
import os
import platform
import re
from collections.abc import Sequence
from importlib import metadata
from pathlib import Path
from typing import Any

import filelock
import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import safetensors.numpy

from jaxq import machine
from jaxq.plans import Plan
from jaxq.tables import Row

FORMAT = 1
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


class RunError(Exception):
    """A run directory that cannot be used; the message says why and what to do."""


class Locked(RunError):
    """Another process has the run directory."""


class RunDirectory:
    """One sweep's directory, locked while it is open. Use as a context manager."""

    def __init__(self, path: Path, manifest: dict[str, Any], lock: filelock.BaseFileLock):
        self.path, self.manifest, self._lock = path, manifest, lock

    @classmethod
    def open(cls, path: Path, plan: Plan, *, resume: bool = False, overwrite: bool = False) -> RunDirectory:
        """Creates the directory, or opens it again for the same plan.

        Raises RunError when it exists and neither ``resume`` nor ``overwrite`` is given, when it cannot be made, or
        when it was made for another plan; Locked when another process has it.
        """
        try:
            occupied = path.exists() and (not path.is_dir() or any(path.iterdir()))
            if occupied and not (resume or overwrite):
                raise RunError(f"{path}: exists; add --resume to finish it or --overwrite to replace it")
            if occupied and overwrite and not _is_run(path):
                raise RunError(f"{path}: is not a run directory, so it is not overwritten")
            found = _read_manifest(path / "manifest.json") if occupied and not overwrite else None
            path.mkdir(parents=True, exist_ok=True)
            lock = filelock.FileLock(path / "lock")
            lock.acquire(timeout=0)
        except filelock.Timeout:
            raise Locked(f"{path}: another process is writing to it") from None
        except OSError as error:
            raise RunError(f"{path}: {error.strerror}") from None
        try:
            if found is not None:
                _same(path, found, {"spec_hash": plan.hash(), **_machine()})
                run = cls(path, found, lock)
                run._remove_uncommitted()
                return run
            for part in _own_files(path):
                part.unlink()
            manifest = {"format": FORMAT, "spec_hash": plan.hash(), "spec": plan.spec(), **_machine(), "parts": {}}
            run = cls(path, manifest, lock)
            (path / "parts").mkdir(exist_ok=True)
            (path / "policies").mkdir(exist_ok=True)
            run._write_manifest()
            return run
        except OSError as error:
            lock.release()
            raise RunError(f"{path}: {error.strerror}") from None
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
        """Adds a batch of lanes that ended. Raises RunError when it cannot be written."""
        # From the files, not the manifest: a kill between a commit and the manifest must not reuse its number.
        number = 1 + max((int(file.name[:5]) for file in _own_files(self.path) if _BATCH.match(file.name)), default=-1)
        tensors = {
            f"{config}/{seed}/{name}": np.ascontiguousarray(array)
            for (config, seed), arrays in policies.items()
            for name, array in arrays.items()
        }
        self._replace(f"policies/{number:05d}.safetensors", safetensors.numpy.save(tensors))
        for kind, rows in (("curves", curves), ("episodes", episodes), ("lanes", lanes)):
            if rows:
                sink = pa.BufferOutputStream()
                pq.write_table(_table(kind, rows), sink, write_page_checksum=True, compression="zstd")
                data = sink.getvalue().to_pybytes()
                name = f"{number:05d}-{kind}.parquet"
                self._replace(f"parts/{name}", data)
                self.manifest["parts"][name] = hashlib.sha256(data).hexdigest()
        self._write_manifest()

    def agree_width(self, config: int, width: int) -> None:
        """Records how many lanes run together in the program of setting ``config``, which decides their bits.

        Raises RunError where the run was begun with another width.
        """
        widths = self.manifest.setdefault("widths", {})
        if widths.setdefault(str(config), width) != width:
            raise RunError(
                f"{self.path}: was made with width {widths[str(config)]}, this is {width}; choose another --out"
            )
        self._write_manifest()

    def rows(self, kind: str) -> list[Row]:
        """The committed rows of one table, ``lanes``, ``curves`` or ``episodes``."""
        for name in self.manifest["parts"]:
            if name.endswith(f"-{kind}.parquet"):
                self._verify(name)
        return read_rows(self.path, kind)

    def policy(self, config: int, seed: int) -> dict[str, np.ndarray]:
        """A lane's final weights by the names that ``flatten`` gives them, ``table`` for a table.

        Raises RunError when they are not there or cannot be read.
        """
        prefix = f"{config}/{seed}/"
        found: dict[str, np.ndarray] = {}
        for file in sorted((self.path / "policies").glob("*.safetensors")):
            try:
                with safetensors.safe_open(file, "numpy") as tensors:
                    names = [name for name in tensors.keys() if name.startswith(prefix)]  # noqa: SIM118
                    found |= {name.removeprefix(prefix): tensors.get_tensor(name) for name in names}
            except (OSError, safetensors.SafetensorError):
                raise RunError(f"{file}: cannot be read; start again with --overwrite") from None
        if not found:
            raise RunError(f"{self.path}: has no policy of setting {config} seed {seed}; start again with --overwrite")
        return found

    def _verify(self, name: str) -> None:
        file = self.path / "parts" / name
        if not file.exists() or hashlib.sha256(file.read_bytes()).hexdigest() != self.manifest["parts"][name]:
            raise RunError(f"{file}: is damaged; start again with --overwrite")

    def _remove_uncommitted(self) -> None:
        """Drops what a kill left of a batch before its commit."""
        committed = {file.name[:5] for file in (self.path / "parts").glob("*-lanes.parquet")}
        for file in _own_files(self.path):
            if _BATCH.match(file.name) and file.name[:5] not in committed:
                file.unlink()
        self.manifest["parts"] = {k: v for k, v in self.manifest["parts"].items() if k[:5] in committed}

    def _replace(self, name: str, data: bytes) -> None:
        target = self.path / name
        temporary = target.with_name(f".{target.name}.tmp")
        try:
            with open(temporary, "wb") as file:
                file.write(data)
                file.flush()
                os.fsync(file.fileno())
            temporary.replace(target)
        except OSError as error:
            temporary.unlink(missing_ok=True)
            raise RunError(f"{target}: {error.strerror}") from None

    def _write_manifest(self) -> None:
        self._replace("manifest.json", json.dumps(self.manifest, indent=1).encode())


def read_rows(path: Path, kind: str) -> list[Row]:
    """The committed rows of one table of a run directory, sorted by setting and seed."""
    committed = sorted(file.name[:5] for file in (path / "parts").glob("*-lanes.parquet"))
    files = [path / "parts" / f"{number}-{kind}.parquet" for number in committed]
    rows = [row for file in files if file.exists() for row in pq.read_table(file).to_pylist()]
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


_BATCH = re.compile(r"\d{5}(-(lanes|curves|episodes)\.parquet|\.safetensors)$")
_PICTURES = {"learning_curves.png", "q_values.png", "episodes.png"}


def _own_files(path: Path) -> list[Path]:
    """What a run writes, by name; nothing else in the directory is ever touched."""
    batches = [
        file for folder in ("parts", "policies") for file in (path / folder).glob("*") if _BATCH.match(file.name)
    ]
    return [file for file in [*batches, *(path / name for name in _PICTURES)] if file.is_file()]


def _is_run(path: Path) -> bool:
    """Whether the directory was made by a run: a manifest that says so, or nothing in it but a run's files."""
    try:
        _read_manifest(path / "manifest.json")
        return True
    except RunError:
        files = {file for file in path.rglob("*") if file.is_file()}
        return path.is_dir() and files <= {*_own_files(path), path / "manifest.json", path / "lock"}


def _read_manifest(path: Path) -> dict[str, Any]:
    try:
        manifest = json.loads(path.read_text())
    except (OSError, ValueError):
        raise RunError(f"{path}: cannot be read; choose another --out") from None
    if not isinstance(manifest, dict) or manifest.get("format") != FORMAT or "spec_hash" not in manifest:
        raise RunError(f"{path}: is not a manifest of this version; choose another --out")
    return manifest


def _same(path: Path, found: dict[str, Any], here: dict[str, Any]) -> None:
    """Refuses to mix results: the bits of a lane depend on all of these."""
    if found["spec_hash"] != here["spec_hash"]:
        raise RunError(f"{path}: was made for another sweep; choose another --out")
    for name, value in here.items():
        if found.get(name) != value:
            raise RunError(f"{path}: was made with {name} {found.get(name)}, this is {value}; choose another --out")


def _table(kind: str, rows: Sequence[Row]) -> pa.Table:
    """Rows as a table whose types do not depend on which values happen to be None."""
    types = _TYPES[kind]
    return pa.table({name: pa.array([row[name] for row in rows], types.get(name)) for name in rows[0]})


def _machine() -> dict[str, Any]:
    packages = ("jaxq", "jax", "jaxlib", "flax", "optax", "numpy")
    return {
        "versions": {name: metadata.version(name) for name in packages} | {"python": platform.python_version()},
        "cpu": machine.processor(),
        "xla_flags": os.environ.get("XLA_FLAGS", ""),
    }
