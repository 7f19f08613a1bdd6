"""Any Gymnasium environment with discrete actions, as our learners see it."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from functools import lru_cache
from typing import Any, NamedTuple, NoReturn, TypeAlias

import gymnasium
import numpy as np
from gymnasium import spaces
from gymnasium.vector import AutoresetMode, SyncVectorEnv, VectorEnv
from gymnasium.wrappers import TimeLimit
from pydantic import create_model

from jaxq.settings import NO_LIMIT
from jaxq.types import Array, Env, Key
from jaxq.worlds import World

#: Greedy evaluations are cut here where no time limit of the environment's is known.
EVAL_STEPS = 1000

Source: TypeAlias = str | Callable[[], gymnasium.Env] | VectorEnv


class Foreign(NamedTuple):
    """Gymnasium's environments, and what our learners must know of them."""

    envs: VectorEnv
    world: World
    observe: Callable[[Any], np.ndarray]  # observations [N, ...] as float32 [N, features], or int32 [N] from 0
    first_state: int  # Gymnasium's name of our state 0, where observations are integers
    first_action: int  # and of our action 0


def foreign(source: Source, num_envs: int, bounds: Sequence[tuple[float, float]] | None = None) -> Foreign:
    """Environments of an id or of a function, ``num_envs`` of them that reset in the step in which an episode ends; a
    ``VectorEnv`` as it is.

    Raises ValueError for an unknown id, for actions that are not discrete, for observations that are neither discrete
    nor an array, and for ``bounds`` that do not fit them.
    """
    envs = source if isinstance(source, VectorEnv) else _vector(source, num_envs)
    try:
        return Foreign(envs, *_seen(envs, bounds))
    except ValueError:
        if envs is not source:
            envs.close()
        raise


def _vector(source: str | Callable[[], gymnasium.Env], num_envs: int) -> VectorEnv:
    if isinstance(source, str):
        make: Callable[[], gymnasium.Env] = lambda: gymnasium.make(source)  # noqa: E731
    elif callable(source) and not isinstance(source, gymnasium.Env):
        make = source
    else:
        what = "a single environment" if isinstance(source, gymnasium.Env) else repr(source)
        raise ValueError(f"env: {what} is not allowed: an id, a function that makes an environment, or a VectorEnv")
    try:
        envs = SyncVectorEnv([make] * num_envs, autoreset_mode=AutoresetMode.SAME_STEP)
    except gymnasium.error.Error as error:
        raise ValueError(f"env: {error}") from None
    check_apart(envs)
    return envs


def check_apart(*vectors: VectorEnv) -> None:
    """Raises ValueError where two environments are the same object, which would step both."""
    bare = [env.unwrapped for vector in vectors for env in getattr(vector.unwrapped, "envs", ())]
    if len({id(env) for env in bare}) < len(bare):
        raise ValueError("env: a function that gives the same environment twice is not allowed: a new one each time")


class _About(NamedTuple):
    """What environments say of themselves; a name, and None for what they do not."""

    name: str
    threshold: float | None
    limit: int | None


def _about(envs: VectorEnv) -> _About:
    bare: Any = envs.unwrapped
    first: Any = getattr(bare, "envs", [None])[0]
    spec = envs.spec or bare.spec or getattr(first, "spec", None)
    ours = getattr(bare, "world", None)  # of a vector environment of ours that was not made by name
    name = type(bare if first is None else first.unwrapped).__name__ if spec is None else spec.id.rsplit("/", 1)[-1]
    threshold = None if spec is None else spec.reward_threshold
    limit = None if spec is None else spec.max_episode_steps
    if isinstance(ours, World):
        own = ours.flat().get("max_episode_steps", NO_LIMIT)
        name, threshold, limit = ours.id, ours.reward_threshold, limit or (None if own == NO_LIMIT else own)
    while limit is None and isinstance(first, gymnasium.Wrapper):
        limit = first._max_episode_steps if isinstance(first, TimeLimit) else None
        first = first.env
    return _About(name, threshold, limit)


def _seen(
    envs: VectorEnv, bounds: Sequence[tuple[float, float]] | None
) -> tuple[World, Callable[[Any], np.ndarray], int, int]:
    about = _about(envs)
    name, first = about.name, 0
    num_states: int | None = None
    shape: tuple[int, ...] = ()
    limits = None
    actions, observations = envs.single_action_space, envs.single_observation_space
    if not isinstance(actions, spaces.Discrete):
        hint = ": put gymnasium.wrappers.DiscretizeAction around it" if isinstance(actions, spaces.Box) else ""
        raise ValueError(f"env: the actions of {name} are {actions}, which are not Discrete{hint}")
    if isinstance(observations, spaces.Discrete):
        num_states, first = int(observations.n), int(observations.start)
        if bounds is not None:
            raise ValueError(f"bounds: not allowed: the observations of {name} are {observations}")

        def observe(obs: Any) -> np.ndarray:
            return np.asarray(obs).astype(np.int32) - np.int32(first)
    elif isinstance(observations, spaces.Box):
        shape = (int(np.prod(observations.shape)),)
        if shape == (0,):
            raise ValueError(f"env: the observations of {name} are {observations}, which are empty")
        limits = _limits(name, observations, bounds)

        def observe(obs: Any) -> np.ndarray:
            return np.asarray(obs, np.float32).reshape(len(obs), -1)
    else:
        flat = observations.is_np_flattenable
        hint = ": put gymnasium.wrappers.FlattenObservation around it" if flat else ""
        raise ValueError(f"env: the observations of {name} are {observations}, neither Box nor Discrete{hint}")
    steps = EVAL_STEPS if about.limit is None else World.eval_steps
    world = _world(name, int(actions.n), shape, num_states, limits, about.threshold, steps)
    return world, observe, first, int(actions.start)


@lru_cache(maxsize=64)  # equal environments are one world, so that what is compiled for it is found again
def _world(
    name: str,
    num_actions: int,
    shape: tuple[int, ...],
    num_states: int | None,
    limits: tuple[tuple[float, float], ...] | None,
    threshold: float | None,
    eval_steps: int,
) -> World:
    env = _shell(name, num_actions, shape, num_states)
    kind: Any = create_model("Foreign", __base__=World)
    kind.id, kind.factory = name, staticmethod(lambda: env)
    kind.reward_threshold, kind.bounds, kind.eval_steps = threshold, limits, eval_steps
    # A class made here is found by nobody who unpickles its settings, unless they make it again.
    kind.__reduce__ = lambda self: (_world, (name, num_actions, shape, num_states, limits, threshold, eval_steps))
    return kind()  # type: ignore[no-any-return]


def _limits(
    name: str, space: spaces.Box, bounds: Sequence[tuple[float, float]] | None
) -> tuple[tuple[float, float], ...] | None:
    """Between what a table divides each coordinate; None where nobody has said."""
    if bounds is None:
        low, high = space.low.ravel().tolist(), space.high.ravel().tolist()
        return tuple(zip(low, high, strict=True)) if np.isfinite(low + high).all() else None
    wanted = int(np.prod(space.shape))
    if np.ndim(bounds) != 2 or np.shape(bounds)[1] != 2:
        raise ValueError(f"bounds: {bounds!r} is not allowed: a pair, low and high, for each coordinate")
    if len(bounds) != wanted:
        raise ValueError(f"bounds: {len(bounds)} pairs are not allowed: {name} has {wanted} coordinates")
    for low, high in bounds:
        if not (math.isfinite(low) and math.isfinite(high) and low < high):
            raise ValueError(f"bounds: ({low}, {high}) is not allowed: finite numbers, the low one first")
    return tuple((float(low), float(high)) for low, high in bounds)


def _shell(name: str, num_actions: int, shape: tuple[int, ...], num_states: int | None) -> Env:
    """An Env whose states are its observations, for learners that ask how many there are; nobody steps it."""

    def nobody(*arguments: Any) -> NoReturn:
        raise TypeError(f"{name} is stepped by Gymnasium")

    def reset(key: Key) -> Any:
        nobody(key)

    def step(key: Key, state: Any, action: Array) -> Any:
        nobody(key, state, action)

    return Env(reset, step, lambda state: state, num_actions, shape, num_states)
