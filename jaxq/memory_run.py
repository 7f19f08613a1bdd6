"""A sweep that stays in memory: what a run directory does, for who calls from Python and wants no files."""

from __future__ import annotations

import shutil
import tempfile
import weakref
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa

from jaxq.checkpoints import Checkpoints
from jaxq.store import Weights
from jaxq.tables import in_order, with_order


class MemoryRun:
    """The tables and policies of a sweep. Lanes that wait at a rung are kept in a temporary folder."""

    def __init__(self) -> None:
        self._tables: dict[str, list[pa.Table]] = {}
        self._policies: dict[tuple[int, int], tuple[dict[str, np.ndarray], dict[str, str]]] = {}
        folder = tempfile.mkdtemp(prefix="jaxq-")
        weakref.finalize(self, shutil.rmtree, folder, ignore_errors=True)  # TemporaryDirectory would warn
        self.checkpoints = Checkpoints(Path(folder), "memory", say=lambda text: None)
        self.manifest: dict[str, Any] = {"rungs": []}

    def write(
        self, tables: Mapping[str, pa.Table], policies: Mapping[tuple[int, int], Weights], about: Mapping[str, str]
    ) -> None:
        """Adds a batch of lanes that ended."""
        for kind, table in tables.items():
            self._tables.setdefault(kind, []).append(table)
        for lane, weights in policies.items():
            self._policies[lane] = dict(weights), dict(about)

    def agree(self, what: str, value: int | str) -> None:
        """There is nothing to agree with."""

    def decide(self, rung: Mapping[str, object]) -> None:
        """Records what halving decided at a rung."""
        self.manifest["rungs"].append(dict(rung))

    def table(self, kind: str, columns: Sequence[str] | None = None) -> pa.Table | None:
        """The rows of one table, ``lanes``, ``curves`` or ``episodes``, or some of its columns; None without any."""
        if not self._tables.get(kind):
            return None
        found = in_order(pa.concat_tables(self._tables[kind], promote_options="permissive"))
        return found if columns is None else found.select(with_order(kind, columns))

    def policy(self, config: int, seed: int) -> tuple[dict[str, np.ndarray], dict[str, str]]:
        """A lane's final weights by name, and what describes them; both empty where it has none."""
        return self._policies.get((config, seed), ({}, {}))

    def policies(self) -> set[tuple[int, int]]:
        """The setting and seed of every lane whose policy was kept."""
        return set(self._policies)
