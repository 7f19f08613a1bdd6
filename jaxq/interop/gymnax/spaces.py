"""The spaces that a loop written for gymnax asks for. Where gymnax is imported they are its own, which its wrappers
insist on."""

from __future__ import annotations

import sys
from typing import Any

import jax
import jax.numpy as jnp

from jaxq.types import Array, Key


class Discrete:
    """The integers 0 .. n - 1."""

    def __init__(self, n: int) -> None:
        self.n, self.shape, self.dtype = n, (), jnp.int32

    def sample(self, key: Key) -> Array:
        """One of them, each as likely: []. The key is consumed."""
        return jax.random.randint(key, (), 0, self.n, self.dtype)

    def contains(self, x: Any) -> Array:
        """Whether x is one of them: []."""
        return (jnp.asarray(x) >= 0) & (jnp.asarray(x) < self.n)


class Box:
    """Arrays of one shape between ``low`` and ``high``, arrays of that shape."""

    def __init__(self, low: Any, high: Any, shape: tuple[int, ...], dtype: Any = jnp.float32) -> None:
        self.low, self.high, self.shape, self.dtype = low, high, shape, dtype

    def sample(self, key: Key) -> Array:
        """One of them, uniformly; not a number where a bound is infinite, as gymnax has it. The key is consumed."""
        return jax.random.uniform(key, self.shape, self.dtype, self.low, self.high)

    def contains(self, x: Any) -> Array:
        """Whether x is one of them: []."""
        return jnp.all((x >= self.low) & (x <= self.high))


def discrete(n: int) -> Any:
    """The space of so many actions, or states."""
    theirs = sys.modules.get("gymnax.environments.spaces")
    return Discrete(n) if theirs is None else theirs.Discrete(n)


def box(low: Any, high: Any, shape: tuple[int, ...], dtype: Any) -> Any:
    """The space of observations between bounds."""
    theirs = sys.modules.get("gymnax.environments.spaces")
    return (Box if theirs is None else theirs.Box)(low, high, shape, dtype)
