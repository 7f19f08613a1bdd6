"""Probes: environments so small that their action values are known by heart, each of which finds one bug.

A learner that fails a probe but passes those before it is wrong in what the probe added: learning from a reward at all,
telling observations apart, passing value back over a step, choosing an action, choosing it by the observation, going on
after a truncation. After Jones, *Debugging RL, Without the Agonizing Pain*, 2021.

The observation that ends an episode is that of the state it ended in, so a rule that bootstraps through a termination
finds a value there and fails too.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from jaxq.types import Array, Env, Key, Step

#: Steps after which ``truncation`` cuts an episode.
TRUNCATED_AFTER = 4


class ProbeState(NamedTuple):
    """Which state it is, the observation, and the steps taken in this episode. Both [] int32."""

    s: Array
    t: Array


@dataclass(frozen=True)
class Probe:
    """An environment and its answer: ``q_star(gamma) -> [num_states, A]`` float64, the optimal action values."""

    name: str
    env: Env
    q_star: Callable[[float], np.ndarray]


def probes() -> tuple[Probe, ...]:
    """Every probe with its answer, each of which adds one thing to those before it.

    >>> [probe.name for probe in probes()]
    ['value_only', 'observation', 'discounting', 'action', 'both', 'truncation']
    >>> probes()[2].q_star(0.5).tolist()
    [[0.5], [1.0]]
    """
    return (
        Probe("value_only", value_only(), lambda gamma: np.array([[1.0]])),
        Probe("observation", observation(), lambda gamma: np.array([[1.0], [-1.0]])),
        Probe("discounting", discounting(), lambda gamma: np.array([[gamma], [1.0]])),
        Probe("action", action(), lambda gamma: np.array([[1.0, -1.0]])),
        Probe("both", both(), lambda gamma: np.array([[1.0, -1.0], [-1.0, 1.0]])),
        Probe("truncation", truncation(), lambda gamma: np.array([[1 / (1 - gamma) if gamma < 1 else np.inf]])),
    )


def value_only() -> Env:
    """One state, one action, one step, reward 1: Q = 1. Fails where values are not learnt from rewards."""
    return _one_step(1, 1, lambda s, a: jnp.ones(()))


def observation() -> Env:
    """One of two states, each in half of the episodes, one action, one step: Q(0) = 1, Q(1) = -1.

    Fails where observations do not reach the values.
    """
    return _one_step(2, 1, lambda s, a: jnp.where(s == 0, 1.0, -1.0))


def discounting() -> Env:
    """State 0, then state 1, then the end, rewards 0 and 1, one action: Q(0) = gamma, Q(1) = 1.

    Fails where the value of the next state is not discounted, is not that of the next state, or outlives a termination.
    """

    def step(key: Key, state: ProbeState, action: Array) -> tuple[ProbeState, Step]:
        del key, action
        after = ProbeState(jnp.ones((), jnp.int32), state.t + 1)
        return after, _happened(after, (state.s == 1).astype(jnp.float32), terminated=state.s == 1)

    return _probe(_first, step, 2, 1)


def action() -> Env:
    """One state, two actions, one step: Q(0) = [1, -1]. Fails where the value is not that of the action taken.

    The better action is 0.
    """
    return _one_step(1, 2, lambda s, a: jnp.where(a == 0, 1.0, -1.0))


def both() -> Env:
    """One of two states, each in half of the episodes, two actions, one step: Q(s, a) = 1 if a = s, else -1.

    Fails where the action does not follow the observation.
    """
    return _one_step(2, 2, lambda s, a: jnp.where(a == s, 1.0, -1.0))


def truncation() -> Env:
    """One state, one action, reward 1 in every step, cut after four and never ended: Q = 1 / (1 - gamma), gamma < 1.

    The observation does not tell the step. Fails where a truncation is taken for a termination; then Q is smaller.
    Pardo et al., *Time limits in reinforcement learning*, 2018.
    """

    def step(key: Key, state: ProbeState, action: Array) -> tuple[ProbeState, Step]:
        del key, action
        after = ProbeState(state.s, state.t + 1)
        return after, _happened(after, jnp.ones(()), truncated=after.t >= TRUNCATED_AFTER)

    return _probe(_first, step, 1, 1)


def _one_step(num_states: int, num_actions: int, reward: Callable[[Array, Array], Array]) -> Env:
    """Episodes of one step from one of one or two states, drawn at the reset."""

    def reset(key: Key) -> ProbeState:
        if num_states == 1:
            return _first(key)
        return ProbeState(jax.random.randint(key, (), 0, num_states, jnp.int32), jnp.zeros((), jnp.int32))

    def step(key: Key, state: ProbeState, action: Array) -> tuple[ProbeState, Step]:
        del key
        after = ProbeState(state.s, state.t + 1)
        return after, _happened(after, reward(state.s, action), terminated=jnp.ones((), bool))

    return _probe(reset, step, num_states, num_actions)


def _probe(
    reset: Callable[[Key], ProbeState],
    step: Callable[[Key, ProbeState, Array], tuple[ProbeState, Step]],
    num_states: int,
    num_actions: int,
) -> Env:
    return Env(
        reset,
        step,
        lambda state: state.s,
        num_actions=num_actions,
        obs_shape=(),
        num_states=num_states,
        deterministic=True,
    )


def _first(key: Key) -> ProbeState:
    del key
    return ProbeState(jnp.zeros((), jnp.int32), jnp.zeros((), jnp.int32))


def _happened(
    after: ProbeState, reward: Array, *, terminated: Array | None = None, truncated: Array | None = None
) -> Step:
    never = jnp.zeros((), bool)
    return Step(
        obs=after.s,
        reward=reward.astype(jnp.float32),
        terminated=never if terminated is None else terminated,
        truncated=never if truncated is None else truncated,
    )
