"""Policies: from action values to an action. Keys come first and are consumed."""

from __future__ import annotations

import jax
import jax.numpy as jnp

from jaxq.types import Array, Key


def greedy(q: Array) -> Array:
    """The action of largest value, the first of equals, as NumPy's argmax.

    a = argmax_a q[a]. Shapes: q [A] -> [] int32.

    >>> int(greedy(jnp.array([0.0, 2.0, 2.0])))
    1
    """
    return jnp.argmax(q).astype(jnp.int32)


def epsilon_greedy(key: Key, q: Array, epsilon: Array) -> Array:
    """With probability epsilon an action drawn uniformly from all, otherwise the greedy one.

    Shapes: q [A], epsilon [] -> [] int32. Sutton and Barto, 2018, section 2.2. One draw of two words: the first
    decides whether to explore, the second which action.
    """
    words = jax.random.bits(key, (2,), jnp.uint32)
    explore = _unit(words[0]) < epsilon
    drawn = jnp.floor(_unit(words[1]) * q.shape[-1]).astype(jnp.int32)
    return jnp.where(explore, drawn, greedy(q))


def boltzmann(key: Key, q: Array, temperature: Array) -> Array:
    """An action drawn in proportion to exp(q / temperature).

    P(a) = exp(q[a] / temperature) / sum_b exp(q[b] / temperature). Shapes: q [A], temperature [] -> [] int32.
    Sutton and Barto, 2018, section 2.8.
    """
    return jax.random.categorical(key, q / temperature).astype(jnp.int32)


def _unit(word: Array) -> Array:
    """A uint32 word as a float32 in [0, 1): its 24 high bits, each value equally likely."""
    return (word >> 8).astype(jnp.int32).astype(jnp.float32) * jnp.float32(2**-24)
