"""What a round of training is made of, whoever steps the environments: ``experiment`` in JAX, a host loop elsewhere.

A training is a chain of *rounds*: T steps of N environments, then one update. Before the first of them the agent acts
without learning, in rounds of one step. The keys of a training are folds of its own: that of step t of environment n by
their place in the training, that of an update by its round, so no key is carried and none is used twice.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp

from jaxq import prng
from jaxq.success import Success
from jaxq.types import Array, Clock, Key, Scalar, Transition

#: Why a lane stands still; 0 while it runs.
RUNNING, SOLVED, FINISHED, DIVERGED = range(4)
#: Their names in tables; one that still runs and was put aside is paused.
STATUS = {SOLVED: "solved", FINISHED: "finished", DIVERGED: "diverged", RUNNING: "paused"}


class Limits(NamedTuple):
    """The numbers of a run: where it ends, and what counts as success."""

    max_episodes: Scalar
    max_env_steps: Scalar
    success_steps: Scalar
    success_streak: Scalar


class Streams(NamedTuple):
    """The keys of a training, one for each thing that draws."""

    reset: Key
    agent: Key
    act: Key
    step: Key
    update: Key
    evaluate: Key


def streams_of(words: Array, impl: str) -> Streams:
    """The keys that a lane's words make."""
    return Streams(*jax.random.split(prng.wrap(words, impl), len(Streams._fields)))


def new_clock() -> Clock:
    """The clock of a lane that has done nothing yet."""
    zero = jnp.zeros((), jnp.int32)
    return Clock(zero, zero, zero, live=jnp.ones((), jnp.float32))


def warm_up_rounds(steps: int, num_envs: int, steps_per_round: int) -> int:
    """The rounds of one step before the first update: after one round more at least ``steps`` transitions are there."""
    return max(0, -(-steps // num_envs) - steps_per_round)


def places(number: Array, t: Array, steps: int, num_envs: int) -> Array:
    """What the keys of step ``t`` of round ``number`` are folds by. Shapes: number, t [] -> [N]."""
    return (number * steps + t) * num_envs + jnp.arange(num_envs)


def judged(success: Success, held: Any, over: Array, length: Array, total: Array, limits: Any) -> tuple[Any, Array]:
    """The state of the success rule after a step of N environments, and whether it was met.

    Shapes: over, length, total [N] -> met []. The environments count one after the other.
    """
    held, met = jax.lax.scan(
        lambda before, episode: success.update(before, *episode, limits),
        held,
        (over, length, total),
        unroll=over.shape[0] == 1,
    )
    return held, jnp.any(met)


def ticked(clock: Clock, over: Array) -> Clock:
    """The clock after a step of N environments; that of an ended lane stands still. Shapes: over [N]."""
    live = (clock.live > 0).astype(jnp.int32)
    return clock._replace(
        env_steps=clock.env_steps + live * over.shape[0],
        episodes=clock.episodes + live * jnp.sum(over, dtype=jnp.int32),
    )


def verdict(clock: Clock, status: Array, solved: Array, diverged: Array, limits: Limits) -> tuple[Clock, Array]:
    """Ends a live lane that diverged, succeeded or reached a limit, in this order of weight."""
    limit = (clock.episodes >= limits.max_episodes) | (clock.env_steps >= limits.max_env_steps)
    reason = jnp.where(diverged, DIVERGED, jnp.where(solved, SOLVED, jnp.where(limit, FINISHED, RUNNING)))
    status = jnp.where(clock.live > 0, reason, status)
    return clock._replace(live=(status == RUNNING).astype(jnp.float32)), status


def example(obs: Any) -> Transition:
    """One transition of the right shapes and dtypes, for an agent to lay out its state."""
    zero = jnp.zeros((), jnp.float32)
    return Transition(obs, jnp.zeros((), jnp.int32), zero, zero, obs, jnp.zeros((), bool))
