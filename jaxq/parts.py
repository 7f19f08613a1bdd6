"""Parts: the tables of a run directory as Parquet files, a batch of lanes each, and the policies beside them.

A batch's ``lanes`` part, its commit, says in its metadata what else belongs to the batch, with its SHA-256, and its
own: that of the file with zeros in its place, since the checksums of pages do not cover what describes them.
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import safetensors
import safetensors.numpy

from jaxq import run_files
from jaxq.store import Weights
from jaxq.tables import in_order, with_order

_ABOUT = b"jaxq"
#: Where the SHA-256 of a ``lanes`` part stands in it.
_OWN = b'"sha256": "%s"'


def table_bytes(table: pa.Table, about: Mapping[str, Any] | None = None) -> bytes:
    """A table as a Parquet file with a checksum per page; with ``about`` in its metadata, and a SHA-256 of all."""
    says = {} if about is None else {_ABOUT: json.dumps({**about, "sha256": "0" * 64})}
    sink = pa.BufferOutputStream()
    pq.write_table(table.replace_schema_metadata(says), sink, write_page_checksum=True, compression="zstd")
    data = sink.getvalue().to_pybytes()
    return data.replace(_OWN % (b"0" * 64), _OWN % run_files.sha256(data).encode())


def policies_bytes(policies: Mapping[tuple[int, int], Weights], about: Mapping[str, str]) -> bytes:
    """Policies as a safetensors file: ``config/seed/name`` for each array."""
    tensors = {
        f"{config}/{seed}/{name}": np.ascontiguousarray(array).reshape(np.shape(array))  # which would have an axis more
        for (config, seed), arrays in policies.items()
        for name, array in arrays.items()
    }
    return safetensors.numpy.save(tensors, metadata=dict(about))


def read(path: Path, kind: str, columns: Sequence[str] | None = None) -> pa.Table | None:
    """One table of a run directory, ``lanes``, ``curves`` or ``episodes``, or some of its columns, sorted by setting,
    seed and time.

    Only what was committed counts. None where there is no row.
    """
    sound = run_files.committed(path)
    files = [
        file for number, file in run_files.batches(path) if number in sound and file.name.endswith(f"-{kind}.parquet")
    ]
    if not files:
        return None
    wanted = None if columns is None else with_order(kind, columns)
    tables = [pq.read_table(file, columns=wanted).replace_schema_metadata(None) for file in files]
    return in_order(pa.concat_tables(tables, promote_options="permissive"))


def read_policy(path: Path, config: int, seed: int) -> tuple[dict[str, np.ndarray], dict[str, str]]:
    """A lane's final weights by name, and the metadata of their file; both empty where it has none."""
    prefix, sound = f"{config}/{seed}/", run_files.committed(path)
    for number, file in run_files.batches(path):
        if file.suffix == ".safetensors" and number in sound:
            with safetensors.safe_open(file, "numpy") as tensors:
                names = [name for name in tensors.keys() if name.startswith(prefix)]  # noqa: SIM118
                if names:
                    found = {name.removeprefix(prefix): tensors.get_tensor(name) for name in names}
                    return found, tensors.metadata() or {}
    return {}, {}


def kept_policies(path: Path) -> set[tuple[int, int]]:
    """The setting and seed of every lane whose policy was kept."""
    found, sound = set[tuple[int, int]](), run_files.committed(path)
    for number, file in run_files.batches(path):
        if file.suffix == ".safetensors" and number in sound:
            with safetensors.safe_open(file, "numpy") as tensors:
                for name in tensors.keys():  # noqa: SIM118
                    config, seed, _ = name.split("/", 2)
                    found.add((int(config), int(seed)))
    return found


def commit(path: Path, number: str) -> dict[str, Any] | None:
    """What the ``lanes`` part of a batch says of it: ``files``, those that were written before it by their SHA-256, and
    what else it was given. None where the part cannot be read through, or one of the files is not as it was written.
    """
    part = path / run_files.lanes_part(number)
    try:
        metadata = pq.read_metadata(part).metadata or {}
        about: dict[str, Any] = json.loads(metadata[_ABOUT])
        own = about.pop("sha256")
        blank = part.read_bytes().replace(_OWN % own.encode(), _OWN % (b"0" * 64))
        same = run_files.sha256(blank) == own and all(
            run_files.sha256((path / name).read_bytes()) == digest for name, digest in about["files"].items()
        )
    except (OSError, ValueError, KeyError, TypeError, AttributeError, pa.ArrowException):
        return None
    there = {file for found, file in run_files.batches(path) if found == number}
    return about if same and there == {part, *(path / name for name in about["files"])} else None
