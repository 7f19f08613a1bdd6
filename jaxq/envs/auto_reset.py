"""Auto-reset: an episode that ended gives way to a new one within the same step."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import jax
import jax.numpy as jnp

from jaxq.types import Array, Env, Key, Step


def auto_reset(env: Env) -> Env:
    """``env`` with the state after an episode's end replaced by a fresh one.

    The Step keeps the TRUE successor of the action; the state returned beside it, and ``observe`` of it, belong to the
    new episode where ``terminated | truncated``.
    """

    def step(key: Key, state: Any, action: Array) -> tuple[Any, Step]:
        step_key, reset_key = (key, key) if env.deterministic else jax.random.split(key)
        after, happened = env.step(step_key, state, action)
        over = happened.terminated | happened.truncated
        fresh = env.reset(reset_key)
        return jax.tree.map(lambda new, old: jnp.where(over, new, old), fresh, after), happened

    return replace(env, step=step, deterministic=False)
