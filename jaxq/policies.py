"""Policies: from action values to an action. Keys come first and are consumed."""

from __future__ import annotations

import jax
import jax.numpy as jnp
import numpy as np

from jaxq.types import Array, Key

#: Up to this many actions are compared one by one, which XLA fuses with what is before and after; the reduction that
#: ``argmax`` becomes is a loop of its own.
FEW_ACTIONS = 8


def greedy(q: Array) -> Array:
    """The action of largest value, the first of equals, as NumPy's argmax.

    a = argmax_a q[a]. Shapes: q [A] -> [] int32.

    >>> int(greedy(jnp.array([0.0, 2.0, 2.0])))
    1
    """
    if q.shape[-1] > FEW_ACTIONS:
        return jnp.argmax(q).astype(jnp.int32)
    best, action = q[0], jnp.zeros((), jnp.int32)
    for a in range(1, q.shape[-1]):
        better = (q[a] > best) | (jnp.isnan(q[a]) & ~jnp.isnan(best))  # the first NaN is NumPy's largest
        best, action = jnp.where(better, q[a], best), jnp.where(better, a, action)
    return action


def epsilon_greedy(key: Key, q: Array, epsilon: Array) -> Array:
    """With probability epsilon an action drawn uniformly from all, otherwise the greedy one.

    Shapes: q [A], epsilon [] -> [] int32. Sutton and Barto, 2018, section 2.2. One draw of two words: the first
    decides whether to explore, the second which action. Raises ValueError for more than 2^16 actions.
    """
    words = jax.random.bits(key, (2,), jnp.uint32)
    explore = _unit(words[0]) < epsilon
    return jnp.where(explore, _below(words[1], q.shape[-1]), greedy(q))


def epsilon_greedy_probs(q: Array, epsilon: Array) -> Array:
    """The probabilities with which ``epsilon_greedy`` takes each action.

    P(a) = epsilon / A + (1 - epsilon) 1(a = greedy(q)). Shapes: q [A], epsilon [] -> [A]. Sutton and Barto, 2018,
    section 2.2.

    >>> epsilon_greedy_probs(jnp.array([0.0, 2.0]), jnp.array(0.5)).tolist()
    [0.25, 0.75]
    """
    actions = q.shape[-1]
    return epsilon / actions + (1 - epsilon) * (jnp.arange(actions) == greedy(q))


def boltzmann(key: Key, q: Array, temperature: Array) -> Array:
    """An action drawn in proportion to exp(q / temperature).

    P(a) = exp(q[a] / temperature) / sum_b exp(q[b] / temperature). Shapes: q [A], temperature [] -> [] int32.
    Sutton and Barto, 2018, section 2.8.
    """
    return jax.random.categorical(key, q / temperature).astype(jnp.int32)


def _below(word: Array, count: int) -> Array:
    """A uint32 word as an integer in 0 .. count - 1: floor(word count / 2^32), exactly. Shapes: [...] -> [...] int32.

    In integers of 32 bits, by the word's halves. Raises ValueError for more than 2^16 choices.
    """
    if count > 2**16:
        raise ValueError(f"num_actions: {count} must be at most {2**16}")
    low, high = word & np.uint32(0xFFFF), word >> np.uint32(16)
    factor = np.uint32(count)
    return ((high * factor + ((low * factor) >> np.uint32(16))) >> np.uint32(16)).astype(jnp.int32)


def _unit(word: Array) -> Array:
    """A uint32 word as a float32 in [0, 1): its 24 high bits, each value equally likely."""
    return (word >> 8).astype(jnp.int32).astype(jnp.float32) * jnp.float32(2**-24)
