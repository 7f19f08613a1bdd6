"""Worlds: Gymnasium's numbers, the environments' fields, and functions of the user's own in the same place."""

import functools
import inspect
import math

import gymnasium
import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxq
from jaxq import envs, programs
from jaxq.envs import CartPoleParams, cartpole
from jaxq.interop import gymnasium as interop
from jaxq.plans import plan
from jaxq.presets import preset, settle
from jaxq.tables import OUTCOMES
from jaxq.types import Env, Step
from jaxq.worlds import WORLDS, CartPole, world

pytestmark = pytest.mark.usefixtures("programs_are_compiled_once")

TABLE = {"max_episodes": 40, "seeds": 3, "eval_episodes": 3}


def make_cartpole(
    gravity=9.8,
    masscart=1.0,
    masspole=0.1,
    length=0.5,
    force_mag=10.0,
    tau=0.02,
    theta_threshold_radians=12 * 2 * math.pi / 360,
    x_threshold=2.4,
    max_episode_steps=500,
    reset_low=-0.05,
    reset_high=0.05,
    *,
    integrator="euler",
):
    """The registered environment, as a function of the user's own."""
    numbers = locals()
    return cartpole(CartPoleParams(**{name: numbers[name] for name in CartPoleParams._fields}), integrator=integrator)


def walk(cells=5, goal_reward=1.0, *, slippery=False):
    """A corridor of cells, its last the goal; action 1 goes on, any other back. Slippery: always on."""

    def reset(key):
        del key
        return jnp.zeros((), jnp.int32)

    def step(key, state, action):
        del key
        after = jnp.clip(state + jnp.where((action == 1) | slippery, 1, -1), 0, cells - 1)
        there = after == cells - 1
        return after, Step(after, jnp.where(there, goal_reward, 0.0), there, jnp.array(False))

    return Env(reset, step, lambda state: state, num_actions=2, obs_shape=(), num_states=8)


def test_the_defaults_are_those_of_a_fresh_gymnasium_cartpole():
    env = gymnasium.make("CartPole-v1")
    bare, ours = env.unwrapped, CartPole()
    for name in "gravity masscart masspole length force_mag tau theta_threshold_radians x_threshold".split():
        assert getattr(ours, name) == getattr(bare, name)
    assert ours.max_episode_steps == env.spec.max_episode_steps
    assert CartPole.reward_threshold == env.spec.reward_threshold
    assert CartPole.id == env.spec.id
    assert ours.integrator == bare.kinematics_integrator
    assert ours.sutton_barto_reward == bare._sutton_barto_reward
    starts = np.array([env.reset(seed=seed)[0] for seed in range(300)])
    assert ours.reset_low <= starts.min() < 0.98 * ours.reset_low
    assert 0.98 * ours.reset_high < starts.max() <= ours.reset_high


def test_the_fields_are_the_environments_numbers_and_options():
    ours = CartPole()
    numbers = {name: value for name, value in ours.flat().items() if not ours.is_structure(name)}
    assert numbers == CartPoleParams()._asdict()
    options = {name: value for name, value in ours.flat().items() if ours.is_structure(name)}
    keyword_only = {k: p.default for k, p in inspect.signature(cartpole).parameters.items() if p.kind is p.KEYWORD_ONLY}
    assert options == {name: keyword_only[name] for name in options}
    assert set(keyword_only) - set(options) == {"dtype", "obs_dtype"}
    assert all(info.description for info in ours.fields().values())


def test_the_worlds_are_the_environments():
    assert sorted(WORLDS) == envs.names()
    for name, kind in WORLDS.items():
        assert kind.id == name
        assert world(name) == kind()
        assert str(world(name)) == name
    changed = CartPole(length=0.25)
    assert world(changed) is changed


OTHER = CartPole(
    gravity=5.0,
    masscart=2.0,
    masspole=0.3,
    length=0.7,
    force_mag=8.0,
    tau=0.03,
    theta_threshold_radians=0.3,
    x_threshold=1.0,
    max_episode_steps=9,
)


@pytest.mark.parametrize("integrator", ["euler", "semi-implicit"])
@pytest.mark.parametrize("sutton_barto", [False, True])
def test_gymnasiums_environment_of_a_world_moves_as_ours(integrator, sutton_barto):
    one = OTHER.model_copy(update={"integrator": integrator, "sutton_barto_reward": sutton_barto})
    env, theirs = envs.make("CartPole-v1", **dict(one)), interop.make(one)
    step = jax.jit(env.step)
    for seed in range(5):
        state = env.reset(jax.random.key(seed))
        theirs.reset(seed=0)
        theirs.unwrapped.state = np.asarray(env.observe(state), np.float64)
        for t in range(9):
            action = (seed + t) // 2 % 2
            state, ours = step(jax.random.key(0), state, action)
            obs, reward, terminated, truncated, _ = theirs.step(action)
            np.testing.assert_allclose(ours.obs, obs, rtol=1e-4, atol=1e-5)
            assert (float(ours.reward), bool(ours.terminated)) == (reward, terminated)
            assert bool(ours.truncated) == truncated == (t == 8)
            if terminated:
                break
    with pytest.raises(ValueError, match=r"env: Gymnasium has no .*walk of ours"):
        interop.make(world(walk))


def outcomes(swept):
    return swept.lanes.select(["config", "seed", *OUTCOMES]).to_pylist(), swept.curves.to_pylist()


def test_a_function_that_makes_the_same_environment_gives_the_same_lanes():
    axes = {"env.length": [0.1, 0.5, 1.0], **TABLE}
    registered = jaxq.sweep("q-learning", **axes)
    own = jaxq.sweep("q-learning", env=make_cartpole, **axes)
    assert outcomes(own) == outcomes(registered)
    assert registered.timing.programs == own.timing.programs == 1
    assert own.lanes["env"].to_pylist() == [f"{__name__}:make_cartpole"] * len(own.lanes)
    assert own.lanes["env.length"].to_pylist() == registered.lanes["env.length"].to_pylist()
    returns = [[r["eval_return"] for r in registered.lanes.to_pylist() if r["config"] == c] for c in range(3)]
    assert returns[0] != returns[1] != returns[2]  # the pole's length matters
    for config in range(3):
        weights, same = (swept.policy(config, 1).weights for swept in (registered, own))
        assert weights.keys() == same.keys()
        assert all(np.array_equal(weights[key], same[key]) for key in weights)


def test_numbers_of_a_function_are_traced_and_words_are_structures():
    axes = {"env.cells": [3, 5], "env.goal_reward": [1.0, 2.0], "env.slippery": [False, True]}
    planned = plan("q-learning", env=walk, **axes)
    one = planned.settings[0]
    assert [one.is_structure(f"env.{name}") for name in ("cells", "goal_reward", "slippery")] == [False, False, True]
    assert (len(planned.settings), planned.programs) == (8, 2)
    swept = jaxq.sweep("q-learning", env=walk, max_env_steps=3000, seeds=2, gamma=0.5, success_streak=10**6, **axes)
    assert swept.timing.programs == 2
    for row in swept.lanes.to_pylist():
        assert row["final_return"] == row["eval_return"] == row["env.goal_reward"]
        values = swept.policy(row["config"], row["seed"]).q_values(np.arange(row["env.cells"] - 1))
        paid = row["env.goal_reward"] * 0.5 ** np.arange(row["env.cells"] - 2, -1, -1.0)
        np.testing.assert_allclose(values[:, 1], paid, rtol=0.02)


def test_two_functions_of_one_name_are_two_worlds():
    def variant(reward):
        def make(cells=3):
            return walk(cells, reward, slippery=True)

        return make

    one, other = (plan("q-learning", env=variant(reward)).settings[0] for reward in (1.0, 2.0))
    assert str(one.env) == str(other.env)
    assert one.structural() != other.structural()
    same = variant(3.0)
    structures = [plan("q-learning", env=same, **{"env.cells": cells}).settings[0].structural() for cells in (3, 4)]
    assert structures[0] == structures[1]
    for reward in (1.0, 2.0):
        swept = jaxq.sweep("q-learning", env=variant(reward), max_episodes=5)
        assert swept.lanes["final_return"].to_pylist() == [reward]


def test_a_part_of_a_function_and_a_callable_object_make_worlds_too():
    class Corridor:
        def __call__(self, cells=4):
            return walk(cells)

    part = functools.partial(walk, cells=3)
    assert world(part).flat() == {"cells": 3, "goal_reward": 1.0, "slippery": False}
    assert str(world(part)) == f"{__name__}:walk"
    assert str(world(Corridor())).endswith("Corridor")
    made = programs.played(settle(preset("q-learning"), env=part)).world
    assert made.num_states == 8


def test_a_threshold_of_a_function_is_what_gymnasiums_rule_reads():
    def free(cells=3):
        return walk(cells)

    def bounded(cells=3):
        return walk(cells, slippery=True)

    bounded.reward_threshold = 1.0
    with pytest.raises(ValueError, match=r"stop: gymnasium is not allowed: .*free has no reward threshold"):
        plan("q-learning", env=free, stop="gymnasium")
    swept = jaxq.sweep("q-learning", env=bounded, stop="gymnasium", max_episodes=200)
    assert swept.threshold == 1.0
    assert swept.lanes.select(["status", "episodes"]).to_pylist() == [{"status": "solved", "episodes": 100}]
    bounded.reward_threshold = 1.5
    swept = jaxq.sweep("q-learning", env=bounded, stop="gymnasium", max_episodes=200)
    assert swept.lanes.select(["status", "episodes"]).to_pylist() == [{"status": "finished", "episodes": 200}]


def positional(cells=3, /):
    return walk(cells)


def several(*cells):
    return walk(*cells)


def named_id(id=3):
    return walk(id)


def private(_cells=3):
    return walk(_cells)


@pytest.mark.parametrize(
    ("env", "said"),
    [
        (lambda cells: walk(cells), "must have a name and a default, not 'cells'"),
        (functools.partial(lambda cells, more=1: walk(cells)), "must have a name and a default, not 'cells'"),
        (positional, "every parameter of positional must have a name and a default, not 'cells'"),
        (several, "must have a name and a default, not 'cells'"),
        (lambda **rest: walk(), "must have a name and a default, not 'rest'"),
        (named_id, "'id' is not allowed as a parameter of named_id"),
        (private, "'_cells' is not allowed as a parameter of private"),
        ("CartPole-v0", "did you mean 'CartPole-v1'"),
        (["CartPole-v1"], "is unknown"),
        (None, "None is unknown"),
    ],
)
def test_what_makes_no_world_is_refused_in_one_line(env, said):
    with pytest.raises(ValueError, match=r"^env: ") as error:
        world(env)
    assert said in str(error.value)
    assert "\n" not in str(error.value)


@pytest.mark.parametrize(
    ("env", "values", "said"),
    [
        ("CartPole-v1", {"length": 0}, "env.length: 0 is not allowed: input should be greater"),
        ("CartPole-v1", {"gravity": 1e7}, "env.gravity: 10000000.0 is not allowed"),
        ("CartPole-v1", {"tau": "fast"}, "env.tau: fast is not allowed: a number"),
        ("CartPole-v1", {"max_episode_steps": 0}, "env.max_episode_steps: 0 is not allowed"),
        ("CartPole-v1", {"integrator": "rk4"}, "env.integrator: rk4 is not allowed"),
        ("CartPole-v1", {"reset_low": 0.1}, "env.reset_low: 0.1 must not be above reset_high (0.05)"),
        (walk, {"cells": 2.5}, "env.cells: 2.5 is not allowed: a whole number"),
        (walk, {"cells": 2**31}, f"env.cells: {2**31} is not allowed: a whole number of 32 bits"),
        (walk, {"goal_reward": 1e39}, "env.goal_reward: 1e+39 is not allowed"),
        (walk, {"slippery": "perhaps"}, "env.slippery: perhaps is not allowed: true or false"),
        (walk, {"cell": 3}, "env.cell: q-learning has no such setting; did you mean 'env.cells'"),
        (walk, {"length": 3}, "env.length: q-learning has no such setting"),
    ],
)
def test_a_number_that_cannot_be_is_named_with_its_environment(env, values, said):
    with pytest.raises(ValueError, match=r"^env\.") as error:
        plan("q-learning", env=env, **{f"env.{name}": value for name, value in values.items()})
    assert said in str(error.value)
    assert "\n" not in str(error.value)


def test_an_environment_without_a_threshold_is_not_held_to_one():
    preset_of = preset("dqn")
    assert settle(preset_of).stop == "gymnasium"
    assert settle(preset_of, env=walk).stop == "none"
    assert settle(preset_of, env=walk, stop="window").stop == "window"
    with pytest.raises(ValueError, match=r"stop: gymnasium is not allowed: .*walk has no reward threshold"):
        settle(preset_of, env=walk, stop="gymnasium")


def test_a_table_divides_between_the_bounds_that_the_worlds_own_numbers_give():
    narrow, wide = (
        programs.hypers(one).env[1]
        for one in plan("q-learning", env="Pendulum-v1", **{"env.max_speed": [4.0, 8.0]}).settings
    )
    np.testing.assert_array_equal(narrow[0], wide[0])
    np.testing.assert_allclose(2 * narrow[2], wide[2], rtol=1e-6, atol=1e-6)
    for kind in WORLDS.values():
        assert (kind().bounds is None) == (kind.buckets is None)
