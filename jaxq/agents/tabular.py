"""Tabular Q-learning: a table of action values, epsilon-greedy behaviour, one update per transition."""

from __future__ import annotations

import math
from typing import NamedTuple

import jax
import jax.numpy as jnp
from jax.typing import DTypeLike

from jaxq import policies, rules, schedules
from jaxq.rules import tables
from jaxq.types import Agent, Array, Clock, Key, Metrics, Transition

#: A small table is a multiple of so many cells, the widest vector of float32, so that no pass over it has a remainder.
WHOLE_CELLS = 16


class TabularHypers(NamedTuple):
    """The numbers of a tabular learner: the step size and epsilon decay by episode on the tutorial's log10 schedule."""

    alpha_min: Array
    alpha_max: Array
    epsilon_min: Array
    epsilon_max: Array
    decay_coeff: Array
    gamma: Array
    initial_value: Array


class TabularState(NamedTuple):
    """The table of action values, [S', A]: a row per state and, in a small table, unused rows after them."""

    table: Array


def tabular(
    hypers: TabularHypers,
    *,
    num_states: int,
    num_actions: int,
    bootstrap_terminal: bool = False,
    dtype: DTypeLike = jnp.float32,
) -> Agent:
    """Q-learning on a table: q[s, a] += alpha (r + gamma c max_b q[s', b] - q[s, a]), c = 0 after a termination.

    Watkins and Dayan, *Q-learning*, 1992. With ``bootstrap_terminal`` c is always 1, as in the tutorial's update, which
    bootstraps through death: kept to reproduce it. Experience [T, N] is applied in the order of time, then environment.
    ``Metrics.loss`` is the mean of half the squared TD error, ``Metrics.max_q`` the largest value of the last successor
    before its update, the tutorial's ``best_q``. Raises ValueError when a count is below 1.
    """
    if num_states < 1 or num_actions < 1:
        raise ValueError(f"num_states, num_actions: {num_states}, {num_actions} must be at least 1")

    def alpha(clock: Clock) -> Array:
        decayed = schedules.log10_decay(clock.episodes, hypers.alpha_min, hypers.alpha_max, hypers.decay_coeff)
        return clock.live * decayed

    def exploration(clock: Clock) -> Array:
        return schedules.log10_decay(clock.episodes, hypers.epsilon_min, hypers.epsilon_max, hypers.decay_coeff)

    def init(key: Key, example: Transition) -> TabularState:
        del key, example
        whole = WHOLE_CELLS // math.gcd(WHOLE_CELLS, num_actions)
        rows = -(-num_states // whole) * whole
        if rows * num_actions > tables.DENSE_CELLS:
            rows = num_states
        return TabularState(jnp.full((rows, num_actions), hypers.initial_value, dtype))

    def act(key: Key, state: TabularState, obs: Array, clock: Clock) -> Array:
        return policies.epsilon_greedy(key, state.table[obs], exploration(clock))

    def learn(table: Array, step_size: Array, transition: Transition) -> tuple[Array, Metrics]:
        s_tm1, a_tm1, r_t, continues_t, s_t, _ = transition
        discount_t = hypers.gamma * (1.0 if bootstrap_terminal else continues_t)
        q_t = table[s_t]
        delta = rules.q_learning(table[s_tm1], a_tm1, r_t, discount_t, q_t).astype(dtype)
        table = rules.update_table(table, s_tm1, a_tm1, step_size.astype(dtype) * delta)
        return table, Metrics(0.5 * jnp.square(delta), jnp.max(q_t))

    def update(key: Key, state: TabularState, experience: Transition, clock: Clock) -> tuple[TabularState, Metrics]:
        del key
        rollout, envs = experience.r_t.shape
        in_order = Transition(*(leaf.reshape(rollout * envs, *leaf.shape[2:]) for leaf in experience))
        step_size = alpha(clock)
        table, measured = jax.lax.scan(
            lambda table, one: learn(table, step_size, one), state.table, in_order, unroll=rollout * envs == 1
        )
        return TabularState(table), Metrics(jnp.mean(measured.loss), measured.max_q[-1])

    def observe(state: TabularState, experience: Transition) -> TabularState:
        del experience
        return state

    def policy(state: TabularState) -> Array:
        return state.table[:num_states]

    def q_values(policy: Array, obs: Array) -> Array:
        return policy[obs]

    return Agent(init, act, exploration, update, observe, policy, q_values)
