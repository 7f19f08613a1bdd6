"""Wrappers do what Gymnasium's of the same name do, over several episodes, and compose."""

import contextlib
from dataclasses import replace

import gymnasium
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from gymnasium import wrappers
from scipy import stats

import jaxq
from jaxq import envs, recording, replayed
from jaxq.envs import (
    auto_reset,
    finite_mdp,
    frame_history,
    normalise_observation,
    normalise_reward,
    one_hot,
    random_mdp,
    scale_reward,
    sticky_actions,
    time_limit,
)
from jaxq.envs.mdp import MDPState
from jaxq.envs.moments import Moments, no_moments, seen
from jaxq.envs.normalise import NormalisedState
from jaxq.envs.probes import both
from jaxq.saved_policy import lasting_state

pytestmark = pytest.mark.usefixtures("programs_are_compiled_once")


def precision(dtype):
    return jax.enable_x64(True) if dtype == np.float64 else contextlib.nullcontext()


def beside(wrap, gym_wrap, dtype=np.float32, steps=150, restarts=True):
    """Our wrapper and Gymnasium's over CartPole, from the same starts with the same actions: rows of both."""
    theirs = gym_wrap(gymnasium.make("CartPole-v1", max_episode_steps=23))
    rng, rows = np.random.default_rng(0), []
    with precision(dtype):
        env = wrap(envs.make("CartPole-v1", max_episode_steps=23, dtype=dtype, obs_dtype=dtype))
        step = jax.jit(env.step)
        begin = jax.jit(env.restart or (lambda key, state: env.reset(key)))
        key, state, over = jax.random.key(0), None, True
        for t in range(steps):
            if over:
                key, reset_key = jax.random.split(key)
                state = env.reset(reset_key) if state is None else begin(reset_key, state)
                inner = state
                while hasattr(inner, "env"):
                    inner = inner.env
                start = np.array(inner[:4], np.float64)
                obs = put(theirs, start, seed=t)
                rows.append((np.asarray(env.observe(state)), obs, None, None))
            action = int(rng.integers(2))
            key, step_key = jax.random.split(key)
            state, happened = step(step_key, state, action)
            obs, reward, terminated, truncated, _ = theirs.step(action)
            assert (bool(happened.terminated), bool(happened.truncated)) == (terminated, truncated)
            over = terminated or truncated
            rows.append((np.asarray(happened.obs), obs, float(happened.reward), reward))
    assert sum(row[2] is None for row in rows) > 4
    return rows


def put(env, start, seed):
    """Resets Gymnasium's environment to a start of ours, seen by all its wrappers."""
    bare = env.unwrapped
    reset = type(bare).reset

    def ours(*, seed=None, options=None):
        reset(bare, seed=seed, options=options)
        bare.state = start
        return start.astype(np.float32), {}

    bare.reset = ours
    try:
        return env.reset(seed=seed)[0]
    finally:
        del bare.reset


@pytest.mark.parametrize(("dtype", "tolerance"), [(np.float64, 2e-4), (np.float32, 2e-3)])
def test_normalised_observations_are_gymnasiums(dtype, tolerance):
    """Gymnasium keeps its moments in float32, so its own roundings are the bound."""
    rows = beside(normalise_observation, wrappers.NormalizeObservation, dtype)
    for ours, theirs, *_ in rows:
        np.testing.assert_allclose(ours, theirs, rtol=tolerance, atol=tolerance)
    assert np.abs(rows[-1][0]).max() < 10
    assert np.abs(rows[0][0]).max() < 1e-2  # the first observation is its own mean


@pytest.mark.parametrize(("dtype", "tolerance"), [(np.float64, 1e-12), (np.float32, 1e-4)])
def test_normalised_rewards_are_gymnasiums(dtype, tolerance):
    rows = beside(lambda env: normalise_reward(env, 0.9), lambda env: wrappers.NormalizeReward(env, gamma=0.9), dtype)
    pairs = [(ours, theirs) for _, _, ours, theirs in rows if ours is not None]
    np.testing.assert_allclose(*zip(*pairs, strict=True), rtol=tolerance)
    assert np.ptp([ours for ours, _ in pairs]) > 0.1


@pytest.mark.parametrize("padding", ["reset", "zero"])
def test_histories_are_gymnasiums(padding):
    rows = beside(
        lambda env: frame_history(env, 4, padding=padding),
        lambda env: wrappers.FrameStackObservation(env, 4, padding_type=padding),
    )
    for ours, theirs, *_ in rows:
        np.testing.assert_allclose(ours, theirs, atol=1e-6)


def test_a_history_over_a_tower_is_gymnasiums():
    rows = beside(
        lambda env: normalise_observation(frame_history(scale_reward(env, 0.5), 2)),
        lambda env: wrappers.NormalizeObservation(
            wrappers.FrameStackObservation(wrappers.TransformReward(env, lambda r: 0.5 * r), 2)
        ),
    )
    for ours, theirs, reward, expected in rows:
        np.testing.assert_allclose(ours, theirs, rtol=2e-3, atol=2e-3)
        assert reward == expected


def test_statistics_outlive_an_episode_under_auto_reset():
    env = auto_reset(normalise_observation(envs.make("CartPole-v1")))
    plain = auto_reset(envs.make("CartPole-v1"))

    def body(carry, words):
        state, bare = carry
        (after, happened), (bare, seen_) = (
            one.step(jax.random.wrap_key_data(words), held, 1) for one, held in ((env, state), (plain, bare))
        )
        return (after, bare), (happened.terminated, seen_.obs, plain.observe(bare))

    key = jax.random.key(0)
    first = env.reset(key), plain.reset(jax.random.key(0))
    words = jax.random.key_data(jax.random.split(jax.random.key(1), 60))
    with jax.debug_key_reuse(False):  # the same words step both on purpose
        (state, _), (over, successors, nexts) = jax.lax.scan(body, first, words)
    over = np.asarray(over)
    assert over.sum() > 4
    counted = [np.asarray(plain.observe(first[1]))]
    for i in range(60):
        counted.append(np.asarray(successors[i]))
        if over[i]:
            counted.append(np.asarray(nexts[i]))  # a new episode's first observation counts, as in Gymnasium
    counted = np.array(counted, float)
    assert float(state.moments.weight) == pytest.approx(len(counted), abs=1e-3)
    np.testing.assert_allclose(state.moments.mean, counted.mean(0), rtol=1e-3, atol=1e-4)
    np.testing.assert_allclose(state.moments.variance, counted.var(0), rtol=1e-2, atol=1e-4)


def test_moments_are_those_of_numpy():
    values = np.random.default_rng(0).normal(3, 2, (500, 2))
    with jax.enable_x64(True):
        held = no_moments((2,), np.float64)._replace(weight=jnp.zeros(()))
        for value in values:
            held = seen(held, value)
    np.testing.assert_allclose(held.mean, values.mean(0), rtol=1e-12)
    np.testing.assert_allclose(held.variance, values.var(0), rtol=1e-12)


def test_held_statistics_stay_and_are_what_a_policy_is_evaluated_with():
    trained = no_moments((4,))._replace(mean=jnp.arange(4.0), variance=jnp.full(4, 4.0))
    env = normalise_observation(envs.make("CartPole-v1"), moments=trained, update=False)
    state = env.reset(jax.random.key(0))
    after, happened = env.step(jax.random.key(1), state, 0)
    jax.tree.map(np.testing.assert_array_equal, after.moments, trained)
    np.testing.assert_allclose(happened.obs, (np.array(after.env[:4]) - np.arange(4)) / 2, rtol=1e-6)
    rewards = normalise_reward(
        envs.make("CartPole-v1"), moments=no_moments()._replace(variance=jnp.array(0.25)), update=False
    )
    assert float(rewards.step(jax.random.key(1), rewards.reset(jax.random.key(0)), 0)[1].reward) == pytest.approx(2)


def test_sticky_actions_stick_as_often_as_they_should():
    """On MountainCar the action shows in the velocity. Gymnasium's wrapper repeats just so."""
    env = sticky_actions(envs.make("MountainCar-v0", max_episode_steps=10**6), 0.3)

    def body(state, words):
        choose, act = jax.random.split(jax.random.wrap_key_data(words))
        action = jax.random.randint(choose, (), 0, 3)
        after, _ = env.step(act, state, action)
        return after, (action, after.action, state.action)

    words = jax.random.key_data(jax.random.split(jax.random.key(1), 6000))
    _, (given, taken, before) = jax.lax.scan(body, env.reset(jax.random.key(0)), words)
    given, taken, before = (np.asarray(x) for x in (given, taken, before))
    assert before[0] == -1
    assert taken[0] == given[0]
    told = (given != before)[1:]
    stuck = (taken == before)[1:][told]
    assert stats.binomtest(int(stuck.sum()), len(stuck), 0.3).pvalue > 1e-3
    assert np.all((taken == given) | (taken == before))
    gym = wrappers.StickyAction(gymnasium.make("MountainCar-v0"), 0.999999999)
    gym.reset(seed=0)
    always = sticky_actions(envs.make("MountainCar-v0"), 1.0)
    state = always.reset(jax.random.key(0))
    gym.unwrapped.state = np.array([float(state.env.position), 0.0])
    for t, action in enumerate((2, 0, 1, 0)):
        obs, *_ = gym.step(action)
        state, happened = always.step(jax.random.key(t), state, action)
        np.testing.assert_allclose(happened.obs, obs, atol=1e-6)


def test_a_time_limit_keeps_an_inner_one_and_both_flags_may_be_true():
    env = time_limit(envs.make("CartPole-v1", max_episode_steps=3), 5)
    flags, state = [], env.reset(jax.random.key(0))
    for t in range(6):
        state, happened = env.step(jax.random.key(t), state, t % 2)
        flags.append(bool(happened.truncated))
    assert flags == [False, False, True, True, True, True]
    falling = envs.CartPoleState(*jnp.float32([2.39, 3, 0, 0]), jnp.int32(0))
    limited = time_limit(envs.make("CartPole-v1"), 1)
    both = limited.step(jax.random.key(0), limited.reset(jax.random.key(0))._replace(env=falling), 1)[1]
    assert bool(both.terminated)
    assert bool(both.truncated)


def test_numbers_of_wrappers_may_be_traced_and_batched():
    def one(limit, probability, scale, gamma):
        env = time_limit(sticky_actions(scale_reward(envs.make("CartPole-v1"), scale), probability), limit)
        env = normalise_reward(env, gamma, update=False)
        reset_key, step_key = jax.random.split(jax.random.key(0))
        return env.step(step_key, env.reset(reset_key), 1)[1]

    happened = jax.vmap(one)(jnp.array([1, 2]), jnp.array([0.0, 1.0]), jnp.array([2.0, 3.0]), jnp.array([0.5, 0.9]))
    assert np.asarray(happened.truncated).tolist() == [True, False]
    np.testing.assert_allclose(happened.reward, [2, 3], rtol=1e-6)


def test_a_wrapped_world_trains():
    def make_env(scale=0.1, probability=0.1, length=0.5):
        env = envs.make("CartPole-v1", length=length)
        return frame_history(sticky_actions(scale_reward(normalise_observation(env), scale), probability), 2)

    swept = jaxq.sweep(
        "dqn",
        env=make_env,
        **{"env.scale": [0.1, 0.2]},
        seeds=2,
        max_env_steps=2000,
        hidden=(8,),
        learning_starts=64,
        batch_size=16,
        eval_episodes=2,
    )
    assert swept.timing.programs == 1
    returns = np.array(swept.lanes["final_return"].to_pylist()).reshape(2, 2)
    assert np.all(returns[0] > 0.5)
    assert 1.2 < returns[1].mean() / returns[0].mean() < 3  # the reward's scale is in the return


def far_away(distance=50.0):
    """Which of two actions earns 1, and which -1, only the last of many digits tells."""
    env = both()

    def seen(state):
        return (state.s + jnp.float32(distance))[None]

    def step(key, state, action):
        after, happened = env.step(key, state, action)
        return after, happened._replace(obs=seen(after))

    moved = replace(env, step=step, observe=seen, obs_shape=(1,), num_states=None)
    return time_limit(normalise_observation(moved), 5)


@pytest.mark.parametrize("num_envs", [1, 3])
def test_a_policy_is_evaluated_and_played_with_the_statistics_it_was_trained_with(tmp_path, num_envs):
    # With statistics of nothing every first observation is 0: nobody could do better than by chance.
    swept = jaxq.sweep(
        "dqn",
        env=far_away,
        seeds=2,
        num_envs=num_envs,
        max_env_steps=3000,
        hidden=(16,),
        learning_rate=1e-2,
        learning_starts=64,
        batch_size=16,
        eval_episodes=10,
        out=tmp_path / "run",
    )
    earned = swept.lanes["eval_return"].to_pylist()
    assert earned == [1, 1]
    for outcome in (swept, jaxq.load(tmp_path / "run", env=far_away)):
        assert np.all(replayed.play(outcome, 0, 1, 50).returns == 1)
        assert recording.returns(recording.play(outcome, 0, 1, 20, 10)) == [1] * 20
        assert np.all(replayed.follow(outcome, 0, 1, 20, 5).followed == 1)
        weights = outcome.policy(0, 1).weights
        assert weights["env.env.moments.mean"] == pytest.approx(50.5, abs=0.2)
        assert set(weights) > {"env.t", "env.env.moments.variance", "params.Linear_1.kernel"}


def normal_cartpole(length=0.5):
    env = time_limit(envs.make("CartPole-v1", length=length), 20)
    return sticky_actions(normalise_observation(env), 0.1)


normal_cartpole.bounds, normal_cartpole.buckets = ((-2.0, 2.0),) * 4, (2, 2, 3, 3)


def test_statistics_are_those_at_the_end_of_the_training_and_not_of_the_segment_it_ended_in():
    swept = jaxq.sweep("q-learning", env=normal_cartpole, max_episodes=3, seeds=2, eval_episodes=2)
    for seed in (0, 1):
        row = swept.lanes.to_pylist()[seed]
        weights = swept.policy(0, seed).weights
        assert row["episodes"] == 3
        # Every observation of a step, and the first of each of the four episodes that began.
        assert weights["env.env.moments.weight"] == pytest.approx(row["env_steps"] + 4, abs=1e-3)
        assert set(weights) > {"table", "env.env.env.t"}
        assert replayed.play(swept, 0, seed, 2).returns.max() <= 20


def test_halving_keeps_the_statistics_of_who_is_stopped(tmp_path):
    numbers = {"max_env_steps": 16_000, "stop": "none", "eval_episodes": 2, "halving": 2, "seeds": 1}
    swept = jaxq.sweep("q-learning", env=normal_cartpole, alpha_min=[0.1, 0.2], out=tmp_path / "run", **numbers)
    rows = swept.lanes.to_pylist()
    assert {row["status"] for row in rows} > {"stopped"}
    for row in rows:
        weights = jaxq.load(tmp_path / "run", env=normal_cartpole).policy(row["config"], 0).weights
        weight = weights["env.env.moments.weight"]
        assert row["env_steps"] + 1 < weight < 1.2 * row["env_steps"] + 1


def test_a_state_of_another_tower_is_refused(tmp_path):
    swept = jaxq.sweep("q-learning", env=normal_cartpole, max_episodes=3, eval_episodes=2)
    for other in (normalise_observation(envs.make("CartPole-v1")), sticky_actions(envs.make("CartPole-v1"), 0.1)):
        with pytest.raises(ValueError, match=r"^env: is not that of this run: its state has other parts$"):
            lasting_state(swept.policy(0, 0).weights, jax.eval_shape(other.reset, jax.random.key(0)))


def test_a_sticky_action_is_not_of_the_episode_before():
    env = auto_reset(sticky_actions(normalise_observation(time_limit(both(), 1)), 1.0))
    state = env.reset(jax.random.key(0))
    for k in range(8):  # episodes of one step: with the last action kept none but the first would be free
        state, happened = env.step(jax.random.key(k), state, k % 2)
        assert bool(happened.terminated)
        assert int(state.action) == -1


def test_whole_numbers_are_moments_too():
    cartpole = envs.make("CartPole-v1")
    given = Moments(np.zeros(4, int), np.ones(4, int), 1)
    env = normalise_observation(cartpole, moments=given, update=False)
    state = env.reset(jax.random.key(0))
    np.testing.assert_allclose(env.observe(state), cartpole.observe(state.env), rtol=1e-6)


@pytest.mark.parametrize(
    ("wrap", "said"),
    [
        (lambda env: sticky_actions(env, 1.1), "probability: 1.1 is not allowed: from 0 to 1"),
        (lambda env: sticky_actions(env, float("nan")), "probability: nan is not allowed"),
        (lambda env: time_limit(env, 0), "max_episode_steps: 0 is not allowed"),
        (lambda env: time_limit(env, 2**31), "max_episode_steps: 2147483648 is not allowed"),
        (lambda env: time_limit(env, 2.5), "max_episode_steps: 2.5 is not allowed"),
        (lambda env: scale_reward(env, float("inf")), "scale: inf is not allowed: a finite number"),
        (lambda env: scale_reward(env, 1.0, shift=float("nan")), "shift: nan is not allowed"),
        (lambda env: frame_history(env, 0), "count: 0 is not allowed"),
        (lambda env: frame_history(env, 2.0), "count: 2.0 is not allowed"),
        (lambda env: frame_history(env, 2, padding="one"), "padding: 'one' is not allowed"),
        (lambda env: normalise_reward(env, 1.5), "gamma: 1.5 is not allowed"),
        (lambda env: normalise_reward(env, epsilon=0), "epsilon: 0 is not allowed"),
        (lambda env: normalise_observation(env, epsilon=float("nan")), "epsilon: nan is not allowed"),
    ],
)
def test_what_no_wrapper_can_do_is_refused(wrap, said):
    with pytest.raises(ValueError, match=r"^\w+: ") as error:
        wrap(envs.make("CartPole-v1"))
    assert said in str(error.value)


@pytest.mark.parametrize("normalise", [normalise_observation, normalise_reward])
def test_moments_of_another_shape_are_refused(normalise):
    env = normalise(envs.make("CartPole-v1"), moments=no_moments((3,)))
    with pytest.raises(ValueError, match=r"^moments: mean of shape \(3,\) is not allowed: \((4,)?\)$"):
        env.reset(jax.random.key(0))


def test_numbers_of_numpy_and_of_a_trace_are_taken():
    assert frame_history(envs.make("CartPole-v1"), np.int64(3)).obs_shape == (3, 4)

    @jax.jit
    def first(epsilon):
        env = normalise_observation(envs.make("CartPole-v1"), epsilon=epsilon)
        return env.observe(env.reset(jax.random.key(0)))

    small, large = first(1e-8), first(1e8)
    assert np.all(np.abs(large) < 1e-3 * np.abs(small))


def test_one_hot_has_a_place_for_every_state():
    mdp = random_mdp(np.random.default_rng(0), 5, 2)
    env = one_hot(finite_mdp(mdp.transition, mdp.reward, mdp.start))
    observed = jax.vmap(lambda s: env.observe(MDPState(s, jnp.int32(0))))(jnp.arange(5))
    np.testing.assert_array_equal(observed, np.eye(5))
    _, happened = env.step(jax.random.key(0), MDPState(jnp.int32(1), jnp.int32(0)), 0)
    assert happened.obs.sum() == 1
    with pytest.raises(ValueError, match="one_hot needs integer observations"):
        one_hot(envs.make("CartPole-v1"))


def test_a_state_says_what_it_holds():
    state = normalise_observation(envs.make("CartPole-v1")).reset(jax.random.key(0))
    assert isinstance(state, NormalisedState)
    assert state.moments.mean.shape == (4,)


def test_what_a_wrapper_keeps_of_an_episode_it_does_not_keep_beyond_it():
    """Around statistics that last, whose restart is another way into an episode than a reset."""
    lasting = normalise_observation(time_limit(envs.make("CartPole-v1"), 3))
    env = auto_reset(frame_history(sticky_actions(scale_reward(lasting, 2.0, shift=0.5), 0.0), 3))
    state, step = env.reset(jax.random.key(0)), jax.jit(env.step)
    for k in range(3):
        state, happened = step(jax.random.key(k), state, k % 2)
        assert float(happened.reward) == 2.5
    assert bool(happened.truncated)
    first, again, newest = env.observe(state)
    np.testing.assert_array_equal(first, newest)
    np.testing.assert_array_equal(again, newest)
    assert np.any(happened.obs[-1] != newest)
    assert float(state.env.env.moments.weight) > 3  # the statistics did


def test_a_reward_is_moved_by_its_shift():
    env = scale_reward(envs.make("CartPole-v1"), 3.0, shift=-1.0)
    assert float(env.step(jax.random.key(0), env.reset(jax.random.key(0)), 1)[1].reward) == 2.0


@pytest.mark.parametrize(
    "wrap",
    [
        auto_reset,
        lambda env: time_limit(env, 3),
        lambda env: frame_history(env, 2),
        lambda env: sticky_actions(env, 0.1),
        normalise_observation,
        normalise_reward,
    ],
)
def test_nothing_that_watches_episodes_goes_around_auto_reset(wrap):
    inside = scale_reward(auto_reset(envs.make("CartPole-v1")), 2.0)
    with pytest.raises(ValueError, match=r"^env: one that resets by itself is not allowed"):
        wrap(inside)
