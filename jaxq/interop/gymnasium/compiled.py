"""A world's reset and step, compiled once for all its numbers.

An environment draws two words from Gymnasium's generator when it is seeded; the keys of its episodes, and of each step,
are folds of them. So an environment alone and one of many with the same seed live through the same episodes, and many
of them begin anew without a loop in Python.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Hashable
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from jaxq import prng, programs
from jaxq.envs import time_limit
from jaxq.settings import NO_LIMIT
from jaxq.types import Array, Env
from jaxq.worlds import World


class Numbers(NamedTuple):
    """A world's numbers in two arrays, which are brought to JAX once: a call with many small ones is slow."""

    real: Array  # [R] float32
    whole: Array  # [W] int32


class Compiled(NamedTuple):
    """Functions of one environment, or of N at once; ``of`` [2] uint32 are the words of its seed, and ``episode`` which
    one since then it is.

    ``begin(of, episode, numbers) -> (state, obs)``.
    ``step(of, episode, state, action, numbers) -> (state, obs, told)``; told [3] float32 is the reward, terminated and
    truncated.
    ``renew(over, of, episode, state, obs, numbers) -> (episode, state, obs)`` begins the next episode where ``over``.
    """

    begin: Callable[..., Any]
    step: Callable[..., Any]
    renew: Callable[..., Any]


def made(world: World) -> Env:
    """The pure environment of a world, with its numbers; its states have their time as ``t``.

    Raises RuntimeError in a process that was forked from one where JAX was used, and ValueError where a user's function
    makes no environment.
    """
    _check_process()
    return _timed(world, programs.world_env(world)(programs.world_numbers(world)))


def numbers(world: World) -> Numbers:
    """The world's numbers, where JAX has them at hand."""
    values = jax.tree.leaves(programs.world_numbers(world))
    real = jnp.array([value for value in values if not isinstance(value, int)], jnp.float32)
    return Numbers(real, jnp.array([value for value in values if isinstance(value, int)], jnp.int32))


def compiled(world: World, *, many: bool = False) -> Compiled:
    """The world's functions, of one environment or of many; worlds that differ in numbers alone share them.

    Raises RuntimeError in a process that was forked from one where JAX was used.
    """
    _check_process()
    leaves, tree = jax.tree.flatten(programs.world_numbers(world))
    key = (world.structural(), tuple(isinstance(value, int) for value in leaves), tree, many)
    if key not in _compiled:
        _compiled[key] = _functions(world, many)
    return _compiled[key]


def drawn(generator: np.random.Generator) -> np.ndarray:
    """The words of a seed: [2] uint32."""
    return generator.integers(0, 2**32, size=2, dtype=np.uint32)


_compiled: dict[Hashable, Compiled] = {}
_used: set[int] = set()  # the processes, this one and those it was forked from, in which JAX was used here


def _check_process() -> None:
    """Raises RuntimeError in a process that was forked from one where JAX was used: there it would wait for ever."""
    _used.add(os.getpid())
    if len(_used) > 1:
        raise RuntimeError(
            "JAX does not survive a fork: pass vector_kwargs={'context': 'forkserver'} to gymnasium.make_vec, or leave"
            " vectorization_mode out, which runs all environments in one compiled step"
        )


def _timed(world: World, env: Env) -> Env:
    """The environment with a count of its steps in its state, which our own have; a user's may have none."""
    return env if world.factory is None else time_limit(env, NO_LIMIT)


def _functions(world: World, many: bool) -> Compiled:
    of_numbers = programs.world_env(world)
    leaves, tree = jax.tree.flatten(programs.world_numbers(world))
    whole = [isinstance(value, int) for value in leaves]

    def env_of(values: Numbers) -> Env:
        real, counts = iter(values.real), iter(values.whole)
        return _timed(world, of_numbers(jax.tree.unflatten(tree, [next(counts if one else real) for one in whole])))

    def key(of: Array, episode: Array, t: Array | int) -> Array:
        return jax.random.fold_in(jax.random.fold_in(prng.wrap(of, "threefry"), episode), t)

    def begin(of: Array, episode: Array, values: Numbers) -> Any:
        env = env_of(values)
        state = env.reset(key(of, episode, 0))
        return state, env.observe(state)

    def step(of: Array, episode: Array, state: Any, action: Array, values: Numbers) -> Any:
        after, happened = env_of(values).step(key(of, episode, state.t + 1), state, action)
        told = [jnp.asarray(x, jnp.float32) for x in (happened.reward, happened.terminated, happened.truncated)]
        return after, happened.obs, jnp.stack(told)

    def renew(over: Array, of: Array, episode: Array, state: Any, obs: Array, values: Numbers) -> Any:
        after = episode + over.astype(jnp.uint32)
        fresh = begin(of, after, values)
        return after, *jax.tree.map(lambda new, old: jnp.where(over, new, old), fresh, (state, obs))

    if many:
        begin_many = jax.vmap(begin, (0, 0, None))
        step_many = jax.vmap(step, (0, 0, 0, 0, None))
        renew_many = jax.vmap(renew, (0, 0, 0, 0, 0, None))
        return Compiled(jax.jit(begin_many), jax.jit(step_many), jax.jit(renew_many))
    return Compiled(jax.jit(begin), jax.jit(step), jax.jit(renew))
