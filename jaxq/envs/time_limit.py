"""Time limit: an episode is cut after so many steps."""

from __future__ import annotations

from dataclasses import replace
from typing import Any, NamedTuple

import jax.numpy as jnp

from jaxq.envs.auto_reset import check_ends, starts
from jaxq.envs.mdp import check_steps
from jaxq.types import Array, ArrayLike, Env, Key, Step


class LimitedState(NamedTuple):
    """The state of what is wrapped, and the steps taken in this episode, [] int32."""

    env: Any
    t: Array


def time_limit(env: Env, max_episode_steps: ArrayLike) -> Env:
    """``env`` with episodes truncated after ``max_episode_steps``, which may be traced; an inner limit stays.

    truncated_t = inner truncated_t | (t >= max_episode_steps). Where the limit's step terminates both flags are true,
    and it is a termination. Raises ValueError for what is no whole number from 1 on. Pardo et al., *Time Limits in
    Reinforcement Learning*, 2018.

    >>> from jaxq.envs.probes import truncation
    >>> time_limit(truncation(), 2).num_actions
    1
    """
    check_ends(env, "time_limit")
    check_steps(max_episode_steps)

    def step(key: Key, state: LimitedState, action: Array) -> tuple[LimitedState, Step]:
        inner, happened = env.step(key, state.env, action)
        after = LimitedState(inner, state.t + 1)
        return after, happened._replace(truncated=happened.truncated | (after.t >= jnp.asarray(max_episode_steps)))

    return replace(
        env,
        **starts(env, lambda inner: LimitedState(inner, jnp.zeros((), jnp.int32))),
        step=step,
        observe=lambda state: env.observe(state.env),
    )
