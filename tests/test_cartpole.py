"""CartPole equals Gymnasium's classic ``CartPole-v1``, one step at a time, over episodes and for every parameter."""

from __future__ import annotations

import contextlib
import itertools
import math

import gymnasium
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy import stats

from jaxq import envs
from jaxq.envs import CartPoleParams, CartPoleState, auto_reset, cartpole
from jaxq.types import Env, Step

KEY = 20
THRESHOLDS = ((0, 2.4), (0, -2.4), (2, 12 * 2 * math.pi / 360), (2, -12 * 2 * math.pi / 360))
PHYSICS = CartPoleParams._fields[:8]
DTYPES = pytest.mark.parametrize("dtype", [np.float32, np.float64])
INTEGRATORS = pytest.mark.parametrize("integrator", ["euler", "semi-implicit"])
#: Two programs may round differently: a successor closer to a threshold than this is on neither side for certain.
CLEAR_ULPS = 4


def precision(dtype):
    return jax.enable_x64(True) if np.dtype(dtype) == np.float64 else contextlib.nullcontext()


def gym_env(integrator="euler", **settings):
    env = gymnasium.make("CartPole-v1", disable_env_checker=True, **settings)
    env.unwrapped.kinematics_integrator = "euler" if integrator == "euler" else "semi-implicit euler"
    env.reset(seed=0)
    return env


def set_physics(env, **values):
    """Changes Gymnasium's attributes and recomputes the two that derive from them."""
    inner = env.unwrapped
    for name, value in values.items():
        assert hasattr(inner, name)
        setattr(inner, name, float(value))
    inner.total_mass = inner.masspole + inner.masscart
    inner.polemass_length = inner.masspole * inner.length


def is_outside(states, x_threshold=2.4, theta_threshold=THRESHOLDS[2][1]):
    """In NumPy, in the dtype of the states: [..., 4] -> [...]."""
    x_threshold, theta_threshold = states.dtype.type(x_threshold), states.dtype.type(theta_threshold)
    return (np.abs(states[..., 0]) > x_threshold) | (np.abs(states[..., 2]) > theta_threshold)


def gym_steps(env, states, actions):
    """Gymnasium's successors, observations, rewards and flags, each from its own state.

    Gymnasium remembers in ``steps_beyond_terminated`` that an episode is over; the reward here is a function of the old
    and the new state, so the memory is set to what it is in an episode whose last state was the first one outside.
    """
    inner, rows = env.unwrapped, []
    for state, action in zip(np.asarray(states, np.float64), actions, strict=True):
        inner.state = state
        over = is_outside(state, inner.x_threshold, inner.theta_threshold_radians)
        inner.steps_beyond_terminated = 1 if over else None
        obs, reward, terminated, _, _ = inner.step(int(action))
        rows.append((inner.state, obs, reward, terminated))
    return tuple(np.array(column) for column in zip(*rows, strict=True))


def to_state(states, dtype, t=0):
    states = jnp.asarray(states, dtype)
    return CartPoleState(*states.T, jnp.broadcast_to(jnp.asarray(t, jnp.int32), states.shape[:1]))


def to_array(state):
    return np.stack([np.asarray(leaf) for leaf in state[:4]], axis=-1)


def many_steps(env, states, actions, dtype, t=0):
    step = jax.jit(jax.vmap(env.step, in_axes=(None, 0, 0)))
    return step(jax.random.key(KEY), to_state(states, dtype, t), jnp.asarray(actions, jnp.int32))


def near(threshold, dtype, ulps):
    return dtype(threshold) + ulps * np.spacing(np.abs(dtype(threshold)))


def random_states(rng, count):
    """Both inside and outside, about a third of them inside."""
    return rng.uniform([-4.0, -4.0, -0.35, -4.0], [4.0, 4.0, 0.35, 4.0], (count, 4))


def states_at_thresholds(rng, dtype):
    """One coordinate on a threshold or an ulp to either side of it, the others random, at rest and moving."""
    rows = []
    for (i, threshold), ulps, still in itertools.product(THRESHOLDS, (-1, 0, 1), (False, True)):
        some = random_states(rng, 16).astype(dtype) * (0.5 if still else 1.0)
        some[:, i] = near(threshold, dtype, ulps)
        if still:
            some[:, [1, 3]] = 0
        rows.append(some)
    return np.concatenate(rows).astype(dtype)


def states_that_land(rng, env, dtype):
    """States and actions whose successors lie within ulps of a threshold, found by correcting with Gymnasium's step.

    The cart's acceleration does not depend on x, so x is moved by what is missing; the pole's does depend on theta, so
    there theta stays and theta_dot is moved.
    """
    cases = list(itertools.product(THRESHOLDS, (-2, -1, 0, 1, 2), range(4), (0, 1)))
    axis = np.array([threshold[0] for threshold, *_ in cases])
    target = np.array([float(near(threshold[1], dtype, ulps)) for threshold, ulps, *_ in cases])
    actions = np.array([action for *_, action in cases])
    states = rng.uniform([-1, -3, -0.15, -2], [1, 3, 0.15, 2], (len(cases), 4)).astype(dtype)
    rows = np.arange(len(cases))
    start = np.abs(target) - np.abs(rng.uniform(0.01, 0.05, len(cases)))
    states[rows, axis] = np.where(axis == 2, np.sign(target) * start, states[rows, axis])
    for _ in range(12):
        missing = target - gym_steps(env, states, actions)[0][rows, axis]
        moved = np.where(axis == 0, 0, 3)
        states[rows, moved] = (states[rows, moved] + missing / np.where(axis == 0, 1, 0.02)).astype(dtype)
    return states, actions


def is_clear(states, dtype, ulps):
    """Further than so many ulps from every threshold."""
    distances = [
        np.abs(states[:, i].astype(np.float64) - threshold) / np.spacing(dtype(abs(threshold)))
        for i, threshold in THRESHOLDS
    ]
    return np.min(distances, axis=0) > ulps


def balance(state):
    """A linear controller that holds the pole for ever."""
    return (0.1 * state[0] + 0.3 * state[1] + 3.0 * state[2] + state[3] > 0).astype(int)


# One step


@DTYPES
@INTEGRATORS
@pytest.mark.parametrize("sutton_barto_reward", [False, True])
def test_one_step_equals_gymnasium_from_any_state(dtype, integrator, sutton_barto_reward):
    rng = np.random.default_rng(1)
    gym = gym_env(integrator, sutton_barto_reward=sutton_barto_reward)
    plain = np.concatenate([random_states(rng, 10_000).astype(dtype), states_at_thresholds(rng, dtype)])
    landing, landing_actions = states_that_land(rng, gym, dtype)
    states = np.concatenate([plain, plain, landing])
    actions = np.concatenate([np.zeros(len(plain), int), np.ones(len(plain), int), landing_actions])
    expected_state, expected_obs, expected_reward, expected_terminated = gym_steps(gym, states, actions)
    clear = is_clear(expected_state, dtype, CLEAR_ULPS)
    assert np.sum(~clear[-len(landing) :]) == len(landing)  # the cases on the edge are really there, on both sides
    assert 40 < np.sum(expected_terminated[-len(landing) :]) < 120

    with precision(dtype):
        env = cartpole(integrator=integrator, sutton_barto_reward=sutton_barto_reward, dtype=dtype)
        after, happened = many_steps(env, states, actions, dtype)
    if dtype == np.float64:
        np.testing.assert_allclose(to_array(after), expected_state, rtol=0, atol=1e-12)
        np.testing.assert_array_max_ulp(np.asarray(happened.obs), expected_obs, 1)
    else:
        error = np.abs(np.asarray(happened.obs, np.float64) - expected_obs) / np.maximum(1, np.abs(expected_obs))
        assert error.max() <= 1e-6
        # A float32 start on the edge is outside for a float64 threshold and not for the float32 one, or the other way.
        start_clear = is_clear(states, dtype, 1)
    # Gymnasium's flag, wherever rounding cannot decide it ...
    np.testing.assert_array_equal(np.asarray(happened.terminated)[clear], expected_terminated[clear])
    # ... and everywhere the flag of the very state that was returned.
    np.testing.assert_array_equal(happened.terminated, is_outside(to_array(after)))
    sure = clear if dtype == np.float64 else clear & start_clear
    np.testing.assert_array_equal(np.asarray(happened.reward)[sure], expected_reward[sure])
    assert not np.any(happened.truncated)


def test_a_state_at_rest_terminates_as_in_gymnasium_to_the_last_ulp_in_float64():
    cases = list(itertools.product(THRESHOLDS, range(-3, 4)))
    states = np.zeros((len(cases), 4))
    for state, ((axis, threshold), ulps) in zip(states, cases, strict=True):
        state[axis] = near(threshold, np.float64, ulps)
    expected_state, _, _, expected = gym_steps(gym_env(), states, [1] * len(cases))
    with precision(np.float64):
        after, happened = many_steps(cartpole(dtype=np.float64), states, [1] * len(cases), np.float64)
    # Without velocity the successor has the same coordinates, in any order of rounding.
    np.testing.assert_array_equal(to_array(after)[:, [0, 2]], expected_state[:, [0, 2]])
    np.testing.assert_array_equal(happened.terminated, expected)
    assert np.sum(expected) == 4 * 3


def test_a_float32_state_on_the_float32_threshold_goes_on_and_one_ulp_further_terminates():
    states = np.zeros((2, len(THRESHOLDS), 4), np.float32)
    for ulps, (case, (axis, threshold)) in itertools.product((0, 1), enumerate(THRESHOLDS)):
        states[ulps, case, axis] = np.sign(threshold) * near(abs(threshold), np.float32, ulps)
    terminated = many_steps(cartpole(), states.reshape(-1, 4), [1] * 8, np.float32)[1].terminated
    np.testing.assert_array_equal(terminated, [False] * 4 + [True] * 4)


@pytest.mark.parametrize(("sutton_barto_reward", "rewards"), [(False, (1, 1, 0, 1)), (True, (0, -1, -1, 0))])
def test_the_reward_depends_on_where_the_step_starts_and_ends(sutton_barto_reward, rewards):
    stays, falls, stays_outside, returns = [0, 0, 0, 0], [2.39, 2, 0, 0], [2.5, 2, 0, 0], [2.41, -2, 0, 0]
    states = np.array([stays, falls, stays_outside, returns])
    expected = gym_steps(gym_env(sutton_barto_reward=sutton_barto_reward), states, [1] * 4)
    _, happened = many_steps(cartpole(sutton_barto_reward=sutton_barto_reward), states, [1] * 4, np.float32)
    np.testing.assert_array_equal(happened.terminated, [False, True, True, False])
    np.testing.assert_array_equal(happened.reward, rewards)
    np.testing.assert_array_equal(happened.reward, expected[2])


def test_any_action_but_one_pushes_to_the_left():
    left, other = (many_steps(cartpole(), np.zeros((1, 4)), [action], np.float32)[0] for action in (0, -1))
    assert left == other
    assert left.x_dot[0] < 0


# Episodes


def play(policy, seed, fall_at=None, **settings):
    """A Gymnasium episode: states [T + 1, 4], actions, rewards, terminated, truncated [T]."""
    env = gymnasium.make("CartPole-v1", **settings)
    env.reset(seed=seed)
    rng = np.random.default_rng(seed)
    before, after, rest = [], [], []
    over = False
    while not over:
        if len(before) == fall_at:
            env.unwrapped.state = np.array([2.39, 3.0, 0.0, 0.0])
        state = np.array(env.unwrapped.state)
        action = int(policy(state, rng))
        _, reward, terminated, truncated, _ = env.step(action)
        over = terminated or truncated
        before.append(state)
        after.append(env.unwrapped.state)
        rest.append((action, reward, terminated, truncated))
    return np.array(before), np.array(after), *(np.array(column) for column in zip(*rest, strict=True))


POLICIES = {
    "random": lambda state, rng: rng.integers(2),
    "always left": lambda state, rng: 0,
    "always right": lambda state, rng: 1,
    "clumsy balance": lambda state, rng: balance(state) if rng.random() < 0.4 else rng.integers(2),
    "balance": lambda state, rng: balance(state),
}


@DTYPES
@pytest.mark.parametrize("name", POLICIES)
def test_rewards_and_flags_of_whole_episodes_equal_gymnasium(name, dtype):
    episodes = [play(POLICIES[name], seed) for seed in range(4)]
    before, after, actions, rewards, terminated, truncated = (np.concatenate(c) for c in zip(*episodes, strict=True))
    t = np.concatenate([np.arange(len(episode[0])) for episode in episodes])
    assert all(len(episode[0]) == 500 for episode in episodes) == (name == "balance")
    with precision(dtype):
        state, happened = many_steps(cartpole(dtype=dtype), before, actions, dtype, t)
    np.testing.assert_allclose(to_array(state), after, rtol=0, atol=1e-12 if dtype == np.float64 else 1e-6)
    np.testing.assert_array_equal(happened.reward, rewards)
    np.testing.assert_array_equal(happened.terminated, terminated)
    np.testing.assert_array_equal(happened.truncated, truncated)
    np.testing.assert_array_equal(state.t, t + 1)


@DTYPES
def test_falling_exactly_on_step_500_is_terminated_and_truncated(dtype):
    before, _, actions, rewards, terminated, truncated = play(POLICIES["balance"], 0, fall_at=499)
    assert len(before) == 500
    assert terminated[-1]
    assert truncated[-1]
    with precision(dtype):
        _, happened = many_steps(cartpole(dtype=dtype), before, actions, dtype, np.arange(500))
    np.testing.assert_array_equal(happened.reward, rewards)
    np.testing.assert_array_equal(happened.terminated, terminated)
    np.testing.assert_array_equal(happened.truncated, truncated)


def test_running_freely_in_float64_stays_with_gymnasium_for_100_steps():
    gym = gym_env()
    gym.reset(seed=3)
    start, expected = np.array(gym.unwrapped.state), []
    for _ in range(100):
        gym.step(int(balance(gym.unwrapped.state)))
        expected.append(gym.unwrapped.state)
    with precision(np.float64):
        env = cartpole(dtype=np.float64)

        def body(state, _):
            state, happened = env.step(jax.random.key(KEY), state, balance(jnp.stack(state[:4])))
            return state, (jnp.stack(state[:4]), happened.terminated)

        first = CartPoleState(*jnp.asarray(start), jnp.int32(0))
        last, (states, terminated) = jax.lax.scan(body, first, length=100)
    np.testing.assert_allclose(states, expected, rtol=0, atol=1e-9)
    assert not np.any(terminated)
    assert last.t == 100


# Reset


@pytest.fixture(scope="module")
def resets():
    keys = jax.random.split(jax.random.key(KEY), 20_000)
    return to_array(jax.jit(jax.vmap(cartpole().reset))(keys))


@pytest.mark.parametrize("axis", range(4))
def test_a_reset_is_uniform_as_in_gymnasium(resets, axis):
    gym = gym_env()
    theirs = [gym.reset(seed=seed)[0][axis] for seed in range(2000)]
    assert stats.kstest(resets[:, axis], stats.uniform(-0.05, 0.1).cdf).pvalue > 1e-3
    assert stats.ks_2samp(resets[:, axis], theirs).pvalue > 1e-3
    assert np.all(np.abs(resets[:, axis]) <= np.float32(0.05))


@pytest.mark.parametrize(("one", "other"), list(itertools.combinations(range(4), 2)))
def test_coordinates_of_a_reset_are_independent(resets, one, other):
    table = np.histogram2d(resets[:, one], resets[:, other], bins=8, range=[(-0.05, 0.05)] * 2)[0]
    assert stats.chi2_contingency(table).pvalue > 1e-3


def test_neighbouring_keys_give_independent_resets(resets):
    flat = resets[:, 0]
    assert stats.pearsonr(flat[:-1], flat[1:]).pvalue > 1e-3
    assert len(np.unique(flat)) > 0.99 * len(flat)


def test_a_reset_depends_on_its_key_alone():
    env = cartpole()
    first, again, other = (env.reset(jax.random.key(seed)) for seed in (1, 1, 2))
    assert first == again
    assert not np.any(to_array(first) == to_array(other))
    assert first.t == 0


@DTYPES
def test_reset_bounds_can_be_set_as_in_gymnasium(dtype):
    gym = gym_env()
    theirs = np.array([gym.reset(seed=i, options={"low": 0.1, "high": 0.3})[0] for i in range(500)]).ravel()
    with precision(dtype):
        env = cartpole(CartPoleParams(reset_low=0.1, reset_high=0.3), dtype=dtype)
        states = jax.vmap(env.reset)(jax.random.split(jax.random.key(KEY), 4000))
    ours = to_array(states).ravel()
    assert np.all((ours >= dtype(0.1)) & (ours <= dtype(0.3)))
    assert stats.kstest(ours, stats.uniform(0.1, 0.2).cdf).pvalue > 1e-3
    assert stats.ks_2samp(ours, theirs).pvalue > 1e-3
    assert ours.dtype == dtype


# Parameters

VALUES = {
    "gravity": (1.6, 9.8, 24.8),
    "masscart": (0.3, 1.0, 2.5),
    "masspole": (0.05, 0.1, 1.0),
    "length": (0.1, 0.5, 1.7),
    "force_mag": (2.0, 10.0, 30.0),
    "tau": (0.005, 0.02, 0.05),
    "theta_threshold_radians": (0.05, 0.1, 0.3),
    "x_threshold": (0.4, 1.0, 3.0),
}


def test_values_cover_the_physics():
    assert tuple(VALUES) == PHYSICS


@INTEGRATORS
@pytest.mark.parametrize("name", [*PHYSICS, "all together"])
def test_batched_parameters_equal_a_loop_over_gymnasium(name, integrator):
    rng = np.random.default_rng(4)
    names = PHYSICS if name == "all together" else (name,)
    settings = list(zip(*(VALUES[n] for n in names), strict=True))
    states, actions = random_states(rng, 200), rng.integers(2, size=200)
    with precision(np.float64):

        def steps(values):
            params = CartPoleParams()._replace(**dict(zip(names, values, strict=True)))
            env = cartpole(params, integrator=integrator, dtype=np.float64)
            return many_steps(env, states, actions, np.float64)

        after, happened = jax.vmap(steps)(tuple(jnp.asarray(column) for column in zip(*settings, strict=True)))
    for i, values in enumerate(settings):
        gym = gym_env(integrator)
        set_physics(gym, **dict(zip(names, values, strict=True)))
        expected_state, _, expected_reward, expected_terminated = gym_steps(gym, states, actions)
        np.testing.assert_allclose(to_array(after)[i], expected_state, rtol=1e-12, atol=1e-12)
        np.testing.assert_array_equal(happened.terminated[i], expected_terminated)
        np.testing.assert_array_equal(happened.reward[i], expected_reward)
    terminated = np.asarray(happened.terminated)
    varied = np.ptp(to_array(after), axis=0).any() or np.any(terminated != terminated[0])
    assert varied


def test_batched_time_limits_equal_gymnasium():
    limits = [1, 3, 7]
    lengths = [len(play(POLICIES["random"], 5, max_episode_steps=limit)[0]) for limit in limits]
    assert lengths == limits

    def truncated(limit):
        env = cartpole(CartPoleParams(max_episode_steps=limit))
        state = to_state(np.zeros((1, 4)), np.float32)
        state = jax.tree.map(lambda leaf: leaf[0], state)

        def body(state, _):
            state, happened = env.step(jax.random.key(KEY), state, state.t % 2)
            return state, happened.truncated

        return jax.lax.scan(body, state, length=8)[1]

    flags = jax.vmap(truncated)(jnp.array(limits))
    np.testing.assert_array_equal(flags, np.arange(1, 9) >= np.array(limits)[:, None])


def test_batched_reset_bounds_equal_a_loop():
    seeds, low, high = jnp.arange(3), jnp.array([-0.1, 0.0, 0.2]), jnp.array([0.1, 0.1, 0.3])

    def reset(seed, low, high):
        return cartpole(CartPoleParams(reset_low=low, reset_high=high)).reset(jax.random.key(seed))

    batched = to_array(jax.vmap(reset)(seeds, low, high))
    for i in range(3):
        np.testing.assert_allclose(batched[i], to_array(reset(i, low[i], high[i])), rtol=1e-6)
        assert np.all((batched[i] >= low[i]) & (batched[i] <= high[i]))


def test_every_parameter_may_be_traced_and_is_compiled_once():
    traces = []

    @jax.jit
    def successor(params, key):
        traces.append(params)
        env = cartpole(params)
        reset_key, step_key = jax.random.split(key)
        return env.step(step_key, env.reset(reset_key), jnp.int32(1))

    base = {name: jnp.float32(value) for name, value in CartPoleParams()._asdict().items()}
    base["max_episode_steps"] = jnp.int32(500)
    results = [successor(CartPoleParams(**base), jax.random.key(KEY))]
    for name in CartPoleParams._fields:
        changed = base[name] * 0 + (1 if name == "max_episode_steps" else 0.001)
        results.append(successor(CartPoleParams(**{**base, name: changed}), jax.random.key(KEY)))
    assert len(traces) == 1
    leaves = [[float(leaf) for leaf in jax.tree.leaves((r[0], r[1].terminated, r[1].truncated))] for r in results]
    assert all(changed != leaves[0] for changed in leaves[1:])  # each parameter makes a difference


# Contract


@pytest.mark.parametrize(("dtype", "x64"), [(np.float32, False), (np.float32, True), (np.float64, True)])
def test_dtypes_are_stable_under_scan(dtype, x64):
    with jax.enable_x64(True) if x64 else contextlib.nullcontext():
        env = cartpole(dtype=dtype)
        keys = jax.random.split(jax.random.key(KEY + 1), 3)
        start = env.reset(jax.random.key(KEY))
        last, happened = jax.lax.scan(lambda state, key: env.step(key, state, jnp.int32(0)), start, keys)
        observed = env.observe(last)
    assert [leaf.dtype for leaf in last] == [dtype] * 4 + [np.int32]
    assert (happened.obs.dtype, happened.reward.dtype) == (np.float32, np.float32)
    assert (happened.terminated.dtype, happened.truncated.dtype) == (np.bool_, np.bool_)
    assert happened.obs.shape == (3, *env.obs_shape)
    np.testing.assert_array_equal(observed, happened.obs[-1])
    assert (env.num_actions, env.num_states) == (2, None)


def test_observations_may_be_float64():
    with precision(np.float64):
        env = cartpole(dtype=np.float64, obs_dtype=np.float64)
        state, happened = env.step(jax.random.key(KEY), env.reset(jax.random.key(KEY)), jnp.int32(0))
        assert happened.obs.dtype == np.float64
        np.testing.assert_array_equal(happened.obs, to_array(state))


def test_a_step_ignores_its_key():
    states = random_states(np.random.default_rng(5), 20)
    env, state = cartpole(), to_state(states, np.float32)
    one, other = (
        jax.vmap(env.step, in_axes=(None, 0, None))(jax.random.key(seed), state, jnp.int32(1)) for seed in (1, 2)
    )
    assert all(np.array_equal(a, b) for a, b in zip(jax.tree.leaves(one), jax.tree.leaves(other), strict=True))


def test_vmap_equals_a_loop():
    rng = np.random.default_rng(6)
    states, actions, env = random_states(rng, 12), rng.integers(2, size=12), cartpole()
    batched = many_steps(env, states, actions, np.float32)
    one = jax.jit(env.step)
    for i in range(12):
        alone = one(jax.random.key(KEY), CartPoleState(*states[i].astype(np.float32), jnp.int32(0)), actions[i])
        for ours, theirs in zip(jax.tree.leaves(alone), jax.tree.leaves(batched), strict=True):
            np.testing.assert_allclose(ours, theirs[i], rtol=1e-6, atol=1e-6)


# Errors


def test_an_unknown_integrator_is_an_error_that_names_the_known_ones():
    with pytest.raises(ValueError, match="integrator: 'rk4' is not one of euler, semi-implicit"):
        cartpole(integrator="rk4")


@pytest.mark.parametrize("name", ["dtype", "obs_dtype"])
def test_float64_without_x64_is_an_error_that_says_what_to_do(name):
    with pytest.raises(ValueError, match=rf"^{name}: float64 needs .*jax_enable_x64"):
        cartpole(**{name: np.float64})


@pytest.mark.parametrize("dtype", [np.int32, np.float16, jnp.bfloat16])
@pytest.mark.parametrize("name", ["dtype", "obs_dtype"])
def test_a_dtype_that_is_not_a_float_of_32_or_64_bits_is_an_error(name, dtype):
    with pytest.raises(ValueError, match=rf"^{name}: .* is not one of float32, float64"):
        cartpole(**{name: dtype})


def test_make_knows_names_physics_and_options():
    assert "CartPole-v1" in envs.names()
    env = envs.make("CartPole-v1", gravity=1.6, integrator="semi-implicit", sutton_barto_reward=True)
    same = cartpole(CartPoleParams(gravity=1.6), integrator="semi-implicit", sutton_barto_reward=True)
    other = cartpole()
    states = random_states(np.random.default_rng(7), 10)
    made, by_hand, plain = (many_steps(e, states, [1] * 10, np.float32) for e in (env, same, other))
    np.testing.assert_array_equal(made[1].obs, by_hand[1].obs)
    np.testing.assert_array_equal(made[1].reward, by_hand[1].reward)
    assert not np.array_equal(made[1].obs, plain[1].obs)


def test_make_suggests_the_nearest_name_and_setting():
    with pytest.raises(ValueError, match=r"environment: 'CartPole-v0' is unknown; did you mean 'CartPole-v1'\?"):
        envs.make("CartPole-v0")
    with pytest.raises(TypeError, match=r"CartPole-v1: no setting 'lenght'; did you mean 'length'\?"):
        envs.make("CartPole-v1", lenght=1.0)
    with pytest.raises(TypeError, match=r"no setting 'integrater'; did you mean 'integrator'\?"):
        envs.make("CartPole-v1", integrater="euler")


# Auto-reset


@pytest.fixture(scope="module")
def auto_reset_run():
    """64 environments for 60 steps of random actions, with a limit short enough to truncate."""
    inner = cartpole(CartPoleParams(max_episode_steps=20, reset_low=-0.04))
    env = auto_reset(inner)
    first = jax.vmap(env.reset)(jax.random.split(jax.random.key(KEY), 64))

    def body(state, t):
        action_key, step_key, other_key = jax.random.split(jax.random.fold_in(jax.random.key(KEY + 1), t), 3)
        action = jax.random.randint(action_key, (64,), 0, 2)
        after, happened = jax.vmap(env.step)(jax.random.split(step_key, 64), state, action)
        true_after, true_happened = jax.vmap(inner.step, in_axes=(None, 0, 0))(other_key, state, action)
        return after, (after, happened, true_after, true_happened, jax.vmap(env.observe)(after))

    return jax.jit(lambda state: jax.lax.scan(body, state, jnp.arange(60))[1])(first)


def test_auto_reset_keeps_the_true_successor(auto_reset_run):
    _, happened, _, true_happened, _ = auto_reset_run
    for ours, true in zip(happened, true_happened, strict=True):
        np.testing.assert_array_equal(ours, true)


def test_auto_reset_starts_anew_exactly_where_an_episode_ended(auto_reset_run):
    after, happened, true_after, _, observed = auto_reset_run
    over = np.asarray(happened.terminated | happened.truncated)
    only_terminated = np.asarray(happened.terminated & ~happened.truncated)
    only_truncated = np.asarray(happened.truncated & ~happened.terminated)
    assert only_terminated.any()
    assert only_truncated.any()
    np.testing.assert_array_equal(np.asarray(after.t) == 0, over)
    for ours, true in zip(after, true_after, strict=True):
        np.testing.assert_array_equal(np.asarray(ours)[~over], np.asarray(true)[~over])
    np.testing.assert_array_equal(np.asarray(observed)[~over], np.asarray(happened.obs)[~over])
    fresh = np.asarray(observed)[over]
    assert np.all((fresh >= np.float32(-0.04)) & (fresh <= np.float32(0.05)))
    assert not np.any(np.all(fresh == np.asarray(happened.obs)[over], axis=-1))
    assert len(np.unique(fresh[:, 0])) == len(fresh)  # every reset draws its own state


def test_auto_reset_keeps_the_shape_of_the_environment():
    env = envs.discretise(cartpole(), envs.tutorial_edges([-1.0] * 4, [1.0] * 4, (1, 2, 3, 1)))
    wrapped = auto_reset(env)
    for name in ("num_actions", "obs_shape", "num_states"):
        assert getattr(wrapped, name) == getattr(env, name)


def test_a_deterministic_environment_draws_nothing_in_a_step():
    env = cartpole()
    assert env.deterministic
    state = env.reset(jax.random.key(KEY))
    first, second = (env.step(jax.random.key(seed), state, jnp.int32(1)) for seed in (1, 2))
    jax.tree.map(np.testing.assert_array_equal, first, second)
    wrapped = auto_reset(cartpole(CartPoleParams(max_episode_steps=1)))
    assert not wrapped.deterministic
    resets = [wrapped.step(jax.random.key(seed), state, jnp.int32(1))[0].x for seed in (1, 2)]
    assert resets[0] != resets[1]


def test_auto_reset_gives_step_and_reset_keys_of_their_own():
    def step(key, state, action):
        return state, Step(jax.random.uniform(key), jnp.float32(1), jnp.array(False), jnp.array(True))

    env = Env(jax.random.uniform, step, lambda state: state, num_actions=2, obs_shape=())
    fresh, happened = auto_reset(env).step(jax.random.key(KEY), jnp.float32(0), jnp.int32(0))
    assert fresh != happened.obs
