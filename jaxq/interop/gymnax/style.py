"""Our environments with gymnax's calls."""

from __future__ import annotations

import functools
from typing import Any, Literal

import jax
import jax.numpy as jnp

from jaxq.envs import auto_reset, registered
from jaxq.interop.gymnax import spaces
from jaxq.suggest import nearest
from jaxq.types import Array, Env, Key, PyTree
from jaxq.worlds import WORLDS


class GymnaxStyle:
    """An environment by name with gymnax's calls; ``params`` is its record of numbers, which may be traced and batched.

    ``reset(key, params) -> obs, state``. ``step(key, state, action, params)`` resets where an episode ended and returns
    ``obs, state, reward, terminated, truncated, info``, gymnax 1.0's six values, or with ``values=5`` the
    ``obs, state, reward, done, info`` of those before; ``info`` has "terminated", "truncated", "discount" (0 after a
    termination alone) and "final_observation", the true successor. ``reset_env`` and ``step_env`` do not reset;
    ``step_env`` returns five values, of which the fourth is terminated, or with ``values=5`` done. ``default_params``
    has gymnax's ``replace`` and its name ``max_steps_in_episode`` for the time limit; states are ours, and their time
    is ``state.t``. Options are those of the environment's factory. Raises ValueError for an unknown name and other
    ``values``, TypeError for an unknown option.

    >>> env = GymnaxStyle("CartPole-v1")
    >>> obs, state = env.reset(jax.random.key(0), env.default_params.replace(length=0.25))
    >>> obs.shape
    (4,)
    """

    def __init__(self, name: str, *, values: Literal[5, 6] = 6, **options: Any) -> None:
        self._factory, self._params = registered(name)
        if values not in (5, 6):
            raise ValueError(f"values: {values!r} is not allowed: 5 or 6")
        known = self._factory.__kwdefaults__ or {}
        for option in options:
            if option not in known:
                raise TypeError(f"{name}: no option {option!r}{nearest(option, known)}")
        self.name, self._values, self._options = name, values, options
        self._reset, self._step = jax.jit(self.reset_env), jax.jit(self._step_and_reset)

    @property
    def default_params(self) -> Any:
        """The record of the environment's numbers with their defaults."""
        return _with_gymnaxs_names(self._params)()

    @property
    def num_actions(self) -> int:
        """How many actions there are."""
        return self._env(None).num_actions

    def action_space(self, params: Any = None) -> Any:
        """The space of actions."""
        return spaces.discrete(self.num_actions)

    def observation_space(self, params: Any = None) -> Any:
        """The space of observations, with the bounds of Gymnasium's."""
        env = self._env(params)
        if env.num_states is not None:
            return spaces.discrete(env.num_states)
        seen = jax.eval_shape(lambda: env.observe(env.reset(jax.random.key(0))))
        bounds = WORLDS[self.name].observed(self._params() if params is None else params)
        low, high = jnp.array(bounds or [(-jnp.inf, jnp.inf)] * seen.shape[0], seen.dtype).T
        return spaces.box(low, high, seen.shape, seen.dtype)

    def reset(self, key: Key, params: Any = None) -> tuple[Any, PyTree]:
        """The first observation of an episode, and its state."""
        return self._reset(key, params)  # type: ignore[no-any-return]

    def step(self, key: Key, state: PyTree, action: Array, params: Any = None) -> tuple[Any, ...]:
        """What comes of an action; where the episode ended, observation and state are those of the next one."""
        return self._step(key, state, action, params)  # type: ignore[no-any-return]

    def reset_env(self, key: Key, params: Any = None) -> tuple[Any, PyTree]:
        """The first observation of an episode, and its state."""
        env = self._env(params)
        state = env.reset(key)
        return env.observe(state), state

    def step_env(self, key: Key, state: PyTree, action: Array, params: Any = None) -> tuple[Any, ...]:
        """What comes of an action, without a reset."""
        after, happened = self._env(params).step(key, state, action)
        over = happened.terminated if self._values == 6 else happened.terminated | happened.truncated
        return happened.obs, after, happened.reward, over, _info(happened)

    def get_obs(self, state: PyTree, params: Any = None, key: Any = None) -> Any:
        """The observation of a state."""
        return self._env(params).observe(state)

    def is_truncated(self, state: PyTree, params: Any = None) -> Array:
        """Whether a state's episode has reached its time limit."""
        limit = (self._params() if params is None else params).max_episode_steps
        return jnp.asarray(state.t >= jnp.asarray(limit))

    def _step_and_reset(self, key: Key, state: PyTree, action: Array, params: Any) -> tuple[Any, ...]:
        env = auto_reset(self._env(params))
        after, happened = env.step(key, state, action)
        info = {**_info(happened), "final_observation": happened.obs}
        if self._values == 6:
            return env.observe(after), after, happened.reward, happened.terminated, happened.truncated, info
        return env.observe(after), after, happened.reward, happened.terminated | happened.truncated, info

    def _env(self, params: Any) -> Env:
        return self._factory(self._params() if params is None else params, **self._options)  # type: ignore[no-any-return]


def _info(happened: Any) -> dict[str, Array]:
    return {
        "terminated": happened.terminated,
        "truncated": happened.truncated,
        "discount": 1.0 - happened.terminated.astype(jnp.float32),
    }


@functools.cache
def _with_gymnaxs_names(kind: Any) -> Any:
    """The record of numbers, with what gymnax's has."""

    class Params(kind):  # type: ignore[misc]
        __slots__ = ()

        @property
        def max_steps_in_episode(self) -> Any:
            return self.max_episode_steps

        def replace(self, **changes: Any) -> Any:
            """The record with other numbers; raises for an unknown one, as ``_replace`` does."""
            if "max_steps_in_episode" in changes:
                changes["max_episode_steps"] = changes.pop("max_steps_in_episode")
            return self._replace(**changes)

    Params.__name__ = Params.__qualname__ = kind.__name__
    return Params
