"""Parts: the tables of a run directory as Parquet files, a batch of lanes each, and the policies beside them."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import safetensors
import safetensors.numpy

from jaxq import run_files
from jaxq.store import Weights
from jaxq.tables import in_order

def table_bytes(table: pa.Table) -> bytes:
    """A table as a Parquet file with a checksum per page."""
    sink = pa.BufferOutputStream()
    pq.write_table(table, sink, write_page_checksum=True, compression="zstd")
    return sink.getvalue().to_pybytes()


def policies_bytes(policies: Mapping[tuple[int, int], Weights], about: Mapping[str, str]) -> bytes:
    """Policies as a safetensors file: ``config/seed/name`` for each array."""
    tensors = {
        f"{config}/{seed}/{name}": np.ascontiguousarray(array)
        for (config, seed), arrays in policies.items()
        for name, array in arrays.items()
    }
    return safetensors.numpy.save(tensors, metadata=dict(about))


def read(path: Path, kind: str) -> pa.Table | None:
    """One table of a run directory, ``lanes``, ``curves`` or ``episodes``, sorted by setting, seed and time.

    Only what was committed counts. None where there is no row.
    """
    sound = run_files.committed(path)
    files = [
        file
        for number, file in run_files.batches(path)
        if number in sound and file.name.endswith(f"-{kind}.parquet")
    ]
    if not files:
        return None
    return in_order(pa.concat_tables([pq.read_table(file) for file in files], promote_options="default"))


def read_policy(path: Path, config: int, seed: int) -> tuple[dict[str, np.ndarray], dict[str, str]]:
    """A lane's final weights by name, and the metadata of their file; both empty where it has none."""
    prefix = f"{config}/{seed}/"
    for _, file in run_files.batches(path):
        if file.suffix == ".safetensors":
            with safetensors.safe_open(file, "numpy") as tensors:
                names = [name for name in tensors.keys() if name.startswith(prefix)]  # noqa: SIM118
                if names:
                    found = {name.removeprefix(prefix): tensors.get_tensor(name) for name in names}
                    return found, tensors.metadata() or {}
    return {}, {}


def is_sound(file: Path) -> bool:
    """Whether a file without a known hash can be read through."""
    try:
        if file.suffix == ".parquet":
            pq.read_table(file, page_checksum_verification=True)
        else:
            safetensors.numpy.load_file(file)
    except (OSError, pa.ArrowException, safetensors.SafetensorError):
        return False
    return True
