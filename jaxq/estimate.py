"""How much memory a sweep needs, known before anything runs: that of the slots, whatever the number of lanes."""

from __future__ import annotations

import math
from typing import Any

import jax

from jaxq import machine, prng
from jaxq.lanes import default_workers
from jaxq.plans import Plan
from jaxq.programs import hypers, program

#: Python, JAX and a compiled program, before the first slot.
PROCESS = 500_000_000
#: Copies of a group's state at once: the one that is advanced, the new lanes', and the one they are put into.
COPIES = 3


def memory(planned: Plan, workers: int | None = None) -> int:
    """Bytes that the sweep needs at its peak, about: the process and the slots of the largest structure."""
    largest = 0
    for one in {settings.structural(): settings for settings in planned.settings}.values():
        made = program(one, planned.prng)
        root = jax.eval_shape(lambda: prng.key(0, planned.prng))
        state, _ = jax.eval_shape(made.experiment.init, root, hypers(one))
        lane = _size(state)
        groups = min(workers or default_workers(), -(-planned.lanes // made.width))
        largest = max(largest, groups * made.width * lane * COPIES)
    return PROCESS + largest


def check(planned: Plan, workers: int | None = None) -> None:
    """Raises MemoryError, with the estimate, where a sweep would not fit into the memory that is free."""
    _check(memory(planned, workers), "the sweep")


def check_size(tree: Any, what: str) -> None:
    """Raises MemoryError, with the size, where arrays of these shapes would not fit into the memory that is free."""
    _check(_size(tree), what)


def _check(need: int, what: str) -> None:
    free = machine.available_memory()
    if free is not None and need > free:
        raise MemoryError(f"{what} needs about {told(need)} of memory, and {told(free)} are free")


def _size(tree: Any) -> int:
    return sum(math.prod(leaf.shape) * leaf.dtype.itemsize for leaf in jax.tree.leaves(tree))


def told(size: int) -> str:
    """Bytes for people: 1.2 GB."""
    for unit, scale in (("GB", 1e9), ("MB", 1e6)):
        if size >= scale:
            return f"{size / scale:.{1 if size < 10 * scale else 0}f} {unit}"
    return f"{size} bytes"
