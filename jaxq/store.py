"""Where a sweep's rows are: what a run directory and the memory have in common."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, Protocol

import numpy as np
import pyarrow as pa

from jaxq.checkpoints import Checkpoints

#: A lane's policy: arrays by name.
Weights = Mapping[str, np.ndarray]


class Readable(Protocol):
    """Rows and policies that can be read."""

    @property
    def manifest(self) -> dict[str, Any]:
        """What is said of the run; ``rungs`` is what halving decided."""

    def table(self, kind: str, columns: Sequence[str] | None = None) -> pa.Table | None:
        """The rows of one table, ``lanes``, ``curves`` or ``episodes``, or some of its columns; None without any."""

    def policy(self, config: int, seed: int) -> tuple[dict[str, np.ndarray], dict[str, str]]:
        """A lane's final weights by name, and what describes them; both empty where it has none."""

    def policies(self) -> set[tuple[int, int]]:
        """The setting and seed of every lane whose policy was kept."""


class Store(Readable, Protocol):
    """Rows and policies that a sweep adds to."""

    @property
    def checkpoints(self) -> Checkpoints:
        """The lanes under way."""

    def write(
        self,
        tables: Mapping[str, pa.Table],
        policies: Mapping[tuple[int, int], Weights],
        about: Mapping[str, str],
    ) -> None:
        """Adds a batch of lanes that ended: ``tables`` by kind, ``lanes`` among them, and their policies, described by
        ``about``.
        """

    def agree(self, what: str, value: int | str) -> None:
        """Records what the lanes depend on and no spec holds, such as how many of them run together."""

    def decide(self, rung: Mapping[str, object]) -> None:
        """Records what halving decided at a rung."""
