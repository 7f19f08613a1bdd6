"""Discretise: real observations become the index of a bucket.

A bucket index along one coordinate is a step function, so a discretiser is a row of *edges* per coordinate: the bucket
is the number of edges that the value has reached. ``tutorial_edges`` finds the edges of the tutorial's formula exactly,
by bisection over the float32 numbers themselves, so that every observation falls into the very bucket that the
formula's own float32 operations give it; computed in the loop, the formula would depend on whether the compiler fuses
the multiplication with the subtraction.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import jax.numpy as jnp
import numpy as np

from jaxq.envs.mdp import known
from jaxq.types import Array, Env, Key, Step

Bound = float | np.float32


def discretise(env: Env, edges: Sequence[Array]) -> Env:
    """``env`` with observations replaced by one integer, the flat index (C order) of the bucket.

    ``edges[i]`` are the ascending edges of coordinate i, shape [buckets_i - 1], which may be traced:
    bucket_i = sum_k (obs[i] >= edges[i][k]). Infinities fall into the outer buckets; NaN, which reaches no edge, falls
    into bucket 0. Raises ValueError when the number of rows is not the number of coordinates, for rows that are not
    ascending numbers, where they are known, and for more buckets than an int32 can name.
    """
    for i, row in enumerate(edges):
        if np.ndim(row) != 1 or (known(row) and not _ascends(np.asarray(row))):
            raise ValueError(f"edges: {row!r} in row {i} is not allowed: ascending numbers")
    counts = [np.shape(row)[0] + 1 for row in edges]
    if math.prod(counts) > np.iinfo(np.int32).max:
        raise ValueError(f"edges: {math.prod(counts)} buckets are too many: at most {np.iinfo(np.int32).max}")
    if env.obs_shape != (len(counts),):
        raise ValueError(f"edges: {len(counts)} rows, but an observation has shape {env.obs_shape}")

    def index(obs: Array) -> Array:
        flat = jnp.zeros((), jnp.int32)
        for i, count in enumerate(counts):
            flat = flat * count
            for k in range(count - 1):
                flat = flat + (obs[i] >= edges[i][k]).astype(jnp.int32)
        return flat

    def step(key: Key, state: Any, action: Array) -> tuple[Any, Step]:
        state, happened = env.step(key, state, action)
        return state, happened._replace(obs=index(happened.obs))

    def observe(state: Any) -> Array:
        return index(env.observe(state))

    return replace(env, step=step, observe=observe, obs_shape=(), num_states=int(np.prod(counts)))


def _ascends(row: np.ndarray) -> bool:
    return bool(np.all(row[1:] >= row[:-1]) and not np.any(np.isnan(row)))


def tutorial_bucket(value: np.ndarray, low: Bound, high: Bound, count: int) -> np.ndarray:
    """The tutorial's bucket of float32 values: clamped ends, half-to-even rounding on a linear scale inside.

    b = 0 if s <= low; count - 1 if s >= high; else round((count - 1) / w * s - (count - 1) low / w) with
    w = high - low. Shapes: value [...] float32 -> [...]. Scale and offset are computed in float32 where the bounds are
    ``np.float32`` and as Python floats otherwise, the rest in float32, as NumPy does it for a float32 observation.
    """
    value = np.asarray(value, np.float32)
    low, high = (bound if isinstance(bound, np.float32) else float(bound) for bound in (low, high))
    width = high - low
    scale, offset = np.float32((count - 1) / width), np.float32((count - 1) * low / width)
    inside = np.rint(scale * value - offset)
    return np.where(value <= np.float32(low), 0, np.where(value >= np.float32(high), count - 1, inside)).astype(int)


def tutorial_edges(low: Sequence[Bound], high: Sequence[Bound], num_buckets: Sequence[int]) -> tuple[np.ndarray, ...]:
    """The edges of ``tutorial_bucket``: per coordinate the smallest float32 that reaches each bucket but the first.

    Shapes: low, high, num_buckets [D] -> D rows [buckets_i - 1] float32. Raises ValueError unless every count is at
    least 1, every low is below its high as float32, both are within 2^100 of 0 and more than 2^-100 apart.
    """
    rows = []
    for i, (lo, hi, count) in enumerate(zip(low, high, num_buckets, strict=True)):
        if count < 1:
            raise ValueError(f"num_buckets[{i}]: {count} must be at least 1")
        scalable = lo > -(2.0**100) and hi < 2.0**100 and hi - lo > 2.0**-100
        if not (scalable and np.float32(lo) < np.float32(hi)):
            raise ValueError(f"bounds[{i}]: low {lo} must be below high {hi}, both of a size that float32 can scale")
        rows.append(_bisect(lo, hi, count))
    return tuple(rows)


def _bisect(low: Bound, high: Bound, count: int) -> np.ndarray:
    """Smallest float32 in [low, high] of each bucket 1 .. count-1; the formula never falls as the value grows."""
    wanted = np.arange(1, count)
    below = np.full(count - 1, _ordinal(np.float32(low)), np.int64)
    reached = np.full(count - 1, _ordinal(np.float32(high)), np.int64)
    while np.any(reached - below > 1):
        middle = (below + reached) // 2
        enough = tutorial_bucket(_from_ordinal(middle), low, high, count) >= wanted
        reached, below = np.where(enough, middle, reached), np.where(enough, below, middle)
    return _from_ordinal(reached)


def _ordinal(value: np.ndarray | np.float32) -> np.ndarray:
    """float32 to an integer in the same order, neighbours one apart; both zeros are 0."""
    bits = np.asarray(value, np.float32).view(np.int32).astype(np.int64)
    return np.where(bits < 0, -(bits & 0x7FFFFFFF), bits)


def _from_ordinal(ordinal: np.ndarray) -> np.ndarray:
    bits = np.where(ordinal < 0, (-ordinal) | 0x80000000, ordinal)
    return bits.astype(np.uint32).view(np.float32)
