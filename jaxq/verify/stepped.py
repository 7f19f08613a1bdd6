"""A step from each of many states, here and in Gymnasium."""

from __future__ import annotations

import contextlib
from contextlib import AbstractContextManager
from typing import Any, NamedTuple

import gymnasium
import jax
import jax.numpy as jnp
import numpy as np

from jaxq import envs
from jaxq.interop.gymnasium import reference
from jaxq.worlds import World

SEED = 0


class Stepped(NamedTuple):
    """What came of n steps, each from its own state."""

    after: np.ndarray  # [n, D]
    obs: np.ndarray  # [n, O]
    reward: np.ndarray  # [n]
    terminated: np.ndarray  # [n]


def precision(dtype: str) -> AbstractContextManager[Any]:
    """Where arrays of the dtype can be made."""
    return jax.enable_x64(True) if dtype == "float64" else contextlib.nullcontext()


def ours(world: World, dtype: str, states: np.ndarray, actions: np.ndarray) -> Stepped:
    """Shapes: states [n, D], actions [n]."""
    with precision(dtype):
        env = envs.make(world.id, dtype=dtype, **world.flat())
        key = jax.random.key(SEED)
        kind = type(jax.eval_shape(env.reset, key))
        columns = jnp.asarray(states, dtype).T
        placed = kind(*columns, jnp.zeros(len(states), jnp.int32))
        step = jax.jit(jax.vmap(env.step, in_axes=(None, 0, 0)))
        after, happened = step(key, placed, jnp.asarray(actions, jnp.int32))
        rows = np.stack([np.asarray(leaf, float) for leaf in after[:-1]], -1)
        obs, reward = np.asarray(happened.obs, float), np.asarray(happened.reward, float)
        return Stepped(rows, obs, reward, np.asarray(happened.terminated))


def theirs(env: gymnasium.Env, world: World, states: np.ndarray, actions: np.ndarray) -> Stepped:
    """In Gymnasium's environment, which was reset before. Shapes: states [n, D], actions [n]."""
    bare: Any = env.unwrapped
    rows = []
    for state, action in zip(states, actions.tolist(), strict=True):
        if hasattr(bare, "func_env"):  # of those that are functions of a state
            bare.state = np.array(state)
        else:
            reference.place(bare, world, (*state, 0))
        obs, reward, terminated, _, _ = bare.step(reference.action(world, action))
        rows.append((np.array(bare.state, float), np.array(obs, float), float(reward), bool(terminated)))
    return Stepped(*(np.array(column) for column in zip(*rows, strict=True)))
