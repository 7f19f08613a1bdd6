"""The trees of a group, a row per slot: stacked, read and replaced on the host."""

from __future__ import annotations

from typing import Any

import jax
import numpy as np

from jaxq.types import Clock, Hypers, PyTree


def row_of(slot: int, tree: PyTree) -> PyTree:
    """A copy of one slot's leaves."""
    return jax.tree.map(lambda leaf: np.asarray(leaf)[slot].copy(), tree)


def with_rows(tree: PyTree, rows: dict[int, PyTree]) -> PyTree:
    """The tree with some slots replaced."""

    def replaced(leaf: Any, *new: np.ndarray) -> np.ndarray:
        after = np.array(leaf)
        for slot, row in zip(rows, new, strict=True):
            after[slot] = row
        return after

    return jax.tree.map(replaced, tree, *rows.values())


def copied(clock: Clock) -> Clock:
    """The numbers of a clock, which the next segment will overwrite."""
    return jax.tree.map(np.array, clock)


class Stack:
    """The numbers of a group's lanes as one tree; new arrays when a lane's are other ones, since a program may still
    read the old, and the last tree again when all are the same objects, as in a sweep over seeds."""

    def __init__(self) -> None:
        self.rows: list[Hypers] = []
        self.stacked: Any = None

    def __call__(self, rows: list[Hypers]) -> Hypers:
        if len(rows) != len(self.rows) or any(new is not old for new, old in zip(rows, self.rows, strict=True)):
            self.rows, self.stacked = rows, jax.device_put(jax.tree.map(lambda *leaves: np.stack(leaves), *rows))
        return self.stacked
