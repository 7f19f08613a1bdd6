"""Scale reward: rewards on another scale."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import jax.numpy as jnp
import numpy as np

from jaxq.envs.mdp import known
from jaxq.types import Array, ArrayLike, Env, Key, Step


def scale_reward(env: Env, scale: ArrayLike, *, shift: ArrayLike = 0.0) -> Env:
    """``env`` with the reward r' = scale r + shift.

    Shapes: scale and shift [], which may be traced. Raises ValueError for known ones that are not finite.

    >>> from jaxq.envs.probes import value_only
    >>> scale_reward(value_only(), 0.1).num_actions
    1
    """
    for name, value in (("scale", scale), ("shift", shift)):
        if known(value) and not np.isfinite(np.asarray(value)):
            raise ValueError(f"{name}: {value} is not allowed: a finite number")

    def step(key: Key, state: Any, action: Array) -> tuple[Any, Step]:
        state, happened = env.step(key, state, action)
        scaled = jnp.asarray(scale) * happened.reward + jnp.asarray(shift)
        return state, happened._replace(reward=scaled.astype(happened.reward.dtype))

    return replace(env, step=step)
