"""Sticky actions: now and then the environment repeats the last action instead of the one it is given."""

from __future__ import annotations

from dataclasses import replace
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from jaxq.envs.auto_reset import check_ends, starts
from jaxq.envs.mdp import known
from jaxq.types import Array, ArrayLike, Env, Key, Step

#: Before the first step of an episode there is no action to repeat.
NO_ACTION = -1


class StickyState(NamedTuple):
    """The state of what is wrapped, and the action that it was last given, [] int32."""

    env: Any
    action: Array


def sticky_actions(env: Env, probability: ArrayLike) -> Env:
    """``env``, given the action of the step before with this probability, in all steps of an episode but the first.

    a'_t = a'_{t-1} with probability p, else a_t. Shapes: probability [], which may be traced. Raises ValueError for a
    known one outside [0, 1]. Machado et al., *Revisiting the Arcade Learning Environment*, 2018, section 5.

    >>> from jaxq.envs.probes import action
    >>> sticky_actions(action(), 0.25).deterministic
    False
    """
    check_ends(env, "sticky_actions")
    if known(probability) and not 0 <= float(np.asarray(probability)) <= 1:
        raise ValueError(f"probability: {probability} is not allowed: from 0 to 1")

    def step(key: Key, state: StickyState, action: Array) -> tuple[StickyState, Step]:
        coin_key, step_key = jax.random.split(key)
        sticks = (jax.random.uniform(coin_key) < probability) & (state.action != NO_ACTION)
        taken = jnp.where(sticks, state.action, jnp.asarray(action, jnp.int32))
        inner, happened = env.step(step_key, state.env, taken)
        return StickyState(inner, taken), happened

    return replace(
        env,
        **starts(env, lambda inner: StickyState(inner, jnp.full((), NO_ACTION, jnp.int32))),
        step=step,
        observe=lambda state: env.observe(state.env),
        deterministic=False,
    )
