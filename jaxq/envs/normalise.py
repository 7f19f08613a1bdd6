"""Normalise: observations of mean 0 and variance 1, and rewards on the scale of the discounted return.

The statistics run along in the state and outlive an episode, as in Gymnasium's ``NormalizeObservation`` and
``NormalizeReward``, whose numbers these are. A fresh ``reset`` begins with none, ``restart`` goes on from a state's, as
a sweep's greedy episodes do. To hold them, give them: ``normalise_observation(env, moments=state.moments,
update=False)``. Under ``vmap`` each environment has its own.
"""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from jaxq.envs.auto_reset import check_ends, next_episode
from jaxq.envs.mdp import in_float, known
from jaxq.envs.moments import Moments, no_moments, normalised, seen
from jaxq.types import Array, ArrayLike, Env, Key, Step


class NormalisedState(NamedTuple):
    """The state of what is wrapped, and the moments of its observations."""

    env: Any
    moments: Moments


class RewardState(NamedTuple):
    """The state of what is wrapped, the discounted return so far, and its moments."""

    env: Any
    total: Array
    moments: Moments


def normalise_observation(
    env: Env, *, moments: Moments | None = None, update: bool = True, epsilon: ArrayLike = 1e-8
) -> Env:
    """``env`` whose observations have mean 0 and variance 1 under the moments of all so far, the present one included.

    o' = (o - m) / sqrt(v + epsilon). ``moments`` are those to begin with, and with ``update`` False to stay with.
    Shapes: obs [...] real numbers or integers -> [...] real. Raises ValueError for an epsilon that is not above 0.

    >>> from jaxq.envs.cartpole import cartpole
    >>> normalise_observation(cartpole()).obs_shape
    (4,)
    """
    check_ends(env, "normalise_observation")
    _check_epsilon(epsilon)

    def begun(inner: Any, before: Moments | None) -> NormalisedState:
        obs = in_float(env.observe(inner))
        held = no_moments(obs.shape, obs.dtype) if before is None else _in_floats(before)
        _check_moments(held, obs.shape)
        return NormalisedState(inner, seen(held, obs) if update else held)

    def step(key: Key, state: NormalisedState, action: Array) -> tuple[NormalisedState, Step]:
        inner, happened = env.step(key, state.env, action)
        after = NormalisedState(inner, seen(state.moments, happened.obs) if update else state.moments)
        return after, happened._replace(obs=normalised(after.moments, happened.obs, epsilon))

    return replace(
        env,
        reset=lambda key: begun(env.reset(key), moments),
        step=step,
        observe=lambda state: normalised(state.moments, env.observe(state.env), epsilon),
        num_states=None,
        restart=lambda key, state: begun(next_episode(env, key, state.env), state.moments),
    )


def normalise_reward(
    env: Env, gamma: ArrayLike = 0.99, *, moments: Moments | None = None, update: bool = True, epsilon: ArrayLike = 1e-8
) -> Env:
    """``env`` whose rewards are divided by the standard deviation of the discounted return so far.

    g_t = gamma (1 - terminated_t) g_{t-1} + r_t, r' = r / sqrt(v + epsilon) with v the variance of all g so far. As in
    Gymnasium a truncation does not end the sum, and a termination drops what came before its own reward. Shapes: gamma
    [], which may be traced. Raises ValueError for a known gamma outside [0, 1] and an epsilon that is not above 0.

    >>> from jaxq.envs.cartpole import cartpole
    >>> normalise_reward(cartpole()).obs_shape
    (4,)
    """
    check_ends(env, "normalise_reward")
    _check_epsilon(epsilon)
    if known(gamma) and not 0 <= float(np.asarray(gamma)) <= 1:
        raise ValueError(f"gamma: {gamma} is not allowed: from 0 to 1")

    def reset(key: Key) -> RewardState:
        inner = env.reset(key)
        held = no_moments(dtype=_reward_dtype(env, inner)) if moments is None else _in_floats(moments)
        _check_moments(held, ())
        return RewardState(inner, jnp.zeros((), held.mean.dtype), held)

    def step(key: Key, state: RewardState, action: Array) -> tuple[RewardState, Step]:
        inner, happened = env.step(key, state.env, action)
        kept = state.total * jnp.asarray(gamma, state.total.dtype) * (1 - happened.terminated.astype(state.total.dtype))
        total = kept + happened.reward.astype(state.total.dtype)
        held = seen(state.moments, total) if update else state.moments
        reward = happened.reward / jnp.sqrt(held.variance + epsilon)
        return RewardState(inner, total, held), happened._replace(reward=reward.astype(happened.reward.dtype))

    return replace(
        env,
        reset=reset,
        step=step,
        observe=lambda state: env.observe(state.env),
        restart=lambda key, state: state._replace(env=next_episode(env, key, state.env)),
    )


def _reward_dtype(env: Env, state: Any) -> Any:
    """The dtype of the environment's rewards, found without a step."""
    key = jax.eval_shape(lambda: jax.random.key(0))
    return jax.eval_shape(env.step, key, state, jax.ShapeDtypeStruct((), jnp.int32))[1].reward.dtype


def _in_floats(moments: Moments) -> Moments:
    return Moments(*map(in_float, moments))


def _check_moments(moments: Moments, shape: tuple[int, ...]) -> None:
    for name, leaf, wanted in zip(Moments._fields, moments, (shape, shape, ()), strict=True):
        if np.shape(leaf) != wanted:
            raise ValueError(f"moments: {name} of shape {np.shape(leaf)} is not allowed: {wanted}")


def _check_epsilon(epsilon: ArrayLike) -> None:
    if known(epsilon) and not 0 < float(np.asarray(epsilon)) < math.inf:
        raise ValueError(f"epsilon: {epsilon} is not allowed: a number above 0")
