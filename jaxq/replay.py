"""Experience replay as pure functions: a ring of transitions and uniform batches from it.

Lin, *Self-Improving Reactive Agents Based on Reinforcement Learning, Planning and Teaching*, 1992; Mnih et al.,
*Human-level control through deep reinforcement learning*, 2015.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple

import jax
import jax.numpy as jnp

from jaxq.types import Array, Key, Transition


class Replay(NamedTuple):
    """A ring of transitions: ``storage`` [capacity], the row written next, and how many rows hold one."""

    storage: Transition
    position: Array
    size: Array


@dataclass(frozen=True)
class ReplayBuffer:
    """A replay as pure functions. Keys come first and are consumed.

    ``init(example) -> Replay``, where ``example`` is one Transition of the right shapes and dtypes.
    ``add(state, transitions) -> Replay`` writes M transitions [M] over the oldest ones.
    ``sample(key, state) -> Transition`` [B].
    """

    init: Callable[[Transition], Replay]
    add: Callable[[Replay, Transition], Replay]
    sample: Callable[[Key, Replay], Transition]


def uniform(capacity: int, batch_size: int, *, replacement: bool = False) -> ReplayBuffer:
    """A replay of ``capacity`` transitions that draws ``batch_size`` of the stored ones, all equally likely.

    Without replacement every set of B stored transitions is equally likely (see ``floyd`` for the order and for the
    bias of 2^-32), with it the B draws are independent. The cost of ``add`` and ``sample`` does not grow with the
    capacity. Warm-up stores at least B transitions first: with fewer, a batch without replacement repeats some of them
    (never an unwritten row), and with none it is the zeros of ``init``.

    Raises ValueError when B is not in 1 .. capacity, or when more than ``capacity`` transitions are added at once.
    """
    if not 1 <= batch_size <= capacity:
        raise ValueError(f"batch_size must be between 1 and the capacity {capacity}, got {batch_size}")

    def init(example: Transition) -> Replay:
        storage = jax.tree.map(lambda x: jnp.zeros((capacity, *jnp.shape(x)), jnp.result_type(x)), example)
        return Replay(storage, position=jnp.zeros((), jnp.int32), size=jnp.zeros((), jnp.int32))

    def add(state: Replay, transitions: Transition) -> Replay:
        count = transitions.r_t.shape[0]
        if count > capacity:
            raise ValueError(f"at most {capacity} transitions (the capacity) can be added at once, got {count}")
        rows = (state.position + jnp.arange(count, dtype=jnp.int32)) % capacity
        if count == 1:
            # XLA turns a scatter of one row into a slice update and fuses that into the reads of ``sample``, which then
            # need the old storage too: a copy of whole leaves at every step. So a single row is written twice.
            rows, transitions = jax.tree.map(lambda x: jnp.repeat(x, 2, axis=0), (rows, transitions))
        storage = jax.tree.map(
            lambda stored, new: stored.at[rows].set(new, mode="promise_in_bounds"), state.storage, transitions
        )
        return Replay(storage, (state.position + count) % capacity, jnp.minimum(state.size + count, capacity))

    def sample(key: Key, state: Replay) -> Transition:
        words = jax.random.bits(key, (batch_size,), jnp.uint32)
        rows = bounded(words, jnp.maximum(state.size, 1)) if replacement else floyd(words, state.size)
        return jax.tree.map(lambda stored: stored.at[rows].get(mode="promise_in_bounds"), state.storage)

    return ReplayBuffer(init, add, sample)


def floyd(words: Array, size: Array) -> Array:
    """B distinct integers below ``size``, every set of them equally likely, from B random words.

    For k = 0 .. B-1: j = size - B + k; t uniform in 0 .. j; the k-th integer is t, or j where t was chosen before.
    The order is not uniform (the last row can only come last), which a mean over the batch does not see. When ``size``
    is below B integers repeat. Shapes: words [B] uint32, size [] -> [B] int32. Bentley and Floyd, *A sample of
    brilliance*, Communications of the ACM, 1987.
    """
    batch_size = words.shape[0]
    last = jnp.maximum(size - batch_size + jnp.arange(batch_size, dtype=jnp.int32), 0)
    drawn = bounded(words, last + 1)

    # Why not resolve the collisions in parallel: XLA on CPU compiles this short loop into one kernel (3 us for B = 128)
    # and does not vectorise the reduction of a B x B comparison (40 us).
    def choose(k: Array, chosen: Array) -> Array:
        taken = jnp.any(chosen == drawn[k])
        return chosen.at[k].set(jnp.where(taken, last[k], drawn[k]))

    return jax.lax.fori_loop(0, batch_size, choose, jnp.full((batch_size,), -1, jnp.int32))


def bounded(word: Array, bound: Array) -> Array:
    """A random 32-bit word as an integer in 0 .. bound - 1: the high word of the 64-bit product.

    i = floor(word bound / 2^32). No value's probability differs from 1 / bound by 2^-32 or more. Shapes: word uint32
    and bound alike or broadcast -> int32. Lemire, *Fast Random Integer Generation in an Interval*, 2019.

    >>> int(bounded(jnp.uint32(2**31), jnp.int32(10)))
    5
    """
    bound = jnp.asarray(bound).astype(jnp.uint32)
    word_high, word_low = word >> 16, word & 0xFFFF
    bound_high, bound_low = bound >> 16, bound & 0xFFFF
    # Products of halves in 32-bit arithmetic; neither sum overflows: (2^16 - 1)^2 + 2 (2^16 - 1) < 2^32.
    middle = word_high * bound_low + ((word_low * bound_low) >> 16)
    carry = word_low * bound_high + (middle & 0xFFFF)
    return (word_high * bound_high + (middle >> 16) + (carry >> 16)).astype(jnp.int32)
