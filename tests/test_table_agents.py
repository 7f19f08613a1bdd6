"""Tabular agents without traces make the tables of textbook loops: SARSA, expected SARSA, n steps."""

from __future__ import annotations

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from numpy_agents import (
    ACTIONS,
    ENVS,
    EPSILON,
    STATES,
    STEPS,
    VALUES,
    Constant,
    NStep,
    clock,
    example,
    in_order,
    numbers,
    random_table,
    record,
    run,
    tables,
    transitions,
)
from scipy import stats

from jaxq.agents import backups
from jaxq.agents.tabular import tabular

TARGETS = ["greedy", "sarsa", "expected"]
RECORD, START = record(1), random_table(1)


def same(ours, theirs):
    np.testing.assert_allclose(ours, theirs, rtol=0, atol=1e-10)


def textbook(it, target, n=1, **how):
    return run(it, START, lambda q, alpha: NStep(q, alpha, n), target, **how)


def test_the_record_has_every_kind_of_end_and_every_length_that_matters():
    cut = RECORD.terminated | RECORD.truncated
    assert np.sum(RECORD.terminated & RECORD.truncated) > 0
    assert np.sum(RECORD.terminated & ~RECORD.truncated) > 5
    assert np.sum(RECORD.truncated & ~RECORD.terminated) > 5
    assert np.sum(cut[1:] & cut[:-1]) > 3  # episodes of one step
    lengths = np.concatenate([np.diff(np.flatnonzero(column)) for column in cut.T])
    assert max(lengths) > 8
    assert np.all((RECORD.s[1:] == RECORD.s_next[:-1]) | cut[:-1])


@pytest.mark.parametrize("chunk", [1, 12])
@pytest.mark.parametrize("target", TARGETS)
@pytest.mark.parametrize("n", [1, 3])
def test_every_table_on_the_way_is_the_textbooks_however_experience_is_cut_into_updates(target, n, chunk):
    ours = tables(RECORD, START, chunk=chunk, target=target, n_steps=n)
    theirs = textbook(RECORD, target, n)
    same(ours, theirs[chunk - 1 :: chunk])
    assert np.max(np.abs(theirs[-1] - START)) > 0.3


@pytest.mark.parametrize("target", ["greedy", "sarsa"])
def test_more_steps_than_an_episode_has_are_its_returns(target):
    same(tables(RECORD, START, target=target, n_steps=STEPS), textbook(RECORD, target, STEPS))


@pytest.mark.parametrize(("target", "n"), [("sarsa", 1), ("expected", 3)])
def test_bootstrapping_through_death_forgets_that_it_was_one(target, n):
    ours = tables(RECORD, START, target=target, n_steps=n, bootstrap_terminal=True)
    same(ours, textbook(RECORD, target, n, bootstrap_terminal=True))
    assert not np.allclose(ours[-1], textbook(RECORD, target, n)[-1], atol=0.01)


def test_the_targets_and_the_steps_make_different_tables():
    made = [textbook(RECORD, target, n)[-1] for target in TARGETS for n in (1, 3)]
    for i, one in enumerate(made):
        assert all(np.max(np.abs(one - other)) > 0.01 for other in made[:i])


def test_without_exploration_expected_sarsa_is_q_learning():
    off = {"epsilon_min": 0.0, "epsilon_max": 0.0}
    same(tables(RECORD, START, hypers=off, target="expected", n_steps=1), textbook(RECORD, "greedy"))


@pytest.mark.parametrize("weight", [None, 1.0, 0.0])
def test_one_of_n_steps_is_one_step_bit_for_bit(weight):
    rng, start = np.random.default_rng(2), jnp.asarray(START, jnp.float32)
    one, other = (
        jax.jit(lambda *given, how=how: how.apply(*given, lambda visits: jnp.float32(0.3)))
        for how in (backups.one_step(), backups.n_step(1))
    )
    ours = theirs = backups.Table(start, None)
    memory = backups.n_step(1).init(start)
    for _ in range(10):
        visit = backups.Visit(
            *(jnp.asarray(x, jnp.int32) for x in (rng.integers(STATES), rng.integers(ACTIONS))),
            *(jnp.asarray(rng.normal(), jnp.float32) for _ in range(3)),
            cut_t=jnp.asarray(rng.random() < 0.5),
            greedy_tm1=jnp.asarray(True),
            weight=None if weight is None else jnp.float32(weight),
        )
        ours, memory, loss = other(ours, memory, visit)
        theirs, _, expected = one(theirs, (), visit)
        np.testing.assert_array_equal(ours.values, theirs.values)
        assert loss == expected
    assert np.array_equal(ours.values, start) == (weight == 0.0)


@pytest.mark.parametrize(("target", "n"), [("sarsa", 1), ("sarsa", 3), ("greedy", 3)])
def test_the_loss_is_half_the_squared_error_of_what_was_learnt_and_0_where_nothing_was(target, n):
    """Of a transition that ends several visits it is their mean, and so it is of two transitions that are learnt."""
    it, losses, q = record(8, STEPS, 1), {}, START.copy()
    learner = NStep(q, Constant(), n)
    for t, _, one in in_order(it, sarsa=target == "sarsa"):
        learner.see(one, VALUES[target](q, one))
        losses.setdefault(t, []).append(0.5 * np.mean(np.square(learner.errors)) if learner.errors else 0.0)
    ours = measured(it, target, n).loss
    theirs = np.array([np.mean(losses.get(t, 0.0)) for t in range(STEPS)])
    assert np.sum(theirs == 0) > 3
    np.testing.assert_allclose(ours, theirs, rtol=1e-4, atol=1e-5)


# What is not learnt yet, and what is over


def measured(it, target, n):
    """What updates with one transition each report."""
    agent, experience = agent_of(target=target, n_steps=n, epsilon=0.0), transitions(it, np.float32)
    state = agent.init(jax.random.key(0), example(experience))
    state = state._replace(table=state.table.at[:STATES].set(START))

    def update(state, one):
        return agent.update(jax.random.key(0), state, jax.tree.map(lambda leaf: leaf[None], one), clock())

    return jax.jit(lambda state: jax.lax.scan(update, state, experience)[1])(state)


def agent_of(epsilon=EPSILON, **parts):
    return tabular(
        numbers(np.float32, epsilon_min=epsilon, epsilon_max=epsilon), num_states=STATES, num_actions=ACTIONS, **parts
    )


def test_nothing_is_learnt_of_a_transition_before_its_next_action_is_known():
    agent, it = agent_of(target="sarsa"), record(3, 3, 1, ends=0.0)
    experience = transitions(it, np.float32)
    state, update = agent.init(jax.random.key(0), example(experience)), jax.jit(agent.update)
    moved = []
    for t in range(3):
        one = jax.tree.map(lambda leaf, t=t: leaf[t : t + 1], experience)
        after, _ = update(jax.random.key(t), state, one, clock())
        moved.append(np.argwhere(after.table != state.table).tolist())
        state = after
    assert moved == [[], [[it.s[0, 0], it.a[0, 0]]], [[it.s[1, 0], it.a[1, 0]]]]


@pytest.mark.parametrize("n", [1, 3])
def test_nothing_of_what_was_before_a_cut_is_in_what_is_learnt_after_it(n):
    """A run over a cut goes on as one that starts with the table of the cut: for each target, in every environment."""
    whole, half = record(4, STEPS, cut_at=STEPS // 2 - 1), STEPS // 2
    later = type(whole)(*(np.roll(leaf, -half, axis=0) for leaf in whole))
    for target in TARGETS:
        over = tables(whole, START, target=target, n_steps=n)
        afresh = tables(later, over[half - 1], target=target, n_steps=n)
        np.testing.assert_array_equal(afresh[:half], over[half:])


def test_a_termination_bootstraps_from_nothing_and_a_truncation_from_an_action_drawn_uniformly_at_epsilon_1():
    agent = tabular(
        numbers(np.float32, epsilon_min=1.0, epsilon_max=1.0, alpha_min=1.0, alpha_max=1.0, gamma=1.0),
        num_states=STATES,
        num_actions=ACTIONS,
        target="sarsa",
    )
    it = record(5, 1, 1, cut_at=0, ends=0.0)
    it.s[:], it.s_next[:], it.r[:] = 0, 2, 0.0
    experience = transitions(it, np.float32)
    state = agent.init(jax.random.key(0), example(experience))
    state = state._replace(table=state.table.at[2].set(jnp.array([1.0, 2.0, 3.0])))

    def learnt(key, experience):
        return agent.update(key, state, experience, clock())[0].table[0, it.a[0, 0]]

    draw = jax.jit(jax.vmap(learnt, in_axes=(0, None)))
    values = np.asarray(draw(jax.random.split(jax.random.key(1), 6000), experience))
    assert stats.chisquare([np.sum(values == value) for value in (1.0, 2.0, 3.0)]).pvalue > 1e-4
    dead = draw(jax.random.split(jax.random.key(2), 6000), experience._replace(continues_t=jnp.zeros((1, 1))))
    np.testing.assert_array_equal(dead, 0)


def test_a_truncations_action_follows_the_table_that_the_transition_before_has_changed():
    """Of two transitions that are learnt at once, the second draws its action after the first has been learnt."""
    agent = tabular(
        numbers(np.float32, alpha_min=1.0, alpha_max=1.0, gamma=1.0, epsilon_min=0.0, epsilon_max=0.0),
        num_states=STATES,
        num_actions=ACTIONS,
        target="sarsa",
    )
    it = record(6, 2, 1, ends=0.0, cut_at=1)
    it.s[:, 0], it.a[:, 0], it.s_next[:, 0], it.r[:, 0] = (0, 1), (1, 0), (1, 0), (5.0, 1.0)
    experience = transitions(it, np.float32)
    start = agent.init(jax.random.key(0), example(experience))
    state, _ = jax.jit(agent.update)(jax.random.key(0), start, experience, clock())
    np.testing.assert_array_equal(state.table[:2], [[0, 5, 0], [6, 0, 0]])


def test_environments_wait_for_their_own_next_actions():
    """N environments that share no cell learn what each would learn alone."""
    it = record(7, STEPS, ENVS, states=1)
    apart = it._replace(s=it.s + np.arange(ENVS), s_next=it.s_next + np.arange(ENVS))
    for target, n in (("sarsa", 1), ("sarsa", 3), ("greedy", 3)):
        together = tables(apart, START, target=target, n_steps=n)[-1]
        for i in range(ENVS):
            alone = type(it)(*(leaf[:, i : i + 1] for leaf in apart))
            same(together[i], textbook(alone, target, n)[-1][i])
