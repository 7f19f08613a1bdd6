"""brax, both ways: its wrappers on our environments, its pendulum under ours."""

import functools
import subprocess
import sys
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxq
from jaxq import envs, prng, sources
from jaxq.envs import CartPoleState, time_limit
from jaxq.interop import brax
from jaxq.types import Env, Step


def quiet_import(name):
    """A module of brax's; warnings are errors in tests, and its own imports warn."""
    import importlib
    import warnings

    brax._brax()
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        return importlib.import_module(name)


@pytest.fixture(scope="module")
def wrappers():
    return quiet_import("brax.envs.wrappers.training")


def test_nothing_of_brax_is_imported_unasked_and_its_chatter_never_reaches_stdout():
    code = """
import sys
import jaxq.interop.brax as b
assert "brax" not in sys.modules
from jaxq import envs
env = b.to_brax(envs.make("CartPole-v1"))
assert "brax" in sys.modules
"""
    done = subprocess.run([sys.executable, "-W", "error", "-c", code], capture_output=True, text=True)
    assert (done.returncode, done.stdout, done.stderr) == (0, "", "")


# Ours for brax


def test_an_action_is_cut_into_equal_bins():
    actions = jnp.linspace(-1, 1, 6001)
    for count in (2, 3, 5):
        found = np.asarray(brax.binned(actions, count))
        assert np.all(np.diff(found) >= 0)
        np.testing.assert_allclose(np.bincount(found) / 6001, 1 / count, atol=1e-3)
    assert np.asarray(brax.binned(jnp.array([-9.0, 9.0]), 4)).tolist() == [0, 3]


def test_a_brax_step_is_our_step():
    env, pure = brax.to_brax(envs.make("CartPole-v1")), envs.make("CartPole-v1")
    assert (env.observation_size, env.action_size) == (4, 1)
    state = env.reset(jax.random.PRNGKey(3))
    ours = state.pipeline_state
    step, plain = jax.jit(env.step), jax.jit(pure.step)
    for k in range(30):
        action = np.float32((-1) ** (k // 2) * 0.5)
        state = step(state, jnp.array([action]))
        ours, happened = plain(jax.random.key(0), ours, int(action > 0))
        np.testing.assert_allclose(state.obs, happened.obs, rtol=1e-6)
        assert (float(state.reward), float(state.done)) == (float(happened.reward), float(happened.terminated))
    one_hot = brax.to_brax(envs.make("FrozenLake-v1"))
    assert one_hot.observation_size == 16
    assert one_hot.reset(jax.random.key(0)).obs.tolist() == [1.0] + [0.0] * 15


def test_keys_of_every_family_reset_it_and_none_is_used_twice():
    class Drawn(NamedTuple):
        drawn: jax.Array

    def drawn(key, *_):
        state = Drawn(jax.random.bits(key, (), jnp.uint32))
        return state if not _ else (state, Step(state.drawn, jnp.zeros(()), jnp.zeros((), bool), jnp.zeros((), bool)))

    env = brax.to_brax(Env(drawn, drawn, lambda state: state.drawn, num_actions=2, obs_shape=()))
    step, seen = jax.jit(env.step), []
    for key in (jax.random.PRNGKey(1), jax.random.key(2), jax.random.key(3, impl="rbg"), prng.key(4, "pcg4d")):
        state = jax.jit(env.reset)(key)
        for _ in range(4):
            seen.append(int(state.pipeline_state.drawn))
            state = step(state, jnp.zeros(1))
    assert len(set(seen)) == 16


def test_wide_floats_run_under_braxs_wrappers(wrappers):
    with jax.enable_x64(True):
        env = wrappers.wrap(brax.to_brax(envs.make("CartPole-v1")), episode_length=5, action_repeat=1)
        state = jax.jit(env.reset)(jax.random.split(jax.random.PRNGKey(0), 2))
        state = jax.jit(lambda s: jax.lax.scan(lambda c, _: (env.step(c, jnp.zeros((2, 1))), None), s, length=3)[0])(
            state
        )
        assert state.obs.dtype == state.reward.dtype == np.float64


def test_chance_goes_on_after_braxs_auto_reset(wrappers):
    env = wrappers.AutoResetWrapper(wrappers.EpisodeWrapper(brax.to_brax(envs.make("FrozenLake-v1")), 4, 1))
    state = jax.jit(env.reset)(jax.random.PRNGKey(0))
    step, seen = jax.jit(env.step), []
    for _ in range(40):
        state = step(state, jnp.array([0.1]))
        seen.append(int(state.obs.argmax()))
    episodes = [tuple(seen[i : i + 4]) for i in range(0, 40, 4)]
    assert len(set(episodes)) > 3


def test_braxs_wrappers_tell_a_truncation_from_a_termination(wrappers):
    env = wrappers.wrap(brax.to_brax(envs.make("CartPole-v1")), episode_length=9, action_repeat=1)
    state = jax.jit(env.reset)(jax.random.split(jax.random.PRNGKey(0), 3))
    falling = CartPoleState(*(jnp.full(3, x, jnp.float32) for x in (0.0, 0.0, 0.0, 0.0)), jnp.zeros(3, jnp.int32))
    falling = falling._replace(theta_dot=jnp.float32([0.0, 3.0, 0.0]))
    state = state.replace(pipeline_state=falling)
    step, rows = jax.jit(env.step), []
    for k in range(9):
        state = step(state, jnp.full((3, 1), (-1.0) ** k))
        rows.append((np.asarray(state.done), np.asarray(state.info["truncation"])))
    done, truncation = (np.array(column) for column in zip(*rows, strict=True))
    first = done.argmax(0)
    assert first[0] == first[2] == 8
    assert first[1] < 8
    assert truncation[8, 0] == truncation[8, 2] == 1
    assert truncation[first[1], 1] == 0
    own = brax.to_brax(time_limit(envs.make("CartPole-v1"), 2))
    state = own.reset(jax.random.key(0))
    flags = []
    for _ in range(2):
        state = own.step(state, jnp.array([0.0]))
        flags.append((float(state.done), float(state.info["truncation"])))
    assert flags == [(0, 0), (0, 1)]  # done is the MDP's end alone
    both = brax.to_brax(
        Env(
            lambda key: 0,
            lambda key, *_: (0, Step(jnp.zeros(1), jnp.ones(()), *[jnp.array(True)] * 2)),
            lambda state: jnp.zeros(1),
            num_actions=2,
            obs_shape=(1,),
        )
    )
    state = both.step(both.reset(jax.random.key(0)), jnp.zeros(1))
    assert (float(state.done), float(state.info["truncation"])) == (1, 0)


# brax's for us


@pytest.fixture(scope="module")
def pendulum():
    return brax.from_brax("inverted_pendulum", bins=3, episode_length=5)


def test_braxs_pendulum_moves_as_brax_moves_it(pendulum):
    with brax._without_warnings():
        theirs = brax._brax().get_environment("inverted_pendulum", backend="generalized")
        state = jax.jit(theirs.reset)(jax.random.key(1))
        step = jax.jit(theirs.step)
    ours = jax.jit(pendulum.reset)(jax.random.key(1))
    np.testing.assert_allclose(pendulum.observe(ours), state.obs, atol=1e-7)
    mine, ended = jax.jit(pendulum.step), 0
    assert (pendulum.num_actions, pendulum.obs_shape) == (3, (4,))
    for k in range(25):
        action = (0, 2, 1)[k % 3]
        with brax._without_warnings():
            state = step(state, jnp.array([action - 1.0]))
        ours, happened = mine(jax.random.key(0), ours, action)
        np.testing.assert_allclose(happened.obs, state.obs, rtol=1e-4, atol=1e-5)
        assert float(happened.reward) == float(state.reward)
        assert bool(happened.terminated) == (float(state.done) > 0)
        assert bool(happened.truncated) == (k >= 4)
        ended += bool(happened.terminated)
    assert 0 < ended < 25


def test_it_is_an_environment_for_the_engine():
    """In an environment of brax's without physics, whose episodes have no end of their own."""
    swept = jaxq.sweep(
        "dqn",
        env=brax.world("fast", bins=3),
        **{"env.episode_length": [4, 6]},
        seeds=1,
        hidden=(8,),
        max_env_steps=120,
        learning_starts=64,
        batch_size=16,
        buffer_size=100,
        eval_episodes=2,
        keep_episodes=True,
    )
    assert swept.timing.programs == 1
    for row in swept.lanes.to_pylist():
        lengths = swept.episodes["length"].to_numpy()[swept.episodes["config"].to_numpy() == row["config"]]
        assert len(lengths) == 120 // row["env.episode_length"]
        assert set(lengths) == {row["env.episode_length"]}


def test_a_world_has_the_bins_and_the_backend_it_was_asked_for(monkeypatch):
    asked, right = [], brax._brax().get_environment
    monkeypatch.setattr(brax._brax(), "get_environment", lambda name, **k: asked.append(k) or right("fast", **k))
    assert brax.world("reacher", bins=7, backend="spring")(9).num_actions == 7
    assert asked == [{"backend": "spring"}] * 2


def test_another_version_is_another_environment(monkeypatch):
    before = sources.digest(brax.world("fast"))
    assert before == sources.digest(brax.world("fast"))
    right = brax.metadata.version
    monkeypatch.setattr(brax.metadata, "version", lambda name: "0" if name == "mujoco" else right(name))
    assert sources.digest(brax.world("fast")) != before


class Plane(brax._brax().Env):
    """A point that an action in two dimensions moves; it writes into what it is given, as brax's hopper does."""

    observation_size, action_size, backend = 2, 2, "none"

    def reset(self, rng):
        zero = jnp.zeros(())
        return brax._brax().State(zero, jnp.zeros(2), zero, zero, {"moved": 0.0})

    def step(self, state, action):
        state.metrics.update(moved=1.0)
        return state.replace(obs=state.obs + action)


def test_several_dimensions_are_a_product_and_a_state_that_was_left_stays_as_it_was():
    env = brax.from_brax(Plane(), bins=3, episode_length=2)
    assert env.num_actions == 9
    start = env.reset(jax.random.key(0))
    reached = [np.asarray(env.step(jax.random.key(0), start, a)[1].obs).tolist() for a in range(9)]
    assert reached == [[x, y] for x in (-1, 0, 1) for y in (-1, 0, 1)]
    assert float(start.env.metrics["moved"]) == 0
    assert float(env.step(jax.random.key(0), start, 0)[0].env.metrics["moved"]) == 1


@pytest.mark.parametrize(
    ("how", "said"),
    [
        ({"env": "inverted_pendulums"}, "env: 'inverted_pendulums' is unknown; did you mean 'inverted_pendulum'?"),
        ({"env": "fast", "bins": 1}, "bins: 1 is not allowed: an integer from 2 to 1000"),
        ({"env": "fast", "bins": 2.5}, "bins: 2.5 is not allowed: an integer from 2 to 1000"),
        ({"env": "halfcheetah", "bins": 5}, "bins: 5 in each of 6 dimensions are 15625 actions: at most 1000"),
        ({"env": "fast", "episode_length": 0}, "episode_length: 0 is not allowed: a whole number from 1 to 2147"),
        (
            {"env": "fast", "episode_length": np.nan},
            "episode_length: nan is not allowed: a whole number from 1 to 2147",
        ),
        (
            {"env": "fast", "episode_length": "10"},
            "episode_length: '10' is not allowed: a whole number from 1 to 2147",
        ),
        ({"env": envs.make("CartPole-v1")}, "is not allowed: a brax environment or its name"),
    ],
)
def test_what_cannot_be_made_is_said(how, said):
    with pytest.raises((ValueError, TypeError), match=r"^\w+: ") as error:
        brax.from_brax(**how)
    assert said in str(error.value)


def test_wrapped_environments_and_lasting_statistics_are_refused(wrappers):
    wrapped = wrappers.AutoResetWrapper(wrappers.EpisodeWrapper(Plane(), 5, 1))
    with pytest.raises(ValueError, match="env: AutoResetWrapper is not allowed: a bare brax environment"):
        brax.from_brax(wrapped)
    with pytest.raises(ValueError, match="env: statistics that outlive an episode are not allowed"):
        brax.to_brax(envs.normalise_observation(envs.make("CartPole-v1")))
    with pytest.raises(TypeError, match=r"env: 'CartPole-v1' is not allowed: a jaxq\.types\.Env"):
        brax.to_brax("CartPole-v1")


def test_braxs_ppo_learns_our_cartpole():
    networks = quiet_import("brax.training.agents.ppo.networks")
    told, small = [], {"policy_hidden_layer_sizes": (16,), "value_hidden_layer_sizes": (16,)}
    options = {"num_envs": 32, "unroll_length": 16, "batch_size": 32, "num_minibatches": 4, "num_updates_per_batch": 4}
    options |= {"episode_length": 500, "num_evals": 2, "num_eval_envs": 32, "learning_rate": 3e-3}
    options |= {"entropy_cost": 0.01, "discounting": 0.99, "normalize_observations": True}
    with jax.debug_key_reuse(False):  # brax uses a key twice
        make_policy, params, metrics = brax.ppo(
            envs.make("CartPole-v1"),
            eval_env=envs.make("CartPole-v1"),
            num_timesteps=30_000,
            network_factory=functools.partial(networks.make_ppo_networks, **small),
            progress_fn=lambda steps, metrics: told.append((steps, float(metrics["eval/episode_reward"]))),
            **options,
        )
        (_, before), (steps, after) = told
        assert steps >= 30_000
        assert after == float(metrics["eval/episode_reward"])
        assert 9 < before < 40  # a policy that nobody has trained
        assert after > 1.5 * before
        action, _ = make_policy(params, deterministic=True)(jnp.zeros((1, 4)), jax.random.key_data(jax.random.key(0)))
        assert action.shape == (1, 1)
    assert not hasattr(jax, "device_put_replicated")  # brax's modules alone have it


def test_an_option_that_braxs_ppo_has_not_is_said():
    with pytest.raises(TypeError, match="num_timestep: brax's PPO has no such option; did you mean 'num_timesteps'"):
        brax.ppo(envs.make("CartPole-v1"), num_timestep=3)
