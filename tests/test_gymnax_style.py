"""gymnax's calls on ours, and environments with gymnax's calls as ours."""

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxq
from jaxq import envs
from jaxq.interop.gymnax import GymnaxStyle, from_gymnax

pytestmark = pytest.mark.usefixtures("programs_are_compiled_once")


@pytest.mark.parametrize("values", [5, 6])
def test_a_loop_written_for_gymnax_runs(values):
    """As purejaxrl collects experience: environments by vmap over keys, time by scan."""
    env = GymnaxStyle("CartPole-v1", values=values)
    params = env.default_params
    keys = jax.random.split(jax.random.key(0), 8)
    obs, state = jax.vmap(env.reset, in_axes=(0, None))(keys, params)

    def body(carry, words):
        obs, state = carry
        each = jax.random.split(jax.random.wrap_key_data(words), 8)
        action = (obs[:, 2] > 0).astype(jnp.int32)
        out = jax.vmap(env.step, in_axes=(0, 0, 0, None))(each, state, action, params)
        return (out[0], out[1]), out

    words = jax.random.key_data(jax.random.split(jax.random.key(1), 200))
    _, rows = jax.jit(lambda carry: jax.lax.scan(body, carry, words))((obs, state))
    assert len(rows) == values
    info = rows[-1]
    done = np.asarray(rows[3] if values == 5 else rows[3] | rows[4])
    np.testing.assert_array_equal(done, info["terminated"] | info["truncated"])
    assert done.sum() > 8
    final, seen = np.asarray(info["final_observation"]), np.asarray(rows[0])
    # The compiler may compute the same state twice, and round it another way.
    np.testing.assert_allclose(final[~done], seen[~done], rtol=1e-5, atol=1e-6)
    assert np.all(np.abs(final[done][:, 2]) > 0.2)  # fallen
    assert np.all(np.abs(seen[done]) <= 0.05)  # and begun anew
    np.testing.assert_array_equal(info["discount"], 1.0 - np.asarray(info["terminated"]))


@pytest.mark.parametrize("values", [5, 6])
def test_a_time_limit_is_no_end(values):
    env = GymnaxStyle("CartPole-v1", values=values)
    params = env.default_params.replace(max_steps_in_episode=2)
    assert params.max_steps_in_episode == params.max_episode_steps == 2
    obs, state = env.reset(jax.random.key(0), params)
    for k, late in enumerate((False, True)):
        bare = env.step_env(jax.random.key(k), state, k, params)
        obs, after, reward, *flags, info = env.step(jax.random.key(k), state, k, params)
        assert [bool(flag) for flag in flags] == ([late] if values == 5 else [False, late])
        assert (bool(info["terminated"]), bool(info["truncated"]), float(info["discount"])) == (False, late, 1.0)
        assert len(bare) == 5
        assert bool(bare[3]) == (late and values == 5)
        assert (bool(bare[4]["terminated"]), bool(bare[4]["truncated"])) == (False, late)
        assert bool(env.is_truncated(bare[1], params)) == late
        np.testing.assert_allclose(info["final_observation"], bare[0], rtol=1e-6)
        np.testing.assert_array_equal(env.get_obs(after, params), obs)
        assert int(after.t) == (0 if late else k + 1)
        state = after
    assert float(reward) == 1.0


def test_a_reset_has_its_params_and_a_lone_call_is_compiled():
    env = GymnaxStyle("CartPole-v1")
    params = env.default_params.replace(reset_low=0.04, reset_high=0.04)
    obs, _ = env.reset(jax.random.key(0), params)
    np.testing.assert_allclose(obs, 0.04)
    assert isinstance(params, envs.CartPoleParams)
    traced = []
    env._factory = lambda *a, **k: traced.append(1) or envs.registered("CartPole-v1")[0](*a, **k)
    _, state = env.reset(jax.random.key(0))
    before = len(traced)
    for k in range(3):
        state = env.step(jax.random.key(k), state, 1)[1]
        if k == 0:
            before = len(traced)
    assert len(traced) == before


def test_spaces_have_gymnaxs_attributes():
    env = GymnaxStyle("CartPole-v1")
    space, actions = env.observation_space(env.default_params.replace(x_threshold=1.0)), env.action_space()
    assert (space.shape, space.dtype) == ((4,), np.float32)
    assert space.low[0] == -2.0
    assert space.high[0] == 2.0
    assert np.isinf(space.high[1])
    assert space.contains(jnp.zeros(4))
    assert not space.contains(jnp.array([3.0, 0, 0, 0]))
    drawn = jax.vmap(actions.sample)(jax.random.split(jax.random.key(0), 64))
    assert set(drawn.tolist()) == {0, 1}
    assert actions.contains(1)
    assert not actions.contains(2)
    rod = GymnaxStyle("Pendulum-v1").observation_space()
    points = jax.vmap(rod.sample)(jax.random.split(jax.random.key(0), 64))
    assert all(bool(rod.contains(point)) for point in points)
    assert points.std() > 1
    lake = GymnaxStyle("FrozenLake-v1").observation_space()
    assert (lake.n, lake.dtype) == (16, np.int32)
    with jax.enable_x64(True):
        assert GymnaxStyle("MountainCar-v0", obs_dtype=np.float64).observation_space().dtype == np.float64


def test_a_step_without_reset_is_ours_and_params_may_be_batched():
    env = GymnaxStyle("CartPole-v1", integrator="semi-implicit")
    pure = envs.make("CartPole-v1", integrator="semi-implicit", length=0.3)
    obs, state = env.reset_env(jax.random.key(0))
    out = env.step_env(jax.random.key(1), state, 1, env.default_params._replace(length=0.3))
    expected, happened = pure.step(jax.random.key(1), state, 1)
    np.testing.assert_allclose(out[0], happened.obs, rtol=1e-6)
    np.testing.assert_allclose(np.array(out[1]), np.array(expected), rtol=1e-6)
    lengths = jnp.array([0.3, 0.6])
    many = jax.vmap(lambda p: env.step(jax.random.key(1), state, 1, p)[0])(
        env.default_params._replace(
            length=lengths, **{n: jnp.full(2, v) for n, v in env.default_params._asdict().items() if n != "length"}
        )
    )
    np.testing.assert_allclose(many[0], happened.obs, rtol=1e-6)
    assert np.any(many[0] != many[1])
    assert obs.shape == env.observation_space(env.default_params).shape == (4,)
    assert env.action_space().n == env.num_actions == 2
    assert GymnaxStyle("FrozenLake-v1").observation_space().n == 16


def test_what_cannot_be_is_refused():
    with pytest.raises(ValueError, match="did you mean 'CartPole-v1'"):
        GymnaxStyle("CartPole-v0")
    with pytest.raises(ValueError, match="values: 4 is not allowed: 5 or 6"):
        GymnaxStyle("CartPole-v1", values=4)
    with pytest.raises(TypeError, match="CartPole-v1: no option 'intergrator'; did you mean 'integrator'"):
        GymnaxStyle("CartPole-v1", intergrator="euler")


# Environments with gymnax's calls


class Params(NamedTuple):
    max_steps_in_episode: int = 6
    goal: int = 4


class State(NamedTuple):
    place: Any
    time: Any

    def replace(self, **changes):
        return self._replace(**changes)


class Walk:
    """A corridor as gymnax before 1.0 would have it: one flag for both ends, plain numbers in states."""

    name, num_actions = "Walk", 2
    default_params = Params()

    def reset_env(self, key, params):
        return jnp.zeros(1), State(0, 0)

    def step_env(self, key, state, action, params):
        after = State(state.place + 2 * action - 1, state.time + 1)
        return jnp.float32(after.place)[None], after, 1.0, self.is_terminal(after, params), {}

    def is_terminal(self, state, params):
        return (state.place == params.goal) | (state.time >= params.max_steps_in_episode)


class Walk1(Walk):
    """The same as gymnax 1.0 has it."""

    def step_env(self, key, state, action, params):
        obs, after, reward, _, info = super().step_env(key, state, action, params)
        return obs, after, reward, after.place == params.goal, info

    def is_truncated(self, state, params):
        return state.time >= params.max_steps_in_episode


@pytest.mark.parametrize("kind", [Walk, Walk1])
@pytest.mark.parametrize(
    ("actions", "goal", "flags"),
    [
        ([1, 1, 1, 1], 4, [(False, False)] * 3 + [(True, False)]),
        ([1, 0, 1, 0, 1, 0], 4, [(False, False)] * 5 + [(False, True)]),
        ([0, 1, 1, 1, 1, 1], 4, [(False, False)] * 5 + [(True, True)]),
    ],
)
def test_an_end_is_told_from_a_time_limit(kind, actions, goal, flags):
    env = from_gymnax(kind(), Params(goal=goal))
    state, found = env.reset(jax.random.key(0)), []
    for action in actions:
        state, happened = jax.jit(env.step)(jax.random.key(0), state, action)
        found.append((bool(happened.terminated), bool(happened.truncated)))
    assert found == flags
    assert float(happened.obs[0]) == sum(2 * a - 1 for a in actions)  # the true successor


def test_without_a_time_there_is_no_truncation():
    class Bare(Walk):
        default_params = None

        def step_env(self, key, state, action, params):
            return jnp.zeros(1), state, 0.0, True, {}

    happened = from_gymnax(Bare()).step(jax.random.key(0), from_gymnax(Bare()).reset(jax.random.key(0)), 0)[1]
    assert (bool(happened.terminated), bool(happened.truncated)) == (True, False)


@pytest.mark.parametrize("values", [5, 6])
def test_our_own_environment_through_gymnaxs_calls_and_back_has_its_ends(values):
    style = GymnaxStyle("CartPole-v1", values=values)
    env = from_gymnax(style, style.default_params.replace(max_steps_in_episode=3))
    state, found = env.reset(jax.random.key(0)), []
    for k in range(3):
        state, happened = env.step(jax.random.key(k), state, k % 2)
        found.append((bool(happened.terminated), bool(happened.truncated)))
    assert found == [(False, False), (False, False), (False, True)]


def test_integers_are_states():
    lake = from_gymnax(GymnaxStyle("FrozenLake-v1"))
    assert (lake.num_states, lake.obs_shape, lake.num_actions) == (16, (), 4)
    assert from_gymnax(GymnaxStyle("CartPole-v1")).num_states is None


def test_a_wrapper_whose_calls_are_those_of_what_it_wraps_is_refused():
    class Wrapped:
        def __init__(self, env):
            self._env = env

        def __getattr__(self, name):
            return getattr(self._env, name)

    for given in (Wrapped(Walk()), "CartPole-v1", (Walk(), Params())):
        with pytest.raises(TypeError, match=r"^env: \w+ is not allowed: a bare gymnax environment"):
            from_gymnax(given)


def test_a_learner_of_ours_runs_in_it():
    def make_env(goal=2):
        return from_gymnax(Walk1(), Params(max_steps_in_episode=20, goal=goal))

    swept = jaxq.sweep(
        "dqn",
        env=make_env,
        seeds=1,
        hidden=(8,),
        gamma=0.5,
        max_env_steps=300,
        learning_starts=64,
        batch_size=16,
        eval_episodes=2,
        keep_episodes=True,
    )
    lengths = swept.episodes["length"].to_numpy()
    assert 280 < lengths.sum() <= 300
    assert set(lengths) <= {2, 4, 6, 8, 10, 12, 14, 16, 18, 20}  # two steps to the right or more, or the time limit


def test_actions_must_be_discrete():
    class Real(Walk):
        num_actions = None

    with pytest.raises(ValueError, match="env: Walk is not allowed: its actions must be discrete"):
        from_gymnax(Real())
