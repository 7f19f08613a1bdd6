"""A finite MDP draws what its arrays say, and its solutions are those of NumPy, of a long roll-out and of Gymnasium."""

from functools import partial

import gymnasium
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import stats

from jaxq import envs
from jaxq.envs import (
    MDP,
    auto_reset,
    finite_mdp,
    policy_evaluation,
    random_mdp,
    stationary_distribution,
    value_iteration,
)
from jaxq.envs.mdp import SUM_TOLERANCE, MDPState, check_distribution, check_mdp, cumulative, draw
from jaxq.types import Step
from jaxq.worlds import FrozenLake, Taxi


def some_mdp(seed=0, num_states=6, num_actions=3, **settings):
    return random_mdp(np.random.default_rng(seed), num_states, num_actions, **settings)


def env_of(mdp, **settings):
    return finite_mdp(mdp.transition, mdp.reward, mdp.start, terminal=mdp.terminal, **settings)


def rollout(mdp, *, limit=10**6, steps=100, lanes=1000, seed=0):
    """Uniform actions with auto-reset: time and state before, action, Step; [lanes, steps]."""
    keys = jax.random.split(jax.random.key(seed), lanes)
    return jax.tree.map(np.asarray, _rollout(mdp, limit, keys, steps=steps))


@partial(jax.jit, static_argnames="steps")  # the MDP is traced: those of one shape share a program
def _rollout(mdp, limit, keys, *, steps):
    env = auto_reset(env_of(mdp, max_episode_steps=limit))

    def one(key):
        start, rest = jax.random.split(key)

        def body(state, words):  # JAX takes the keys of a scan in a vmap for used, so these are words
            choose, act = jax.random.split(jax.random.wrap_key_data(words))
            a = jax.random.randint(choose, (), 0, env.num_actions)
            after, happened = env.step(act, state, a)
            return after, (state.t, env.observe(state), a, happened)

        return jax.lax.scan(body, env.reset(start), jax.random.key_data(jax.random.split(rest, steps)))[1]

    return jax.vmap(one)(keys)


def p_value(counts, probabilities):
    """Chi-square of rows of counts [K, S] against probabilities [K, S]; 0 where the impossible happened."""
    if np.any(counts[probabilities == 0]):
        return 0.0
    expected = counts.sum(-1, keepdims=True) * probabilities
    likely = expected >= 5
    statistic = ((counts - expected) ** 2)[likely] / expected[likely]
    freedom = likely.sum() - np.any(likely, -1).sum()
    if freedom == 0:
        return 1.0
    return stats.chi2.sf(statistic.sum(), freedom)


def counted(shape, *indices):
    counts = np.zeros(shape)
    np.add.at(counts, tuple(index.ravel() for index in indices), 1)
    return counts


def iterated(mdp, gamma, sweeps=20_000):
    """Optimal values by a NumPy loop over states and actions, in float64."""
    num_states, num_actions = mdp.transition.shape[:2]
    q = np.zeros((num_states, num_actions))
    for _ in range(sweeps):
        v = np.where(mdp.terminal, 0.0, q.max(-1))
        after = np.zeros_like(q)
        for s in range(num_states):
            for a in range(num_actions):
                if not mdp.terminal[s]:
                    reward = mdp.reward[s, a] if mdp.reward.ndim == 2 else mdp.transition[s, a] @ mdp.reward[s, a]
                    after[s, a] = reward + gamma * mdp.transition[s, a] @ v
        if np.array_equal(after, q):
            break
        q = after
    return q


#: Compiled once for each shape.
fast_iteration, fast_evaluation = jax.jit(value_iteration, static_argnames="tolerance"), jax.jit(policy_evaluation)


def exact(function, *arguments, **settings):
    """A solution in float64."""
    with jax.enable_x64(True):
        return np.asarray(function(*arguments, **settings))


CASES = {
    "dense": some_mdp(0),
    "few successors": some_mdp(1, branching=2),
    "no end": some_mdp(2, terminal=0),
    "three ends": some_mdp(3, 9, 2, terminal=3, branching=3),
    "one state": some_mdp(4, 1, 2, terminal=0),
}
CASES["rewards of transitions"] = CASES["few successors"]._replace(
    reward=np.random.default_rng(9).normal(size=(6, 3, 6))
)
# What stands in the row of a terminal state is of no account.
CASES["an end with a way out"] = some_mdp(5, terminal=0)._replace(
    start=np.array([0, 0.5, 0.5, 0, 0, 0]), terminal=np.array([True, False, False, False, True, False])
)


@pytest.fixture(params=CASES, ids=str)
def mdp(request):
    return CASES[request.param]


# Roll-outs


def test_transitions_rewards_and_flags_are_those_of_the_arrays(mdp):
    time, before, actions, happened = rollout(mdp, limit=20)
    counts = counted(mdp.transition.shape, before, actions, happened.obs)
    assert p_value(counts.reshape(-1, counts.shape[-1]), mdp.transition.reshape(-1, counts.shape[-1])) > 1e-3
    starts = before[time == 0]
    assert p_value(counted(mdp.start.shape, starts)[None], mdp.start[None]) > 1e-3
    if mdp.reward.ndim == 2:
        np.testing.assert_array_equal(happened.reward, np.float32(mdp.reward)[before, actions])
    else:
        np.testing.assert_array_equal(happened.reward, np.float32(mdp.reward)[before, actions, happened.obs])
    np.testing.assert_array_equal(happened.terminated, mdp.terminal[happened.obs])
    np.testing.assert_array_equal(happened.truncated, time == 19)
    assert not mdp.terminal[before].any()


def test_the_check_of_frequencies_can_fail():
    mdp = CASES["dense"]
    _, before, actions, happened = rollout(mdp)
    counts = counted(mdp.transition.shape, before, actions, happened.obs).reshape(18, 6)
    assert p_value(counts, np.roll(mdp.transition, 1, axis=1).reshape(18, 6)) < 1e-9
    assert p_value(counts, (0.97 * mdp.transition + 0.03 / 6).reshape(18, 6)) < 1e-3


def test_a_termination_at_the_time_limit_is_both():
    mdp = MDP(np.array([[[0.0, 1.0]], [[0.0, 1.0]]]), np.ones((2, 1)), np.array([1.0, 0.0]), np.array([False, True]))
    env = env_of(mdp, max_episode_steps=1)
    _, happened = env.step(jax.random.key(0), env.reset(jax.random.key(1)), jnp.int32(0))
    assert happened.terminated
    assert happened.truncated


def test_without_an_end_and_a_limit_no_flag_is_ever_set():
    mdp = CASES["no end"]
    env = finite_mdp(mdp.transition, mdp.reward, mdp.start)

    def body(state, words):
        return env.step(jax.random.wrap_key_data(words), state, jnp.int32(0))

    words = jax.random.key_data(jax.random.split(jax.random.key(1), 50))
    last, happened = jax.lax.scan(body, env.reset(jax.random.key(0)), words)
    assert not (happened.terminated | happened.truncated).any()
    assert last.t == 50


@pytest.mark.parametrize("limit", [None, 3])
def test_shapes_and_dtypes(mdp, limit):
    env = env_of(mdp, max_episode_steps=limit)
    key = jax.random.key(0)

    def strip(tree):
        return jax.tree.map(lambda x: (x.shape, x.dtype), tree)

    state = jax.eval_shape(env.reset, key)
    after, happened = jax.eval_shape(env.step, key, state, jnp.int32(0))
    assert strip(after) == strip(state)
    scalar = ((), np.bool_)
    assert strip(happened) == Step(((), np.int32), ((), np.float32), scalar, scalar)
    assert (env.num_states, env.num_actions, env.obs_shape) == (*mdp.transition.shape[:2], ())
    assert not env.deterministic
    with jax.enable_x64(True):
        double = env_of(mdp, max_episode_steps=limit)
        state = jax.eval_shape(double.reset, key)
        after, happened = jax.eval_shape(double.step, key, state, jnp.int32(0))
        assert strip(after) == strip(state)
        assert happened.reward.dtype == np.float32
        assert happened.obs.dtype == np.int32


def test_rewards_may_be_of_another_dtype():
    mdp = CASES["dense"]
    with jax.enable_x64(True):
        env = env_of(mdp, reward_dtype=jnp.float64)
        state = env.reset(jax.random.key(0))
        _, happened = env.step(jax.random.key(1), state, jnp.int32(1))
        assert float(happened.reward) == mdp.reward[int(state.s), 1]


def test_a_batch_of_mdps_steps_as_each_alone():
    mdps = [some_mdp(seed) for seed in range(4)]
    batch = jax.tree.map(lambda *x: np.stack(x), *mdps)
    limits = np.arange(1, 5)
    traces = []

    def steps(mdp, limit, key):
        traces.append(mdp)
        env = auto_reset(env_of(mdp, max_episode_steps=limit))
        start, rest = jax.random.split(key)

        def body(state, words):
            return env.step(jax.random.wrap_key_data(words), state, jnp.int32(2))

        return jax.lax.scan(body, env.reset(start), jax.random.key_data(jax.random.split(rest, 30)))

    together = jax.jit(jax.vmap(steps))(batch, limits, jax.random.split(jax.random.key(5), 4))
    assert len(traces) == 1
    for i, (mdp, key) in enumerate(zip(mdps, jax.random.split(jax.random.key(5), 4), strict=True)):
        alone = steps(mdp, int(limits[i]), key)
        jax.tree.map(lambda a, b: np.testing.assert_array_equal(a[i], b), together, alone)  # noqa: B023


@pytest.mark.parametrize("per_transition", [False, True])
def test_few_successors_step_as_the_whole_tensor_does(per_transition):
    """Known transitions with few successors keep those alone; traced ones keep all."""
    mdp = some_mdp(1, num_states=40, branching=3)
    if per_transition:
        mdp = mdp._replace(reward=np.random.default_rng(0).normal(size=mdp.transition.shape))
    cells = [x.ravel() for x in np.meshgrid(range(40), range(3), range(30), indexing="ij")]
    keys = jax.random.key_data(jax.random.split(jax.random.key(3), len(cells[0])))

    def steps(transition):
        env = finite_mdp(transition, mdp.reward, mdp.start, terminal=mdp.terminal)

        def one(words, s, a):
            return env.step(jax.random.wrap_key_data(words), MDPState(s, jnp.int32(0)), a)

        return jax.vmap(one)(keys, *map(jnp.asarray, cells[:2]))

    few, whole = steps(mdp.transition), jax.jit(steps)(jnp.asarray(mdp.transition, jnp.float32))
    jax.tree.map(np.testing.assert_array_equal, few, whole)
    assert np.all(mdp.transition[*cells[:2], few[0].s] > 0)
    assert len(np.unique(few[0].s)) == 40


# Drawing an outcome


@settings(max_examples=60, deadline=None)
@given(st.sampled_from([1, 2, 3, 7, 40]), st.integers(0, 2**32 - 1), st.floats(0, 1))
def test_an_outcome_of_probability_0_is_never_drawn(count, seed, zeros):
    rng = np.random.default_rng(seed)
    p = rng.dirichlet(np.full(count, 0.3)) * (rng.random(count) >= zeros)
    p[rng.integers(count)] += 0.1
    p = np.float32(p / p.sum())
    ends = np.asarray(cumulative(p))
    edges = ends[np.isfinite(ends)]
    below_one = np.nextafter(np.float32(1), np.float32(0))
    numbers = np.concatenate([[0, below_one], edges, np.nextafter(edges, np.float32(0)), rng.random(50)])
    numbers = np.clip(np.float32(numbers), 0, below_one)
    drawn = np.sum(numbers[:, None] >= ends, -1)  # what draw does with its uniform number
    assert drawn.max() < count
    assert np.all(p[drawn] > 0)


def test_the_last_outcome_of_positive_probability_takes_what_rounding_left():
    p = np.full(11, 0.1, np.float32)
    p[10] = 0
    assert np.isinf(cumulative(p)[9:]).all()
    # Even where the sum is far too small, as where it is traced and cannot be checked.
    ends = jax.jit(cumulative)(np.float32([0.0, 0.25, 0.25, 0.0]))
    draws = jax.vmap(lambda key: draw(key, ends))(jax.random.split(jax.random.key(0), 400))
    np.testing.assert_allclose(np.bincount(draws, minlength=4) / 400, [0, 0.25, 0.75, 0], atol=0.06)


# Solutions


@pytest.mark.parametrize("gamma", [0.0, 0.5, 0.95])
def test_value_iteration_is_a_long_loop_in_numpy(mdp, gamma):
    expected = iterated(mdp, gamma)
    got = exact(fast_iteration, mdp.transition, mdp.reward, gamma, mdp.terminal)
    assert got.dtype == np.float64
    np.testing.assert_allclose(got, expected, rtol=0, atol=1e-12)
    assert not got[mdp.terminal].any()
    single = fast_iteration(mdp.transition, mdp.reward, gamma, mdp.terminal)
    assert single.dtype == np.float32
    np.testing.assert_allclose(single, expected, rtol=0, atol=3e-5 * max(1, np.abs(expected).max()))


def test_values_without_discount_where_every_policy_ends():
    mdp = CASES["dense"]
    got = exact(value_iteration, mdp.transition, mdp.reward, 1.0, mdp.terminal)
    np.testing.assert_allclose(got, iterated(mdp, 1.0), rtol=1e-11)
    greedy = np.eye(3)[got.argmax(-1)]
    own = exact(policy_evaluation, mdp.transition, mdp.reward, 1.0, greedy, mdp.terminal)
    np.testing.assert_allclose(own, got, rtol=1e-11)


def test_values_that_do_not_converge_are_nan():
    forever, reward = np.ones((1, 1, 1)), np.ones((1, 1))
    assert np.isnan(value_iteration(forever, reward, 1.0, max_sweeps=1000)).all()
    assert np.isnan(value_iteration(forever, reward, 0.99, max_sweeps=10)).all()
    assert np.isnan(jax.jit(value_iteration)(forever, reward, 2.0)).all()
    np.testing.assert_allclose(value_iteration(forever, reward, 0.99), [[100.0]], rtol=1e-4)


def test_a_looser_tolerance_ends_within_its_bound():
    mdp, gamma = CASES["no end"], 0.9
    expected = iterated(mdp, gamma)
    errors = []
    for tolerance in (1e-1, 1e-3, 1e-5):
        got = exact(fast_iteration, mdp.transition, mdp.reward, gamma, mdp.terminal, tolerance=tolerance)
        errors.append(np.abs(got - expected).max())
        assert 0 < errors[-1] <= tolerance * max(1, np.abs(got).max()) * gamma / (1 - gamma)
    assert errors == sorted(errors, reverse=True)


@pytest.mark.parametrize("gamma", [0.0, 0.5, 0.95])
def test_policy_evaluation_is_the_linear_system_over_states_and_actions(mdp, gamma):
    num_states, num_actions = mdp.transition.shape[:2]
    pi = np.random.default_rng(7).dirichlet(np.ones(num_actions), num_states)
    got = exact(fast_evaluation, mdp.transition, mdp.reward, gamma, pi, mdp.terminal)
    # Q = r + gamma P (c pi) Q, all cells at once.
    cells = num_states * num_actions
    rewards = mdp.reward if mdp.reward.ndim == 2 else (mdp.transition * mdp.reward).sum(-1)
    onward = np.einsum("sat,tb->satb", mdp.transition, pi * ~mdp.terminal[:, None]).reshape(cells, cells)
    expected = np.linalg.solve(np.eye(cells) - gamma * onward, rewards.ravel()).reshape(num_states, num_actions)
    np.testing.assert_allclose(got[~mdp.terminal], expected[~mdp.terminal], rtol=0, atol=1e-11)
    assert not got[mdp.terminal].any()
    single = fast_evaluation(mdp.transition, mdp.reward, gamma, pi, mdp.terminal)
    np.testing.assert_allclose(single, got, rtol=0, atol=3e-5 * max(1, np.abs(got).max()))


def test_the_best_policy_has_the_optimal_values_and_no_other_has_more(mdp):
    gamma = 0.9
    best = exact(fast_iteration, mdp.transition, mdp.reward, gamma, mdp.terminal)
    greedy = np.eye(best.shape[1])[best.argmax(-1)]
    got = exact(fast_evaluation, mdp.transition, mdp.reward, gamma, greedy, mdp.terminal)
    np.testing.assert_allclose(got, best, rtol=0, atol=1e-11)
    for seed in range(5):
        pi = np.random.default_rng(seed).dirichlet(np.ones(best.shape[1]), len(best))
        other = exact(fast_evaluation, mdp.transition, mdp.reward, gamma, pi, mdp.terminal)
        assert np.all(other <= best + 1e-11)


@pytest.mark.parametrize("name", ["dense", "rewards of transitions"])
def test_the_mean_discounted_return_of_a_roll_out_is_the_value(name):
    mdp, gamma = CASES[name], 0.8
    time, _, _, happened = rollout(mdp, seed=3)
    lanes, steps = time.shape
    first = np.cumsum(time == 0, -1) == 1  # each lane's first episode; gamma^100 is 2e-10
    returns = np.sum(first * gamma ** np.arange(steps) * happened.reward, -1)
    pi = np.full(mdp.reward.shape[:2], 1 / mdp.reward.shape[1])
    q = exact(fast_evaluation, mdp.transition, mdp.reward, gamma, pi, mdp.terminal)
    expected = mdp.start @ (pi * q).sum(-1)
    error = returns.std() / np.sqrt(lanes)
    assert abs(returns.mean() - expected) < 3 * error
    assert abs(returns.mean()) > 6 * error  # or 0 would pass too


def test_a_batch_of_gammas_and_mdps_is_each_alone():
    mdps = [some_mdp(seed) for seed in range(3)]
    batch, gammas = jax.tree.map(lambda *x: np.stack(x), *mdps), np.float32([0.1, 0.5, 0.9])
    pi = np.full((6, 3), 1 / 3)

    @jax.jit
    @jax.vmap
    def both(mdp, gamma):
        return (
            value_iteration(mdp.transition, mdp.reward, gamma, mdp.terminal),
            policy_evaluation(mdp.transition, mdp.reward, gamma, pi, mdp.terminal),
        )

    best, own = both(batch, gammas)
    for i, mdp in enumerate(mdps):
        alone = value_iteration(mdp.transition, mdp.reward, gammas[i], mdp.terminal)
        np.testing.assert_allclose(best[i], alone, rtol=1e-5, atol=1e-5)
        alone = policy_evaluation(mdp.transition, mdp.reward, gammas[i], pi, mdp.terminal)
        np.testing.assert_allclose(own[i], alone, rtol=1e-5, atol=1e-5)


# Gymnasium


@pytest.fixture(scope="module")
def frozen_lake():
    """Gymnasium's slippery lake: its own dictionary of outcomes, and the arrays of it."""
    with gymnasium.make("FrozenLake-v1", is_slippery=True) as env:
        outcomes, start = env.unwrapped.P, np.array(env.unwrapped.initial_state_distrib, float)
    transition, reward, terminal = np.zeros((16, 4, 16)), np.zeros((16, 4, 16)), np.zeros(16, bool)
    for s, actions in outcomes.items():
        for a, rows in actions.items():
            for p, after, r, done in rows:
                transition[s, a, after] += p
                reward[s, a, after] = r
                terminal[after] |= done
    return outcomes, MDP(transition, reward, start, terminal)


def test_the_value_of_the_frozen_lake_is_that_of_a_loop_over_gymnasiums_outcomes(frozen_lake):
    outcomes, mdp = frozen_lake
    v = np.zeros(16)
    for _ in range(3000):
        v = np.array(
            [
                max(sum(p * (r + 0.99 * (0 if done else v[t])) for p, t, r, done in rows) for rows in actions.values())
                for actions in outcomes.values()
            ]
        )
    q = exact(fast_iteration, mdp.transition, mdp.reward, 0.99, mdp.terminal)
    np.testing.assert_allclose(q.max(-1), v, rtol=0, atol=1e-12)
    assert 0.5 < q[0].max() < 0.6  # the start is worth about 0.54


def test_the_frozen_lake_is_walked_on_as_gymnasium_walks(frozen_lake):
    _, mdp = frozen_lake
    _, before, actions, happened = rollout(mdp, limit=100, steps=300, lanes=200)
    counts = counted((16, 4, 16), before, actions, happened.obs)
    assert p_value(counts.reshape(64, 16), mdp.transition.reshape(64, 16)) > 1e-3
    ours = np.bincount(before.ravel(), minlength=16)
    theirs, rewards = np.zeros(16), []
    with gymnasium.make("FrozenLake-v1", is_slippery=True) as env:
        env.action_space.seed(1)
        s, _ = env.reset(seed=1)
        for _ in range(20_000):
            theirs[s] += 1
            s, r, terminated, truncated, _ = env.step(env.action_space.sample())
            rewards.append(float(r))
            assert terminated == mdp.terminal[s]
            if terminated or truncated:
                s, _ = env.reset()
    assert set(np.flatnonzero(ours)) == set(np.flatnonzero(theirs)) == set(np.flatnonzero(~mdp.terminal))
    np.testing.assert_allclose(ours / ours.sum(), theirs / theirs.sum(), atol=0.015)
    assert abs(happened.reward.mean() - np.mean(rewards)) < 1e-3
    assert 0 < np.mean(rewards) < 0.01


# MDPs at random


@settings(max_examples=80, deadline=None)
@given(st.data())
def test_in_a_random_mdp_every_state_can_be_reached_and_left_for_the_end(data):
    num_states = data.draw(st.integers(1, 9))
    terminal = data.draw(st.integers(0, num_states - 1))
    branching = data.draw(st.one_of(st.none(), st.integers(1, num_states)))
    seed = data.draw(st.integers(0, 2**32 - 1))
    mdp = some_mdp(seed, num_states, data.draw(st.integers(1, 3)), terminal=terminal, branching=branching)
    np.testing.assert_allclose(mdp.transition.sum(-1), 1)
    np.testing.assert_allclose(mdp.start.sum(), 1)
    assert mdp.terminal.sum() == terminal
    assert not mdp.start[mdp.terminal].any()
    assert not mdp.reward[mdp.terminal].any()
    assert all(x.dtype == np.float64 for x in mdp[:3])
    inner = ~mdp.terminal
    successors = np.count_nonzero(mdp.transition[inner], -1)
    assert np.all(successors == (num_states if branching is None else branching))
    reached = np.linalg.matrix_power(np.eye(num_states) + (mdp.transition.sum(1) > 0), num_states) > 0
    assert np.all(reached[mdp.start > 0].any(0)[inner])
    if terminal:
        assert np.all(reached[:, mdp.terminal].any(-1))
    check_mdp(*mdp[:2], mdp.terminal)
    check_distribution("start", mdp.start, (num_states,))


def test_a_random_mdp_follows_its_generator():
    one, again, other = some_mdp(1), some_mdp(1), some_mdp(2)
    assert all(np.array_equal(a, b) for a, b in zip(one, again, strict=True))
    assert not np.array_equal(one.transition, other.transition)
    assert not np.array_equal(one.reward, other.reward)


# What is refused


GOOD = some_mdp(0, 2, 1)


def changed(name, index, value):
    array = np.array(getattr(GOOD, name))
    array[index] = value
    return GOOD._replace(**{name: array})


@pytest.mark.parametrize(
    ("mdp", "message"),
    [
        (GOOD._replace(transition=np.ones((2, 2))), r"transition: shape \(2, 2\) is not allowed: \[S, A, S\]"),
        (GOOD._replace(transition=np.ones((2, 1, 3))), r"transition: shape \(2, 1, 3\) is not allowed: \[S, A, S\]"),
        (GOOD._replace(transition=np.ones((2, 0, 2))), r"transition: shape \(2, 0, 2\) is not allowed: \[S, A, S\]"),
        (GOOD._replace(reward=np.ones(2)), r"reward: shape \(2,\) is not allowed: \(2, 1\) or \(2, 1, 2\)"),
        (GOOD._replace(start=np.ones(3)), r"start: shape \(3,\) is not allowed: \(2,\)"),
        (GOOD._replace(terminal=np.ones(3, bool)), r"terminal: shape \(3,\) is not allowed: \(2,\)"),
        (GOOD._replace(terminal=np.array([0, 1])), r"terminal: dtype int\d+ is not allowed: bool"),
        (changed("transition", (1, 0), [0.5, 0.6]), r"transition: probabilities at \[1, 0\] sum to 1.1, allowed: 1"),
        (changed("transition", (1, 0), [-0.5, 1.5]), r"transition: -0.5 at \[1, 0, 0\] is not allowed: a probability"),
        (changed("transition", (0, 0, 1), np.nan), r"transition: nan at \[0, 0, 1\] is not allowed: a probability"),
        (changed("reward", (1, 0), np.inf), r"reward: inf at \[1, 0\] is not allowed: a finite number"),
        (changed("start", 0, 0.5), r"start: probabilities sum to 0.5, allowed: 1"),
        (
            GOOD._replace(start=np.array([0.75, 0.25])),
            r"start: 0.25 at \[1\], a terminal state, is not allowed: 0",
        ),
    ],
)
def test_arrays_that_are_no_mdp_are_an_error(mdp, message):
    with pytest.raises(ValueError, match=f"^{message}$"):
        env_of(mdp)
    if not message.startswith("start"):
        with pytest.raises(ValueError, match=f"^{message}$"):
            value_iteration(mdp.transition, mdp.reward, 0.9, mdp.terminal)
        with pytest.raises(ValueError, match=f"^{message}$"):
            policy_evaluation(mdp.transition, mdp.reward, 0.9, np.ones((2, 1)), mdp.terminal)


@pytest.mark.parametrize("off", [0.5, 2, 100])
def test_probabilities_may_miss_1_by_their_rounding_and_no_more(off):
    given = np.array([0.25, 0.75 + off * SUM_TOLERANCE])
    if off < 1:
        check_distribution("start", given, (2,))
        return
    with pytest.raises(ValueError, match=r"^start: probabilities sum to 1\.\d+, allowed: 1$"):
        check_distribution("start", given, (2,))
    assert SUM_TOLERANCE < 1e-4


def test_shapes_are_checked_of_tracers_too():
    with pytest.raises(ValueError, match=r"^start: shape \(3,\) is not allowed: \(2,\)"):
        jax.eval_shape(lambda mdp: env_of(mdp).reset(jax.random.key(0)), GOOD._replace(start=np.ones(3) / 3))


@pytest.mark.parametrize("limit", [0, -1, 2.5, True, np.ones(2, int)])
def test_a_limit_that_is_no_number_of_steps_is_an_error(limit):
    with pytest.raises(ValueError, match=r"^max_episode_steps: .* is not allowed: a whole number from 1 to \d+$"):
        env_of(GOOD, max_episode_steps=limit)


@pytest.mark.parametrize("gamma", [-0.1, 1.1, np.nan])
def test_a_gamma_outside_its_range_is_an_error(gamma):
    with pytest.raises(ValueError, match=rf"^gamma: {gamma} is not allowed: a number in \[0, 1\]$"):
        value_iteration(GOOD.transition, GOOD.reward, gamma, GOOD.terminal)
    with pytest.raises(ValueError, match=rf"^gamma: {gamma} is not allowed: a number in \[0, 1\]$"):
        policy_evaluation(GOOD.transition, GOOD.reward, gamma, np.ones((2, 1)), GOOD.terminal)


def test_other_numbers_that_are_refused():
    with pytest.raises(ValueError, match=r"^gamma: shape \(2,\) is not allowed: \(\); jax.vmap adds a batch$"):
        value_iteration(GOOD.transition, GOOD.reward, np.ones(2))
    for tolerance in (0.0, -1.0, np.nan, np.inf):
        with pytest.raises(ValueError, match=rf"^tolerance: {tolerance} is not allowed: None or a number above 0$"):
            value_iteration(GOOD.transition, GOOD.reward, 0.9, tolerance=tolerance)
    with pytest.raises(ValueError, match=r"^max_sweeps: 0 is not allowed: at least 1$"):
        value_iteration(GOOD.transition, GOOD.reward, 0.9, max_sweeps=0)
    with pytest.raises(ValueError, match=r"^policy: shape \(2, 2\) is not allowed: \(2, 1\)$"):
        policy_evaluation(GOOD.transition, GOOD.reward, 0.9, np.ones((2, 2)) / 2)
    with pytest.raises(ValueError, match=r"^policy: probabilities at \[0\] sum to 2.0, allowed: 1$"):
        policy_evaluation(GOOD.transition, GOOD.reward, 0.9, np.full((2, 1), 2.0))


@pytest.mark.parametrize(
    ("arguments", "settings", "message"),
    [
        ((0, 1), {}, "num_states: 0 is not allowed: a whole number, at least 1"),
        ((2, 0), {}, "num_actions: 0 is not allowed: a whole number, at least 1"),
        ((2, 1.5), {}, "num_actions: 1.5 is not allowed: a whole number, at least 1"),
        ((2, 1), {"terminal": 2}, "terminal: 2 is not allowed: a whole number, 0 to 1"),
        ((2, 1), {"branching": 3}, "branching: 3 is not allowed: a whole number, 1 to 2"),
        ((2, 1), {"branching": 0}, "branching: 0 is not allowed: a whole number, 1 to 2"),
    ],
)
def test_counts_of_a_random_mdp_that_are_refused(arguments, settings, message):
    with pytest.raises(ValueError, match=f"^{message}$"):
        random_mdp(np.random.default_rng(0), *arguments, **settings)


@pytest.mark.parametrize("size", [5, 60])
def test_two_islands_have_no_distribution_of_their_own_until_a_start_says_which(size):
    rng = np.random.default_rng(size)
    for _ in range(10):
        transition = np.zeros((2 * size, 1, 2 * size), np.float32)
        for island in (slice(0, size), slice(size, 2 * size)):
            transition[island, 0, island] = rng.dirichlet(np.ones(size), size)
        policy = np.ones((2 * size, 1))
        assert np.all(np.isnan(stationary_distribution(transition, policy)))
        start, terminal = np.eye(2 * size)[0], np.zeros(2 * size, bool)
        d = np.asarray(stationary_distribution(transition, policy, terminal, start))
        assert np.all(d[size:] == 0)
        alone = stationary_distribution(transition[:size, :, :size], policy[:size])
        np.testing.assert_allclose(d[:size], alone, atol=1e-6)


def test_a_policy_that_stays_acts_where_it_stays():
    mdp = envs.exact(FrozenLake(is_slippery=False))
    left = np.eye(4)[np.zeros(16, int)]
    d = stationary_distribution(mdp.transition, left, mdp.terminal, mdp.start)
    np.testing.assert_allclose(d, np.eye(16)[0], atol=1e-7)


def test_a_large_world_in_float32_sums_to_1_and_no_episode_begins_at_its_end():
    mdp = envs.exact(Taxi(is_rainy=True))
    d = stationary_distribution(mdp.transition, np.full((500, 6), 1 / 6), mdp.terminal, mdp.start)
    assert float(jnp.sum(d)) == pytest.approx(1, abs=1e-6)
    with pytest.raises(ValueError, match=r"^start: 0\.5 at \[1\], a terminal state, is not allowed: 0"):
        stationary_distribution([[[0.0, 1.0]], [[0.0, 1.0]]], np.ones((2, 1)), np.array([False, True]), [0.5, 0.5])


def test_values_of_any_scale_are_of_one_accuracy():
    mdp = random_mdp(np.random.default_rng(0), 12, 3)
    plain = value_iteration(mdp.transition, mdp.reward, 0.9, mdp.terminal)
    for scale in (2.0**-30, 2.0**20):
        scaled = value_iteration(mdp.transition, np.float32(scale) * mdp.reward, 0.9, mdp.terminal)
        np.testing.assert_array_equal(scaled, scale * plain)
    one = value_iteration(np.ones((1, 1, 1)), np.full((1, 1), 1e-6), 0.99)
    assert float(one[0, 0]) == pytest.approx(1e-4, rel=1e-3)


def test_a_reward_forty_steps_away_shows_the_way():
    size = 40
    transition, reward = np.zeros((size, 2, size)), np.zeros((size, 2))
    for s in range(size):
        transition[s, 0, max(0, s - 1)] = transition[s, 1, min(size - 1, s + 1)] = 1
    reward[size - 2, 1] = 1
    q = np.asarray(value_iteration(transition, reward, 0.5, np.arange(size) == size - 1))
    assert np.all(q[:-1].argmax(1) == 1)
    np.testing.assert_allclose(q[:-1, 1], 0.5 ** np.arange(size - 2, -1, -1.0), rtol=1e-6)
