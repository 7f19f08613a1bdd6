"""Checkpoints: a lane between two segments on disk, with its replay and its books, to go on bit for bit.

A safetensors file whose metadata hold the SHA-256 of its contents, since safetensors itself would load a flipped byte.
Typed keys are never in it: a lane's state holds their words.
"""

from __future__ import annotations

import contextlib
import hashlib
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import jax
import numpy as np
import safetensors
import safetensors.numpy

from jaxq import run_files
from jaxq.tally import Books, Lane, Saved
from jaxq.types import PyTree


@dataclass(frozen=True)
class AtRung:
    """What a paused lane was when halving compared it: the returns of its evaluation and its policy, by name."""

    rung: int
    eval_returns: np.ndarray | None
    policy: dict[str, np.ndarray]


class Checkpoints:
    """The checkpoints of a folder, one per lane under way.

    ``stamp`` is the run's identity. A checkpoint that is damaged, or of another run, is none, and ``say`` is told.
    """

    def __init__(self, folder: Path, stamp: str, say: Callable[[str], None]):
        self.folder, self.stamp, self.say = folder, stamp, say

    def lanes(self) -> list[tuple[int, int]]:
        """The settings and seeds that have one."""
        return sorted(lane for file in self.folder.glob("*") if (lane := run_files.lane_of(file)))

    def save(self, saved: Saved, at: AtRung | None = None) -> None:
        """Writes a lane's checkpoint in the place of the one before. Raises WriteError."""
        arrays = {f"state/{i:05d}": leaf for i, leaf in enumerate(jax.tree.leaves(saved.state))}
        arrays |= {f"books/{name}": array for name, array in saved.books._asdict().items() if array is not None}
        about = {"stamp": self.stamp, "lane": f"{saved.lane.config}/{saved.lane.seed}"}
        if at is not None:
            about["rung"] = str(at.rung)
            arrays |= {f"policy/{name}": array for name, array in at.policy.items()}
            if at.eval_returns is not None:
                arrays["eval_returns"] = at.eval_returns
        arrays = {name: np.ascontiguousarray(array).reshape(np.shape(array)) for name, array in arrays.items()}
        about["sha256"] = _digest(arrays, about)
        data = safetensors.numpy.save(arrays, metadata=about)
        run_files.replace(self._file(saved.lane.config, saved.lane.seed), data)

    def load(self, lane: Lane, shapes: PyTree) -> Saved | None:
        """A lane's checkpoint, whose state has the tree and the leaves of ``shapes``; None without a sound one."""
        found = self._read(lane.config, lane.seed)
        if found is None:
            return None
        arrays, _ = found
        leaves = [arrays[name] for name in sorted(arrays) if name.startswith("state/")]
        wanted = jax.tree.leaves(shapes)
        same = len(leaves) == len(wanted) and all(
            have.shape == want.shape and have.dtype == want.dtype for have, want in zip(leaves, wanted, strict=True)
        )
        if not same:
            self._drop_damaged(lane.config, lane.seed, "is of another program")
            return None
        books = Books(*(arrays.get(f"books/{name}") for name in Books._fields))  # type: ignore[arg-type]
        return Saved(lane, jax.tree.unflatten(jax.tree.structure(shapes), leaves), books)

    def at_rung(self, config: int, seed: int) -> AtRung | None:
        """What a lane was at the rung where it waits; None where it waits at none."""
        found = self._read(config, seed)
        if found is None or "rung" not in found[1]:
            return None
        arrays, about = found
        policy = {n.removeprefix("policy/"): array for n, array in arrays.items() if n.startswith("policy/")}
        return AtRung(int(about["rung"]), arrays.get("eval_returns"), policy)

    def books(self, config: int, seed: int) -> Books | None:
        """What a lane had done."""
        found = self._read(config, seed)
        if found is None:
            return None
        return Books(*(found[0].get(f"books/{name}") for name in Books._fields))  # type: ignore[arg-type]

    def drop(self, config: int, seed: int) -> None:
        """Removes a lane's checkpoint, if there is one."""
        with contextlib.suppress(FileNotFoundError):
            self._file(config, seed).unlink()

    def _file(self, config: int, seed: int) -> Path:
        return self.folder / run_files.checkpoint(config, seed)

    def _read(self, config: int, seed: int) -> tuple[dict[str, np.ndarray], dict[str, str]] | None:
        file = self._file(config, seed)
        if not file.is_file():
            return None
        try:
            with safetensors.safe_open(file, "numpy") as opened:
                about: dict[str, str] = opened.metadata() or {}
                arrays: dict[str, Any] = {name: opened.get_tensor(name) for name in opened.keys()}  # noqa: SIM118
        except (OSError, safetensors.SafetensorError):
            self._drop_damaged(config, seed)
            return None
        if about.get("sha256") != _digest(arrays, about):
            self._drop_damaged(config, seed)
            return None
        if about.get("stamp") != self.stamp or about.get("lane") != f"{config}/{seed}":
            self._drop_damaged(config, seed, "is of another run")
            return None
        return arrays, about

    def _drop_damaged(self, config: int, seed: int, why: str = "is damaged") -> None:
        self.say(f"{self._file(config, seed)}: {why}; the lane begins anew")
        self.drop(config, seed)


def _digest(arrays: dict[str, np.ndarray], about: dict[str, str]) -> str:
    """SHA-256 over names, types, shapes and bytes, and over the metadata but itself."""
    running = hashlib.sha256()
    for name in sorted(about):
        if name != "sha256":
            running.update(f"{name}={about[name]};".encode())
    for name in sorted(arrays):
        array = np.ascontiguousarray(arrays[name])
        running.update(f"{name}:{array.dtype.str}:{np.shape(arrays[name])};".encode())
        running.update(array.tobytes())
    return running.hexdigest()
