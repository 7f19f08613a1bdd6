"""One-hot: the index of a state becomes the vector that a network takes."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import jax.numpy as jnp

from jaxq.types import Array, Env, Key, Step


def one_hot(env: Env) -> Env:
    """``env`` with integer observations replaced by vectors of 0 and 1: o[k] = 1(k = obs).

    Shapes: obs [] int32 -> [num_states] float32. A linear network of one layer is then a table. Raises ValueError where
    ``env`` has no ``num_states``.

    >>> from jaxq.envs.probes import discounting
    >>> one_hot(discounting()).obs_shape
    (2,)
    """
    count = env.num_states
    if count is None:
        raise ValueError(f"env: num_states is None, but one_hot needs integer observations, not shape {env.obs_shape}")

    def vector(obs: Array) -> Array:
        return (jnp.arange(count) == obs).astype(jnp.float32)

    def step(key: Key, state: Any, action: Array) -> tuple[Any, Step]:
        state, happened = env.step(key, state, action)
        return state, happened._replace(obs=vector(happened.obs))

    def observe(state: Any) -> Array:
        return vector(env.observe(state))

    return replace(env, step=step, observe=observe, obs_shape=(count,), num_states=None)
