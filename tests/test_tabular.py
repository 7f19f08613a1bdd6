"""The tabular learner makes the very table that a NumPy loop over Gymnasium makes from the same transitions."""

from __future__ import annotations

from typing import NamedTuple

import gymnasium
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy import stats

from jaxq.agents import tabular as module
from jaxq.agents.tabular import TabularHypers, TabularState, tabular
from jaxq.rules import tables, update_table
from jaxq.types import Clock, Transition

COUNTS = (1, 1, 6, 3)
STATES, ACTIONS, STEPS = 18, 2, 10_000
NUMBERS = TabularHypers(
    alpha_min=0.1,
    alpha_max=0.5,
    epsilon_min=0.01,
    epsilon_max=1.0,
    decay_coeff=25.0,
    gamma=0.99,
    initial_value=0.0,
    trace_decay=0.0,
    visit_power=1.0,
)


class Record(NamedTuple):
    """What a NumPy loop did: a row per step, and the table it ended with."""

    s_tm1: np.ndarray
    a_tm1: np.ndarray
    r_t: np.ndarray
    terminated: np.ndarray
    truncated: np.ndarray
    s_t: np.ndarray
    episode: np.ndarray
    best: np.ndarray
    error: np.ndarray
    table: np.ndarray


def flat(state):
    return int(np.ravel_multi_index(state, COUNTS))


def run_numpy(tutorial, *, bootstrap_terminal):
    """The tutorial's loop for STEPS steps, with the tutorial's own update or with the one that stops at termination.

    Episodes are at most 40 steps long, so that many are truncated.
    """
    rng, rows = np.random.default_rng(11), []
    table = np.zeros((*COUNTS, ACTIONS))
    with gymnasium.make("CartPole-v1", max_episode_steps=40) as env:
        bounds = tutorial.state_bounds(env)
        state, episode = tutorial.discretise(env.reset(seed=11)[0], bounds), 0
        while len(rows) < STEPS:
            epsilon, alpha = tutorial.decay(episode, 0.01, 1.0), tutorial.decay(episode, 0.1, 0.5)
            action = int(rng.integers(ACTIONS)) if rng.random() < epsilon else int(np.argmax(table[state]))
            observation, reward, terminated, truncated, _ = env.step(action)
            successor = tutorial.discretise(observation, bounds)
            old, best = table[state][action], np.amax(table[successor])
            if bootstrap_terminal:
                assert tutorial.update(table, state, action, reward, successor, alpha, 0.99) == best
                error = reward + 0.99 * best - old
            else:
                error = reward + (0.0 if terminated else 0.99 * best) - old
                table[state][action] = old + alpha * error
            rows.append((flat(state), action, reward, terminated, truncated, flat(successor), episode, best, error))
            state = successor
            if terminated or truncated:
                state, episode = tutorial.discretise(env.reset()[0], bounds), episode + 1
    return Record(*(np.array(column) for column in zip(*rows, strict=True)), table.reshape(STATES, ACTIONS))


@pytest.fixture(scope="module", params=[True, False], ids=["through death", "until death"])
def record(request, tutorial):
    return request.param, run_numpy(tutorial, bootstrap_terminal=request.param)


def transitions(record, dtype):
    return Transition(
        obs_tm1=jnp.asarray(record.s_tm1, jnp.int32),
        a_tm1=jnp.asarray(record.a_tm1, jnp.int32),
        r_t=jnp.asarray(record.r_t, dtype),
        continues_t=jnp.asarray(~record.terminated, dtype),
        obs_t=jnp.asarray(record.s_t, jnp.int32),
        cut_t=jnp.asarray(record.terminated | record.truncated),
    )


def make_clock(episodes, live=1.0, steps=0):
    return Clock(jnp.int32(steps), jnp.asarray(episodes, jnp.int32), jnp.int32(steps), jnp.float32(live))


def make_agent(dtype=np.float32, num_states=STATES, num_actions=ACTIONS, **settings):
    numbers = TabularHypers(*(jnp.asarray(number, dtype) for number in NUMBERS))
    changed = {name: jnp.asarray(settings.pop(name), dtype) for name in TabularHypers._fields if name in settings}
    return tabular(numbers._replace(**changed), num_states=num_states, num_actions=num_actions, dtype=dtype, **settings)


def key():
    return jax.random.key(0)


def random_experience(seed, shape, num_states=STATES, num_actions=ACTIONS):
    rng = np.random.default_rng(seed)
    return Transition(
        obs_tm1=jnp.asarray(rng.integers(num_states, size=shape), jnp.int32),
        a_tm1=jnp.asarray(rng.integers(num_actions, size=shape), jnp.int32),
        r_t=jnp.asarray(rng.normal(size=shape), jnp.float32),
        continues_t=jnp.asarray(rng.random(shape) < 0.7, jnp.float32),
        obs_t=jnp.asarray(rng.integers(num_states, size=shape), jnp.int32),
        cut_t=jnp.asarray(rng.random(shape) < 0.4),
    )


def random_table(seed, num_states=STATES, num_actions=ACTIONS):
    return TabularState(jnp.asarray(np.random.default_rng(seed).normal(size=(num_states, num_actions)), jnp.float32))


def run_jax(record, dtype, bootstrap_terminal):
    """``update`` on the recorded transitions, one at a time, as [1, 1]."""
    agent = make_agent(dtype, bootstrap_terminal=bootstrap_terminal)

    def body(state, inputs):
        transition, episode = inputs
        one = jax.tree.map(lambda leaf: leaf[None, None], transition)
        return agent.update(key(), state, one, make_clock(episode))

    def run(experience, episodes):
        state = agent.init(key(), jax.tree.map(lambda leaf: leaf[0], experience))
        return jax.lax.scan(body, state, (experience, episodes))

    return jax.jit(run)(transitions(record, dtype), jnp.asarray(record.episode, jnp.int32))


# Against NumPy


def test_the_record_has_every_kind_of_end(record):
    _, it = record
    assert len(it.r_t) == STEPS
    assert np.sum(it.terminated & ~it.truncated) > 50
    assert np.sum(it.truncated & ~it.terminated) > 50
    assert it.episode[-1] > 100
    assert np.sum(it.table != 0) > 15


def test_the_table_equals_numpys_in_float64(record):
    bootstrap_terminal, it = record
    with jax.enable_x64(True):
        state, metrics = run_jax(it, np.float64, bootstrap_terminal)
        assert state.table.dtype == np.float64
    np.testing.assert_allclose(state.table[:STATES], it.table, rtol=0, atol=1e-10)
    np.testing.assert_allclose(metrics.max_q, it.best, rtol=0, atol=1e-10)
    np.testing.assert_allclose(metrics.loss, 0.5 * it.error**2, rtol=0, atol=1e-8)


def test_the_table_equals_numpys_in_float32(record):
    bootstrap_terminal, it = record
    state, metrics = run_jax(it, np.float32, bootstrap_terminal)
    assert state.table.dtype == np.float32
    np.testing.assert_allclose(state.table[:STATES], it.table, rtol=1e-5, atol=0)
    np.testing.assert_allclose(metrics.max_q, it.best, rtol=1e-5, atol=1e-6)


def test_bootstrapping_through_death_or_not_makes_another_table(record):
    bootstrap_terminal, it = record
    state, _ = run_jax(it, np.float32, not bootstrap_terminal)
    assert np.max(np.abs(np.asarray(state.table[:STATES]) - it.table)) > 1


def test_one_update_worked_by_hand():
    agent = make_agent(alpha_min=0.25, alpha_max=0.25, gamma=0.5)
    state = TabularState(jnp.zeros((STATES, ACTIONS)).at[3].set(jnp.array([2.0, 8.0])).at[1, 0].set(1.0))
    for continues, target in ((1.0, 1.0 + 0.5 * 8.0), (0.0, 1.0)):
        one = jax.tree.map(lambda leaf: jnp.full((1, 1), leaf), Transition(1, 0, 1.0, continues, 3, True))
        after, metrics = agent.update(key(), state, one, make_clock(0))
        expected = np.asarray(state.table).copy()
        expected[1, 0] += 0.25 * (target - 1.0)
        np.testing.assert_array_equal(after.table, expected)
        assert metrics.loss == 0.5 * (target - 1.0) ** 2
        assert metrics.max_q == 8.0


def test_a_cut_without_a_termination_changes_nothing_in_the_update():
    experience, state = random_experience(1, (1, 8)), random_table(1)
    agent = make_agent()
    one, _ = agent.update(key(), state, experience, make_clock(30))
    other, _ = agent.update(key(), state, experience._replace(cut_t=~experience.cut_t), make_clock(30))
    np.testing.assert_array_equal(one.table, other.table)


# The order of experience


@pytest.mark.parametrize("bootstrap_terminal", [False, True])
def test_experience_is_applied_in_the_order_of_time_then_environment(bootstrap_terminal):
    agent = make_agent(num_states=3, bootstrap_terminal=bootstrap_terminal)  # few states, so that order matters
    experience, start = random_experience(2, (4, 3), num_states=3), random_table(2, num_states=3)
    update = jax.jit(agent.update)
    together, metrics = update(key(), start, experience, make_clock(30))
    losses, state = [], start
    for t in range(4):
        for n in range(3):
            one = jax.tree.map(lambda leaf, t=t, n=n: leaf[t, n][None, None], experience)
            state, measured = update(key(), state, one, make_clock(30))
            losses.append(measured.loss)
    np.testing.assert_allclose(together.table, state.table, rtol=1e-6)
    np.testing.assert_allclose(metrics.loss, np.mean(losses), rtol=1e-6)
    np.testing.assert_allclose(metrics.max_q, measured.max_q, rtol=1e-6)
    backwards, _ = update(key(), start, jax.tree.map(lambda leaf: leaf[:, ::-1], experience), make_clock(30))
    assert not np.allclose(backwards.table, state.table, rtol=1e-3)


def test_lanes_under_vmap_equal_a_loop_and_take_their_own_numbers():
    experience, starts = random_experience(3, (5, 2, 2)), [random_table(i) for i in range(5)]
    gammas = jnp.linspace(0.1, 0.9, 5)

    def update(gamma, state, experience):
        return make_agent(gamma=gamma).update(key(), state, experience, make_clock(10))[0].table

    stacked = jax.tree.map(lambda *leaves: jnp.stack(leaves), *starts)
    together = jax.jit(jax.vmap(update))(gammas, stacked, experience)
    for i, start in enumerate(starts):
        alone = update(gammas[i], start, jax.tree.map(lambda leaf, i=i: leaf[i], experience))
        np.testing.assert_allclose(together[i], alone, rtol=1e-6, atol=1e-6)


# The clock


def test_a_lane_that_is_not_live_stands_still():
    agent, experience, state = make_agent(), random_experience(4, (3, 2)), random_table(4)
    frozen, _ = jax.jit(agent.update)(key(), state, experience, make_clock(10, live=0.0))
    np.testing.assert_array_equal(np.asarray(frozen.table).view(np.uint32), np.asarray(state.table).view(np.uint32))
    moved, _ = jax.jit(agent.update)(key(), state, experience, make_clock(10, live=1.0))
    assert not np.array_equal(moved.table, state.table)


@pytest.mark.parametrize("episode", [0, 10, 24, 25, 60, 100, 224, 5000])
def test_epsilon_and_the_step_size_follow_the_episode_and_not_the_steps(tutorial, episode):
    agent = make_agent()
    assert agent.exploration(make_clock(episode)) == agent.exploration(make_clock(episode, steps=777))
    np.testing.assert_allclose(agent.exploration(make_clock(episode)), tutorial.decay(episode, 0.01, 1.0), atol=5e-7)
    state = agent.init(key(), random_experience(5, ()))
    one = random_experience(5, (1, 1))._replace(r_t=jnp.ones((1, 1)))
    after, _ = agent.update(key(), state, one, make_clock(episode, steps=777))
    np.testing.assert_allclose(np.max(after.table), tutorial.decay(episode, 0.1, 0.5), atol=5e-7)


@pytest.mark.parametrize("episode", [0, 60, 5000])
def test_an_agent_explores_at_the_rate_it_reports(tutorial, episode):
    agent, clock = make_agent(), make_clock(episode)
    state = TabularState(jnp.zeros((STATES, ACTIONS)).at[7, 1].set(1.0))
    keys = jax.random.split(jax.random.key(5), 20_000)
    actions = jax.jit(jax.vmap(lambda k: agent.act(k, state, jnp.array(7), clock)))(keys)
    rate = tutorial.decay(episode, 0.01, 1.0)
    assert stats.binomtest(int(np.sum(actions == 0)), len(actions), rate / 2).pvalue > 1e-4
    elsewhere = jax.jit(jax.vmap(lambda k: agent.act(k, state, jnp.array(8), clock)))(jax.random.split(key(), 20_000))
    assert stats.binomtest(int(np.sum(elsewhere == 1)), len(actions), rate / 2).pvalue > 1e-4  # the first of equals


# The table


@pytest.mark.parametrize("shape", [(256, 2), (257, 2), (4, 128), (171, 3), (1, 1), (600, 5)])
def test_adding_to_one_cell_equals_numpy_in_small_and_large_tables(shape):
    rng = np.random.default_rng(6)
    table = rng.normal(size=shape).astype(np.float32)
    corners = [(0, 0), (shape[0] - 1, 0), (0, shape[1] - 1), (shape[0] - 1, shape[1] - 1)]
    cells = corners + [tuple(rng.integers(shape)) for _ in range(10)]
    write = jax.jit(update_table)
    for state, action in cells:
        expected = table.copy()
        expected[state, action] += np.float32(0.3)
        np.testing.assert_array_equal(write(jnp.asarray(table), jnp.int32(state), jnp.int32(action), 0.3), expected)


@pytest.mark.parametrize("cells", [0, 10**9], ids=["scatter", "dense"])
def test_both_ways_of_writing_make_the_same_table(record, monkeypatch, cells):
    bootstrap_terminal, it = record
    monkeypatch.setattr(tables, "DENSE_CELLS", cells)
    program = str(jax.make_jaxpr(lambda table: update_table(table, 1, 1, 1.0))(jnp.zeros((STATES, ACTIONS))))
    assert ("scatter" in program) == (cells == 0)
    state, _ = run_jax(it, np.float32, bootstrap_terminal)
    monkeypatch.undo()
    dense, _ = run_jax(it, np.float32, bootstrap_terminal)
    assert dense.table.size % module.WHOLE_CELLS == 0
    np.testing.assert_allclose(state.table[:STATES], dense.table[:STATES], rtol=1e-5)


def test_a_table_larger_than_the_dense_limit_learns_as_a_small_one():
    large, small = make_agent(num_states=tables.DENSE_CELLS), make_agent()
    experience, clock = random_experience(8, (6, 2)), make_clock(30)
    state = small.init(key(), experience)
    expected, _ = small.update(key(), state, experience, clock)
    ours, _ = large.update(key(), large.init(key(), experience), experience, clock)
    assert ours.table.size > tables.DENSE_CELLS >= expected.table.size
    np.testing.assert_allclose(ours.table[:STATES], expected.table[:STATES], rtol=1e-6, atol=1e-7)
    assert not np.any(ours.table[STATES:])


@pytest.mark.parametrize("dtype", [np.uint8, np.int8, np.int16, np.int32])
def test_states_and_actions_may_be_small_integers(dtype):
    states = np.iinfo(dtype).max if np.iinfo(dtype).bits == 8 else 255
    written = update_table(jnp.zeros((states + 1, 2)), jnp.asarray(states, dtype), jnp.asarray(1, dtype), 1.0)
    np.testing.assert_array_equal(np.argwhere(written), [[states, 1]])


@pytest.mark.parametrize("dtype", [np.float32, np.float64])
def test_a_table_starts_at_its_initial_value_and_keeps_its_dtype(dtype):
    with jax.enable_x64(True):
        agent = make_agent(dtype, initial_value=2.5)
        state = agent.init(key(), random_experience(9, ()))
        np.testing.assert_array_equal(agent.policy(state), np.full((STATES, ACTIONS), 2.5))
        after, metrics = agent.update(key(), state, random_experience(9, (2, 2)), make_clock(0))
        assert (state.table.dtype, after.table.dtype) == (dtype, dtype)
        assert metrics.loss.dtype == metrics.max_q.dtype == dtype


def test_the_policy_is_the_table_and_warm_up_teaches_nothing():
    agent, state = make_agent(), random_table(10)
    assert agent.observe(state, random_experience(10, (3, 2))) is state
    np.testing.assert_array_equal(agent.policy(state), state.table)
    np.testing.assert_array_equal(agent.q_values(agent.policy(state), jnp.array(4)), state.table[4])


@pytest.mark.parametrize("counts", [{"num_states": 0}, {"num_actions": 0}, {"num_states": -3}])
def test_a_count_below_1_is_an_error(counts):
    with pytest.raises(ValueError, match=r"^num_(states|actions): .* must be at least 1$"):
        make_agent(**counts)


@pytest.mark.parametrize(("states", "rows"), [(150, 160), (160, 160), (170, 170), (171, 171)])
def test_a_table_has_unused_rows_only_where_it_stays_small_with_them(states, rows):
    """170 x 3 cells are few enough for a dense write, 176 x 3 would not be."""
    agent = tabular(NUMBERS, num_states=states, num_actions=3)
    assert agent.init(jax.random.key(0), None).table.shape == (rows, 3)
