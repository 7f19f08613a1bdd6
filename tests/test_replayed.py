"""Saved policies played again: in Gymnasium from the same states, and beside what they promise."""

from types import SimpleNamespace

import jax
import jax.numpy as jnp
import numpy as np
import probes
import pytest

import jaxq
from jaxq import envs, programs, replayed
from jaxq.envs import CartPoleState
from jaxq.interop import gymnasium
from jaxq.presets import preset, settle
from jaxq.saved_policy import SavedPolicy
from jaxq.worlds import CartPole, World

pytestmark = pytest.mark.usefixtures("programs_are_compiled_once")

#: Pushes towards where the pole falls: it holds for a while, and then does not.
TOWARDS = SavedPolicy(
    {"kind": "mlp", "layers": ["only"]},
    {
        "only.kernel": np.array([[0, 0.1], [0, 0.3], [0, 1.0], [0, 0.4]], np.float32),
        "only.bias": np.zeros(2, np.float32),
    },
)


def linear(**numbers):
    """A sweep whose policy is ``TOWARDS``, as the network without hidden layers that it is."""
    settings = settle(preset("dqn"), hidden=(), **{f"env.{name}": value for name, value in numbers.items()})
    weights = {f"params.Linear_0.{name}": TOWARDS.weights[f"only.{name}"] for name in ("kernel", "bias")}
    about = {"kind": "mlp", "layers": ["params.Linear_0"]}
    return SimpleNamespace(settings=lambda _: settings, policy=lambda config, seed=0: SavedPolicy(about, weights))


@pytest.mark.parametrize(
    "numbers",
    [{}, {"length": 0.25}, {"gravity": 20.0, "masspole": 0.3}, {"integrator": "semi-implicit"}, {"tau": 0.03}]
    + [{"max_episode_steps": 30}, {"force_mag": 5.0, "masscart": 2.0}, {"x_threshold": 0.5}]
    + [{"sutton_barto_reward": True, "theta_threshold_radians": 0.1}],
    ids=str,
)
def test_gymnasium_gives_the_same_returns_from_the_same_states(numbers):
    sweep = linear(**numbers)
    played = replayed.play(sweep, 0, 0, episodes=20)
    returns = gymnasium.greedy_returns(sweep.settings(0).env, sweep.policy(0), played.starts)
    # float32 beside float64: a push at a state where both actions are worth the same may differ
    assert (returns == played.returns).mean() >= 0.8
    np.testing.assert_allclose(returns.mean(), played.returns.mean(), rtol=0.05, atol=0.05)


CHANGES = {"gravity": 30.0, "masscart": 3.0, "masspole": 1.0, "length": 0.05, "force_mag": 3.0, "tau": 0.05}


@pytest.mark.parametrize("name", CHANGES)
def test_each_number_of_the_physics_is_gymnasiums_too(name):
    start, ends = np.array([0.1, -0.2, 0.05, 0.3]), []
    for numbers in ({}, {name: CHANGES[name]}):
        theirs = gymnasium.make(CartPole(**numbers))
        theirs.reset(seed=0)
        theirs.unwrapped.state = start.copy()
        ours = envs.make("CartPole-v1", **numbers)
        state = CartPoleState(*map(jnp.float32, start), jnp.int32(0))
        for action in (1, 0, 1):
            obs, *_ = theirs.step(action)
            state, happened = ours.step(jax.random.key(0), state, jnp.int32(action))
        np.testing.assert_allclose(happened.obs, obs, rtol=1e-4, atol=1e-5)
        ends.append(obs)
    assert not np.allclose(*ends, rtol=1e-3)


@pytest.mark.parametrize(("name", "value"), [("x_threshold", 0.05), ("theta_threshold_radians", 0.04)])
def test_a_threshold_ends_an_episode_in_gymnasium_too(name, value):
    starts = CartPoleState(*np.full((4, 1), 0.045), np.zeros(1, int))
    assert gymnasium.greedy_returns(CartPole(**{name: value}), TOWARDS, starts) < 20
    assert gymnasium.greedy_returns(CartPole(), TOWARDS, starts) == 500


def test_a_world_that_gymnasium_has_none_of_is_named():
    with pytest.raises(ValueError, match="env: Gymnasium has no"):
        gymnasium.make(type("Other", (World,), {"id": "Other-v0", "__module__": __name__})())


def test_starts_depend_on_neither_training_nor_evaluation_and_differ():
    def starts(**how):
        return np.stack(replayed.play(linear(), 0, 0, episodes=5, **how).starts[:4], -1)

    first, again = (starts() for _ in range(2))
    np.testing.assert_array_equal(first, again)
    assert len(np.unique(first, axis=0)) == 5
    assert not np.array_equal(first, starts(root_seed=1))


def test_lanes_of_a_structure_are_played_by_one_program_each_with_its_own_numbers_and_policy():
    def made(**varied):
        return jaxq.sweep("q-learning", max_episodes=40, stop="none", seeds=2, **varied)

    runs = made(**{"env.length": [0.5, 2.0]})
    before = replayed._game.cache_info().misses
    played = [replayed.play(runs, config, seed, 7).returns for config in (0, 1) for seed in (0, 1)]
    assert replayed._game.cache_info().misses == before + 1
    assert len({tuple(one) for one in played}) == 4
    alone = made(**{"env.length": [2.0]})
    replayed._game.cache_clear()
    np.testing.assert_array_equal(replayed.play(alone, 0, 1, 7).returns, played[3])


@pytest.mark.parametrize("truncates", [False, True])
def test_what_followed_is_the_discounted_return_beyond_a_truncation_and_not_beyond_a_termination(
    monkeypatch, truncates
):
    gamma, length, steps = 0.8, 7, 5
    env = probes.counter(length, truncates=truncates)
    made = programs.Played(env, env, agent=None)
    played = replayed.LanePlayed(made, lambda obs: jnp.stack([obs, -obs]) * 1.0, None, None)
    monkeypatch.setattr(replayed, "lane", lambda *lane, endless: played)
    sweep = SimpleNamespace(settings=lambda _: SimpleNamespace(gamma=gamma))
    found = replayed.follow(sweep, 0, 0, episodes=1, steps=steps)
    np.testing.assert_array_equal(found.predicted, range(steps))  # the counter's observation is its step
    beyond = int(np.ceil(np.log(0.01) / np.log(gamma)))
    ends = steps + beyond if truncates else length
    wanted = [sum(gamma**k for k in range(ends - t)) for t in range(steps)]
    np.testing.assert_allclose(found.followed, wanted, rtol=1e-6)


def test_promises_of_a_trained_table_are_kept(tmp_path):
    runs = jaxq.sweep("q-learning", seeds=1, gamma=0.9)
    found = replayed.follow(runs, 0, 0, episodes=3)
    assert len(found.predicted) == 3 * 500
    assert abs((found.predicted - found.followed).mean()) < 1
