"""gymnax's environments as ours."""

from __future__ import annotations

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp

from jaxq.interop.dtypes import as_arrays, like
from jaxq.types import Array, Env, Key, PyTree, Step


class GymnaxState(NamedTuple):
    """gymnax's state, and the observation that came with it."""

    state: PyTree
    obs: Array


def from_gymnax(env: Any, params: Any = None) -> Env:
    """An environment with gymnax's calls as one of ours, its actions discrete: ``from_gymnax(*gymnax.make(name))``.

    It is stepped without gymnax's auto-reset, so the true successor is kept. gymnax 1.0 tells a time limit from an end.
    Before it both were one flag: there an episode is truncated where ``state.time`` has reached
    ``params.max_steps_in_episode``, and terminated where it would be over at time 0 as well; without these fields all
    ends are terminations. Raises TypeError for what is no bare environment, since gymnax's wrappers let through the
    calls of what they wrap, and ValueError for one whose actions are not discrete.
    """
    if not (hasattr(type(env), "step_env") and hasattr(type(env), "reset_env")):
        raise TypeError(
            f"env: {type(env).__name__} is not allowed: a bare gymnax environment; wrap with jaxq.envs instead"
        )
    given = env.default_params if params is None else params
    count = getattr(env, "num_actions", None)
    space = env.action_space(given) if hasattr(env, "action_space") else None
    if not isinstance(count, int) or (space is not None and getattr(space, "n", None) is None):
        raise ValueError(f"env: {getattr(env, 'name', env)!s} is not allowed: its actions must be discrete")

    def reset(key: Key) -> GymnaxState:
        obs, state = env.reset_env(key, given)
        return GymnaxState(as_arrays(state), jnp.asarray(obs))

    def step(key: Key, state: GymnaxState, action: Array) -> tuple[GymnaxState, Step]:
        obs, stepped, reward, over, info = env.step_env(key, state.state, action, given)
        after = GymnaxState(like(stepped, state.state), jnp.asarray(obs, state.obs.dtype))
        terminated, truncated = _ends(env, given, after.state, jnp.asarray(over, bool), info)
        return after, Step(after.obs, jnp.asarray(reward, jnp.float32), terminated, truncated)

    seen = jax.eval_shape(lambda: reset(jax.random.key(0)).obs)
    whole = seen.shape == () and jnp.issubdtype(seen.dtype, jnp.integer) and hasattr(env, "observation_space")
    num_states = getattr(env.observation_space(given), "n", None) if whole else None
    return Env(reset, step, lambda state: state.obs, num_actions=count, obs_shape=seen.shape, num_states=num_states)


def _ends(env: Any, params: Any, state: Any, over: Array, info: Any) -> tuple[Array, Array]:
    """Terminated and truncated."""
    if {"terminated", "truncated"} <= set(info):
        return jnp.asarray(info["terminated"], bool), jnp.asarray(info["truncated"], bool)
    if hasattr(env, "is_truncated"):
        return over, jnp.asarray(env.is_truncated(state, params), bool)
    limit = getattr(params, "max_steps_in_episode", None)
    if limit is None or not hasattr(state, "time") or not hasattr(state, "replace"):
        return over, jnp.zeros((), bool)
    late = state.time >= limit
    natural = jnp.asarray(env.is_terminal(state.replace(time=jnp.zeros_like(state.time)), params), bool)
    return over & (natural | ~late), late
