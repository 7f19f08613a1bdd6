"""Double learners: of two tables each update moves one, towards a value that the other gives (Van Hasselt, 2010)."""

from __future__ import annotations

import functools
import itertools

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from numpy_agents import (
    ACTIONS,
    ALPHA,
    EPSILON,
    FAST_COMPILE,
    STATES,
    clock,
    example,
    in_order,
    numbers,
    record,
    returns,
    transitions,
)
from scipy import stats

from jaxq.agents.tabular import tabular

ROWS = 16  # of each table: 4 states and what makes the table whole


@functools.cache
def agent_of(target, n=1, envs=1, epsilon=0.0, dtype=np.float64):
    with jax.enable_x64(dtype == np.float64):
        hypers = numbers(dtype, epsilon_min=epsilon, epsilon_max=epsilon)
    sizes = {"num_states": STATES, "num_actions": ACTIONS, "num_envs": envs, "dtype": dtype}
    return tabular(hypers, **sizes, target=target, double=True, n_steps=n)


def start_of(agent, experience, seed=0):
    """A state whose two tables differ."""
    state = agent.init(jax.random.key(0), example(experience))
    values = jnp.asarray(np.random.default_rng(seed).normal(size=state.table.shape), state.table.dtype)
    return state._replace(table=values)


def value(target, own, other, one):
    """What the table ``own`` bootstraps from, epsilon 0 where SARSA draws."""
    mean = (own[one.s_next] + other[one.s_next]) / 2
    if target == "greedy":
        return other[one.s_next][np.argmax(own[one.s_next])]
    if target == "sarsa":
        return other[one.s_next][np.argmax(mean) if one.a_next is None else one.a_next]
    probs = np.full(ACTIONS, EPSILON / ACTIONS)
    probs[np.argmax(mean)] += 1 - EPSILON
    return probs @ other[one.s_next]


def learnt(pair, coins, due):
    """The two tables after the updates that are due, each of the table that its coin says.

    ``due`` has for each transition that came the visits that it ends, as lists of transitions, and its target. All
    visits that one transition ends bootstrap from the tables before any of them has moved.
    """
    pair, coins = [q.copy() for q in pair], iter(coins)
    for target, visits in due:
        old = [q.copy() for q in pair]
        for steps in visits:
            coin = next(coins)
            cell = steps[0].s, steps[0].a
            v = value(target, old[coin], old[1 - coin], steps[-1])
            pair[coin][cell] += ALPHA * (returns(steps, v) - pair[coin][cell])
    return pair


@pytest.mark.parametrize("target", ["greedy", "sarsa", "expected"])
@pytest.mark.parametrize("n", [1, 3])
def test_every_update_moves_one_table_towards_the_value_that_the_other_gives(target, n):
    """Of all ways to draw a table for each update exactly one makes the tables that the agent made."""
    agent, it = agent_of(target, n, epsilon=EPSILON if target == "expected" else 0.0), record(1, 60, 1)
    drawn, episode, ordered = [], [], list(in_order(it, sarsa=target == "sarsa"))
    with jax.enable_x64(True):
        experience = transitions(it)
        state, update = start_of(agent, experience), jax.jit(agent.update, compiler_options=FAST_COMPILE)
        assert state.table.shape == (2 * ROWS, ACTIONS)
        for t in range(len(it.r)):
            due = []
            for one in (one for at, _, one in ordered if at == t):
                episode.append(one)
                tau = len(episode) - n
                ends = range(max(tau, 0), len(episode)) if one.cut else range(max(tau, 0), tau + 1)
                due.append((target, [episode[k:] for k in ends]))
                episode = [] if one.cut else episode
            before = np.asarray(state.table[:STATES]), np.asarray(state.table[ROWS : ROWS + STATES])
            state, _ = update(jax.random.key(t), state, jax.tree.map(lambda x, t=t: x[t : t + 1], experience), clock())
            after = np.stack([state.table[:STATES], state.table[ROWS : ROWS + STATES]])
            updates = sum(len(visits) for _, visits in due)
            found = [
                coins
                for coins in itertools.product((0, 1), repeat=updates)
                if np.allclose(learnt(before, coins, due), after, rtol=0, atol=1e-10)
            ]
            assert len(found) == 1, (t, found)
            drawn += found[0]
    assert len(drawn) > 40
    assert stats.binomtest(sum(drawn), len(drawn)).pvalue > 1e-4


# Which table


def which(seed, shape, n=1, keys=4000):
    """Which table each visit of experience [T, N] moved, for so many keys [keys, T N]; each visit has its own cell."""
    steps, envs = shape
    agent, it = agent_of("greedy", n, envs, dtype=np.float32), record(seed, steps, envs, ends=0.0, cut_at=steps - 1)
    it.s[:], it.a[:], it.s_next[:] = (cells := np.arange(steps * envs).reshape(shape)) // ACTIONS, cells % ACTIONS, 3
    it.r[:] = 100.0
    experience = transitions(it, np.float32)
    state = start_of(agent, experience)

    def moved(key):
        table = agent.update(key, state, experience, clock())[0].table
        return (table != state.table).reshape(2, ROWS, ACTIONS)

    tables = np.asarray(jax.jit(jax.vmap(moved))(jax.random.split(jax.random.key(seed), keys)))
    both = tables[:, :, it.s, it.a].reshape(keys, 2, -1)
    assert np.all(both.sum(1) == 1)
    assert tables.sum() == both.sum()
    return both[:, 1].astype(int)


@pytest.mark.parametrize(("shape", "n"), [((2, 2), 1), ((3, 1), 3)], ids=["time and environments", "one flush"])
def test_the_draws_are_fair_and_independent_between_updates_environments_and_keys(shape, n):
    coins = which(3, shape, n)
    patterns = coins @ 2 ** np.arange(coins.shape[1])
    assert stats.chisquare(np.bincount(patterns, minlength=2 ** coins.shape[1])).pvalue > 1e-4
    pairs = 2 * coins[1:, 0] + coins[:-1, 0]
    assert stats.chisquare(np.bincount(pairs[::2], minlength=4)).pvalue > 1e-4


# Behaviour


def test_the_policy_is_the_mean_of_both_tables_and_actions_follow_it():
    agent, experience = agent_of("greedy", dtype=np.float32), transitions(record(4, 2, 1), np.float32)
    state = start_of(agent, experience, seed=4)
    one, other = state.table[:STATES], state.table[ROWS : ROWS + STATES]
    np.testing.assert_allclose(agent.policy(state), (one + other) / 2, rtol=1e-6)
    mean = (one + other) / 2
    act = jax.jit(agent.act)
    acts = [int(act(jax.random.key(5), state, jnp.int32(s), clock())) for s in range(STATES)]
    assert acts == np.argmax(mean, axis=1).tolist()
    assert acts != np.argmax(one, axis=1).tolist()
    assert acts != np.argmax(other, axis=1).tolist()


def test_double_q_learning_is_not_optimistic_where_q_learning_is():
    """Sutton and Barto, example 6.7: many actions of mean 0, of which the best seems to be worth more than 0."""
    actions, steps = 8, 4000
    it = record(6, steps, 1, states=1, actions=actions, ends=1.0)
    it.s[::2], it.a[::2], it.s_next[::2], it.r[::2] = 0, 0, 1, 0.0
    it.terminated[::2], it.truncated[::2], it.truncated[1::2] = False, False, False
    it.s[1::2] = 1
    experience, found = transitions(it, np.float32), {}
    for double in (False, True):
        agent = tabular(numbers(np.float32, gamma=1.0), num_states=2, num_actions=actions, double=double)
        state = agent.init(jax.random.key(0), example(experience))
        update = jax.jit(agent.update, compiler_options=FAST_COMPILE)
        mean = []
        for part in range(0, steps, 200):
            cut = jax.tree.map(lambda x, part=part: x[part : part + 200], experience)
            state, _ = update(jax.random.key(part), state, cut, clock())
            mean.append(agent.policy(state)[0, 0])
        found[double] = np.mean(mean[5:])
    assert found[False] > 0.3
    assert abs(found[True]) < 0.15


def test_both_tables_start_at_the_initial_value():
    agent = tabular(numbers(np.float32, initial_value=2.5), num_states=STATES, num_actions=ACTIONS, double=True)
    state = agent.init(jax.random.key(0), example(transitions(record(0, 2, 1), np.float32)))
    np.testing.assert_array_equal(agent.policy(state), np.full((STATES, ACTIONS), 2.5))
    assert state.table.shape == (2 * ROWS, ACTIONS)
