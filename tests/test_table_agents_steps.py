"""Step sizes by visits, first values, and planning with a learned model (Dyna-Q)."""

from __future__ import annotations

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from numpy_agents import (
    ACTIONS,
    FAST_COMPILE,
    GAMMA,
    STATES,
    ByVisits,
    NStep,
    clock,
    example,
    numbers,
    random_table,
    record,
    run,
    tables,
    transitions,
)

from jaxq.agents.tabular import tabular
from jaxq.types import Transition

RECORD, START = record(1), random_table(1)


def agent_of(hypers=None, dtype=np.float32, **parts):
    sizes = {"num_states": STATES, "num_actions": ACTIONS, "dtype": dtype} | parts
    return tabular(numbers(dtype, **(hypers or {})), **sizes)


def jitted(agent):
    return jax.jit(agent.update, compiler_options=FAST_COMPILE)


def step(s, a, r, s_next, *, continues=1.0, cut=False, dtype=np.float32):
    """One transition as experience [1, 1]."""
    leaves = (jnp.int32(s), jnp.int32(a), dtype(r), dtype(continues), jnp.int32(s_next), jnp.asarray(cut))
    return Transition(*(jnp.asarray(leaf)[None, None] for leaf in leaves))


# Step sizes


@pytest.mark.parametrize(("target", "n"), [("greedy", 1), ("sarsa", 1), ("expected", 3)])
@pytest.mark.parametrize("power", [0.5, 1.0])
def test_step_sizes_by_visits_are_those_of_each_cell(target, n, power):
    by = {"alpha_min": 0.1, "alpha_max": 0.8, "visit_power": power}
    ours = tables(RECORD, START, hypers=by, target=target, n_steps=n, step_size="visits")
    theirs = run(RECORD, START, lambda q, alpha: NStep(q, alpha, n), target, ByVisits(0.1, 0.8, power))
    np.testing.assert_allclose(ours, theirs, rtol=0, atol=1e-10)


@pytest.mark.parametrize("dtype", [np.float32, np.float64])
def test_a_bandits_values_by_visits_are_the_means_of_its_rewards(dtype):
    """Whatever they start with, and in each of its arms as often as that was pulled."""
    it = record(2, 200, 1, states=1, ends=1.0)
    with jax.enable_x64(dtype == np.float64):
        mean = {"alpha_min": 0.0, "alpha_max": 1.0, "visit_power": 1.0, "initial_value": 7.0}
        agent = agent_of(mean, dtype, step_size="visits")
        experience = transitions(it, dtype)
        state, _ = jitted(agent)(
            jax.random.key(0), agent.init(jax.random.key(0), example(experience)), experience, clock()
        )
        assert (state.table.dtype, state.counts.dtype) == (dtype, np.int32)
    pulled = [it.r[it.a == arm] for arm in range(ACTIONS)]
    np.testing.assert_allclose(state.table[0], [np.mean(rewards) for rewards in pulled], rtol=0, atol=3e-6)
    assert state.counts[0].tolist() == [len(rewards) for rewards in pulled]
    assert not np.any(state.counts[1:])


def test_a_double_learner_counts_the_visits_of_each_table():
    agent = agent_of({"alpha_min": 0.0, "alpha_max": 1.0}, double=True, step_size="visits")
    it = record(3, 300, 1, states=1, ends=1.0)
    experience = transitions(it, np.float32)
    state, _ = jitted(agent)(jax.random.key(0), agent.init(jax.random.key(0), example(experience)), experience, clock())
    counts = np.asarray(state.counts).reshape(2, -1, ACTIONS)[:, 0]
    np.testing.assert_array_equal(counts.sum(0), [np.sum(it.a == arm) for arm in range(ACTIONS)])
    assert np.all(counts > 20)


# First values


def test_optimistic_values_make_a_greedy_agent_try_every_action():
    """Sutton and Barto, section 2.6: each try disappoints; from 0 the agent stays with what it tried first."""
    tried = {}
    for first in (5.0, 0.0):
        agent = agent_of({"initial_value": first, "epsilon_min": 0.0, "epsilon_max": 0.0, "gamma": 0.0})
        act = jax.jit(agent.act)
        state, update, tried[first] = agent.init(jax.random.key(0), None), jitted(agent), []
        np.testing.assert_array_equal(agent.policy(state), np.full((STATES, ACTIONS), first))
        for t in range(ACTIONS):
            action = act(jax.random.key(t), state, jnp.int32(1), clock())
            tried[first].append(int(action))
            state, _ = update(jax.random.key(t), state, step(1, action, 1.0, 1, cut=True), clock())
    assert tried == {5.0: [0, 1, 2], 0.0: [0, 0, 0]}


# Planning


def dyna(state, agent, steps, seed=0):
    update = jitted(agent)
    for t, one in enumerate(steps):
        state, _ = update(jax.random.key(1000 * seed + t), state, one, clock())
    return state


@pytest.mark.parametrize("planning_steps", [1, 4])
def test_after_the_first_transition_planning_repeats_that_one(planning_steps):
    first = step(1, 2, 5.0, 3, continues=0.0)
    planner, plain = agent_of(planning_steps=planning_steps), agent_of()
    start = agent_of().init(jax.random.key(0), None)
    planned = dyna(planner.init(jax.random.key(0), None), planner, [first])
    repeated = dyna(start, plain, [first] * (planning_steps + 1))
    np.testing.assert_allclose(planned.table, repeated.table, rtol=1e-6)
    np.testing.assert_allclose(planned.table[1, 2], 5.0 * (1 - 0.7 ** (planning_steps + 1)), rtol=1e-6)
    assert np.count_nonzero(planned.table) == 1


def test_planning_counts_its_updates_as_visits():
    planner = agent_of(planning_steps=4, step_size="visits")
    state = dyna(planner.init(jax.random.key(0), None), planner, [step(1, 2, 5.0, 3)])
    assert (int(state.counts[1, 2]), int(jnp.sum(state.counts))) == (5, 5)


def test_no_planning_steps_are_no_model():
    agent = agent_of(planning_steps=0)
    assert agent.init(jax.random.key(0), None).model is None
    assert agent_of(planning_steps=1).init(jax.random.key(0), None).model is not None


def corridor(walks, length):
    """Walks to the right, each in ``length`` steps to the reward at its end."""
    for _ in range(walks):
        for s in range(length):
            end = s == length - 1
            yield step(s, 1, float(end), s + 1, continues=float(not end), cut=end)


def test_planning_carries_values_back_in_fewer_walks_than_learning_alone():
    """Sutton and Barto, figure 8.3: after one walk learning knows one cell after k walks k, planning all."""
    length, known = 6, {}
    exact = GAMMA ** np.arange(length)[::-1]
    for planning_steps in (0, 50):
        agent = agent_of({"alpha_min": 1.0, "alpha_max": 1.0}, num_states=length + 1, planning_steps=planning_steps)
        state = agent.init(jax.random.key(0), None)
        for walk in range(1, 4):
            state = dyna(state, agent, corridor(1, length), seed=walk)
            known[planning_steps, walk] = int(np.sum(np.abs(state.table[:length, 1] - exact) < 1e-6))
        assert not np.any(state.table[:, 0]), "an action that was never tried"
    assert [known[0, walk] for walk in (1, 2, 3)] == [1, 2, 3]
    assert known[50, 1] > 1
    assert known[50, 2] == length


def test_planning_alone_converges_to_what_the_dictionary_of_transitions_says():
    """One step on a known environment again and again: the fixed point of value iteration on the transitions tried."""
    it = record(4, 40, 1)
    seen = {
        (s, a): (r, t, n)
        for s, a, r, t, n in zip(*(x[:, 0] for x in (it.s, it.a, it.r, it.terminated, it.s_next)), strict=True)
    }
    q = np.zeros((STATES, ACTIONS))
    for _ in range(400):
        for (s, a), (r, terminated, s_next) in seen.items():
            q[s, a] = r + GAMMA * (not terminated) * max(q[s_next])
    agent = agent_of({"alpha_min": 1.0, "alpha_max": 1.0}, planning_steps=200)
    experience = transitions(it, np.float32)
    state, update = agent.init(jax.random.key(0), example(experience)), jitted(agent)
    for _ in range(3):
        state, _ = update(jax.random.key(1), state, experience, clock())
    assert len(seen) >= 11
    assert np.max(np.abs(q)) > 1
    np.testing.assert_allclose(state.table[:STATES], q, atol=1e-4)


def test_planning_bootstraps_through_death_where_learning_does():
    """The state that death leads to is worth 10, and the first transition is all that the model knows."""
    for through, expected in ((False, 1.0), (True, 1.0 + GAMMA * 10.0)):
        agent = agent_of({"alpha_min": 1.0, "alpha_max": 1.0}, planning_steps=2, bootstrap_terminal=through)
        state = agent.init(jax.random.key(0), None)
        state = state._replace(table=state.table.at[3, 0].set(10.0))
        for _ in range(2):
            state = dyna(state, agent, [step(0, 0, 1.0, 3, continues=0.0, cut=True)])
            np.testing.assert_allclose(state.table[0, 0], expected, rtol=1e-6)


@pytest.mark.parametrize("target", ["sarsa", "expected"])
def test_planning_bootstraps_as_the_target_does(target):
    """At epsilon 1 the mean of a row that is worth 0, 3 and 6: of SARSA in the long run, of expected SARSA at once."""
    hypers = {"epsilon_min": 1.0, "epsilon_max": 1.0, "gamma": 1.0, "alpha_min": 0.0, "alpha_max": 1.0}
    agent = agent_of(hypers, target=target, planning_steps=3000, step_size="visits")
    state = agent.init(jax.random.key(0), example(step(0, 0, 0.0, 0)))
    state = state._replace(table=state.table.at[3].set(jnp.array([0.0, 3.0, 6.0])))
    state = dyna(state, agent, [step(0, 0, 1.0, 3)])
    assert abs(float(state.table[0, 0]) - 4.0) < (0.25 if target == "sarsa" else 1e-3)
    if target == "sarsa":
        assert float(state.table[0, 0]) != 4.0
