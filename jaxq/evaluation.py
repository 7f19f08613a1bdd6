"""Evaluation: whole episodes under a greedy policy."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp

from jaxq import policies
from jaxq.types import Array, Env, Key


def greedy_returns(key: Key, env: Env, q_values: Callable[[Any], Array], episodes: int, max_steps: int) -> Array:
    """Returns of whole episodes under the greedy policy, each from its own reset and at most ``max_steps`` long.

    Shapes: -> [episodes] float32. The start states depend on the key alone, so settings that share a key are compared
    on the same ones.
    """

    def one(key: Key) -> Array:
        reset_key, step_key = jax.random.split(key)

        def goes_on(carry: tuple[Any, Array, Array, Array]) -> Array:
            return (carry[2] > 0) & (carry[3] < max_steps)

        def body(carry: tuple[Any, Array, Array, Array]) -> tuple[Any, Array, Array, Array]:
            state, total, going, t = carry
            action = policies.greedy(q_values(env.observe(state)))
            state, happened = env.step(jax.random.fold_in(step_key, t), state, action)
            total = total + happened.reward.astype(jnp.float32)
            return state, total, going * ~(happened.terminated | happened.truncated), t + 1

        start = (env.reset(reset_key), jnp.zeros((), jnp.float32), jnp.ones((), jnp.float32), jnp.zeros((), jnp.int32))
        return jax.lax.while_loop(goes_on, body, start)[1]

    return jax.vmap(one)(jax.random.split(key, episodes))
