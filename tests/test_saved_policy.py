"""Saved policies, played with NumPy: the learners' own action values, from a file that says how it is read."""

import json
import subprocess
import sys
from dataclasses import replace

import gymnasium
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import jaxq
from jaxq import programs, saved_policy, sweeps
from jaxq.envs import CartPoleState, cartpole
from jaxq.interop.gymnasium import greedy_returns
from jaxq.networks import mlp
from jaxq.plans import plan
from jaxq.runs import RunDirectory
from jaxq.saved_policy import SavedPolicy
from jaxq.stages import Listeners
from jaxq.types import Env
from jaxq.worlds import CartPole

pytestmark = pytest.mark.usefixtures("programs_are_compiled_once")

BUCKETS = [(1, 1, 6, 3), (3, 4, 5, 2), (1, 1, 1, 1)]


def one_setting(name, **values):
    return plan(name, **values).settings[0]


def through_json(about):
    return json.loads(json.dumps(about))


def indexed(one):
    """The row of the table that the environment of the training gives an observation, as a function of batches."""
    made = programs.played(one)
    example = made.world.reset(jax.random.key(0))
    return jax.jit(
        jax.vmap(lambda obs: made.env.observe(type(example)(obs[0], obs[1], obs[2], obs[3], jnp.zeros((), jnp.int32))))
    )


INDEXED = {buckets: indexed(one_setting("q-learning", num_buckets=buckets)) for buckets in BUCKETS}


@st.composite
def observations(draw, edges):
    """Eight observations, each coordinate any number, or an edge of a bucket, or its neighbour."""
    rows = []
    for steps in edges:
        near = [np.nextafter(np.float32(edge), to) for edge in steps for to in (np.float32(-9), np.float32(9))]
        some = st.floats(-10, 10, width=32) | st.sampled_from([*map(np.float32, steps), *near, np.inf, -np.inf, np.nan])
        rows.append(draw(st.lists(some, min_size=8, max_size=8)))
    return np.array(rows, np.float32).T


@given(st.data(), st.sampled_from(BUCKETS))
@settings(deadline=None, max_examples=150)
def test_the_row_of_a_table_is_the_bucket_of_the_training(data, buckets):
    one = one_setting("q-learning", num_buckets=buckets)
    about = through_json(saved_policy.describe(one))
    assert about["kind"] == "table"
    assert [len(steps) + 1 for steps in about["edges"]] == list(buckets)
    obs = data.draw(observations(about["edges"]))
    rows = np.asarray(INDEXED[buckets](obs))
    table = np.arange(2 * np.prod(buckets), dtype=np.float32).reshape(-1, 2)
    policy = SavedPolicy(about, {"table": table})
    np.testing.assert_array_equal(policy.q_values(obs), table[rows])
    np.testing.assert_array_equal(policy.act(obs), np.ones(8))


@pytest.mark.parametrize("hidden", [(), (8,), (16, 5), (7, 6, 5)])
@pytest.mark.parametrize("seed", [0, 1])
def test_a_networks_values_are_those_of_the_agent(hidden, seed):
    one = one_setting("article-dqn", hidden=hidden)
    agent = programs.played(one).agent
    network = mlp(hidden, 2)
    params = network.init(jax.random.key(seed), jnp.zeros(4))
    params = jax.tree.map(lambda leaf: leaf + 0.1 * np.arange(leaf.size).reshape(leaf.shape) / leaf.size, params)
    policy = SavedPolicy(through_json(saved_policy.describe(one)), saved_policy.flatten(params))
    obs = np.random.default_rng(seed).normal(size=(50, 4)).astype(np.float32)
    wanted = np.asarray(jax.vmap(agent.q_values, (None, 0))(params, obs))
    np.testing.assert_allclose(policy.q_values(obs), wanted, rtol=1e-5, atol=1e-6)
    clear = np.abs(wanted[:, 0] - wanted[:, 1]) > 1e-4
    assert clear.sum() > 40
    np.testing.assert_array_equal(policy.act(obs)[clear], wanted.argmax(1)[clear])


def test_of_equal_values_the_first_is_taken():
    policy = SavedPolicy({"kind": "table", "edges": None}, {"table": np.array([[1.0, 2, 2], [3, 3, 3], [0, 0, 1]])})
    assert policy.act(np.array([0, 1, 2, 1])).tolist() == [1, 0, 2, 0]


def grid(size=18):
    """States that are indices already, as many as the tutorial's table has rows."""
    made = jaxq.envs.discretise(cartpole(), jaxq.envs.tutorial_edges([-1] * 4, [1] * 4, (1, 1, 6, 3)))
    return replace(made, num_states=18)


def image(noise=0.0):
    """CartPole whose observation is a matrix."""
    made = cartpole()

    def step(key, state, action):
        state, happened = made.step(key, state, action)
        return state, happened._replace(obs=happened.obs.reshape(2, 2) + noise)

    return Env(
        made.reset, step, lambda state: made.observe(state).reshape(2, 2) + noise, num_actions=2, obs_shape=(2, 2)
    )


def test_a_world_of_indices_has_a_table_without_edges_however_many_rows():
    values = {"env": grid, "max_episodes": 5, "eval_episodes": 2}
    policy = jaxq.sweep("q-learning", **values).policy(0)
    assert policy.about == {"kind": "table", "edges": None}
    np.testing.assert_array_equal(policy.q_values(np.array([17, 0, 3])), policy.weights["table"][[17, 0, 3]])
    own = one_setting("q-learning", env=lambda length=0.5: cartpole())
    assert saved_policy.describe(own) == saved_policy.describe(one_setting("q-learning"))


SMALL = {"batch_size": 16, "learning_starts": 32, "buffer_size": 200, "max_env_steps": 300, "eval_episodes": 2}


def test_an_observation_of_any_shape_is_laid_flat():
    one = one_setting("article-dqn", env=image, hidden=(8,))
    params = mlp((8,), 2).init(jax.random.key(0), jnp.zeros(4))
    policy = SavedPolicy(saved_policy.describe(one), saved_policy.flatten(params))
    obs = np.random.default_rng(0).normal(size=(6, 2, 2)).astype(np.float32)
    wanted = jax.vmap(programs.played(one).agent.q_values, (None, 0))(params, obs)
    np.testing.assert_allclose(policy.q_values(obs), wanted, rtol=1e-5, atol=1e-6)


SMALL = {"batch_size": 16, "learning_starts": 32, "buffer_size": 200, "max_env_steps": 300, "eval_episodes": 2}
READER = """
import json, sys
import numpy as np
import safetensors
config, seed, *files = sys.argv[1:]
prefix = f"{config}/{seed}/"
for file in files:
    with safetensors.safe_open(file, "numpy") as tensors:
        held = {n.removeprefix(prefix): tensors.get_tensor(n) for n in tensors.keys() if n.startswith(prefix)}
        if held:
            weights, about = held, json.loads(tensors.metadata()["policies"])[config]
found = []
for obs in json.load(sys.stdin):
    if about["kind"] == "table":
        reached = [sum(np.float32(x) >= np.float32(edge) for edge in steps) for x, steps in zip(obs, about["edges"])]
        row = np.ravel_multi_index(reached, [len(steps) + 1 for steps in about["edges"]])
        found.append(weights["table"][row].tolist())
        continue
    y = np.array(obs, np.float32)
    for layer in about["layers"]:
        if layer != about["layers"][0]:
            y = np.where(y > 0, y, 0)
        y = y @ weights[layer + ".kernel"] + weights[layer + ".bias"]
    found.append(y.tolist())
assert not {"jax", "jaxq"} & set(sys.modules)
print(json.dumps(found))
"""


@pytest.mark.parametrize(
    ("name", "values"),
    [
        ("q-learning", {"max_episodes": 60, "num_buckets": [(1, 1, 6, 3), (2, 1, 3, 3)], "eval_episodes": 2}),
        ("article-dqn", {"hidden": [(8,), (6, 5)], **SMALL}),
    ],
)
def test_a_file_is_read_with_nothing_but_its_own_description(name, values, tmp_path):
    trained, planned = {}, plan(name, seeds=2, **values)
    tell = Listeners(result=lambda result: trained.update({result.lane[:2]: saved_policy.flatten(result.policy)}))
    with RunDirectory.open(tmp_path / "run", planned) as directory:
        swept = sweeps.run(planned, directory=directory, tell=tell)
    files = [str(file) for file in (tmp_path / "run" / "policies").iterdir()]
    reader = [sys.executable, "-c", READER]
    obs = np.random.default_rng(1).uniform(-0.4, 0.4, (20, 4)).astype(np.float32)
    different = set()
    for config in (0, 1):
        for seed in (0, 1):
            words = [str(config), str(seed), *files]
            done = subprocess.run(
                reader + words, input=json.dumps(obs.tolist()), capture_output=True, text=True, check=True
            )
            policy = swept.policy(config, seed)
            np.testing.assert_allclose(json.loads(done.stdout), policy.q_values(obs), rtol=1e-5, atol=1e-6)
            assert policy.weights.keys() == trained[config, seed].keys()
            assert all(np.array_equal(policy.weights[key], array) for key, array in trained[config, seed].items())
            again = jaxq.load(tmp_path / "run").policy(config, seed)
            np.testing.assert_array_equal(again.q_values(obs), policy.q_values(obs))
            different.add(done.stdout)
    assert len(different) == 4


def test_what_was_not_saved_is_said():
    swept = jaxq.sweep("q-learning", max_episodes=3, eval_episodes=1)
    assert swept.policy(0, 0).weights["table"].shape == (18, 2)
    for config, seed in ((0, 1), (1, 0)):
        with pytest.raises(ValueError, match=f"setting {config}, seed {seed}: no policy is saved"):
            swept.policy(config, seed)


def test_names_are_the_paths_of_the_arrays():
    assert list(saved_policy.flatten(np.zeros(2))) == ["table"]
    named = saved_policy.flatten({"a": [np.zeros(1), {"b": np.ones(2)}], "c": CartPoleLike(np.zeros(3), 4.0)})
    assert {name: array.shape for name, array in named.items()} == {
        "a.0": (1,),
        "a.1.b": (2,),
        "c.x": (3,),
        "c.y": (),
    }


class CartPoleLike(tuple):
    """Has the fields of a NamedTuple."""

    _fields = ("x", "y")

    def __new__(cls, *values):
        return super().__new__(cls, values)


@pytest.mark.parametrize("world", [CartPole(), CartPole(max_episode_steps=30, length=0.3, sutton_barto_reward=True)])
def test_greedy_returns_are_those_of_a_loop_in_gymnasium(world):
    kernel = np.array([[0, 0], [0, 0], [0, 1], [0, 1]], np.float32)  # push where the pole falls to
    weights = {"params.Linear_0.kernel": kernel, "params.Linear_0.bias": np.zeros(2, np.float32)}
    policy = SavedPolicy({"kind": "mlp", "layers": ["params.Linear_0"]}, weights)
    starts = np.random.default_rng(0).uniform(-0.15, 0.15, (6, 4)).astype(np.float32)
    starts[0] = 0, 0, 0.2, 2  # falls at once
    wanted = []
    for start in starts:
        env = gymnasium.make("CartPole-v1", max_episode_steps=world.max_episode_steps)
        env.reset(seed=0)
        env.unwrapped.length, env.unwrapped.polemass_length = world.length, world.masspole * world.length
        env.unwrapped.state = start.astype(float)
        obs, steps, over, fell = start, 0, False, False
        while not over:
            obs, _, fell, late, _ = env.step(int(obs[2] + obs[3] > 0))
            steps, over = steps + 1, fell or late
        wanted.append(-float(fell) if world.sutton_barto_reward else steps)
    found = greedy_returns(world, policy, CartPoleState(*starts.T, np.zeros(len(starts), int)))
    assert found.tolist() == wanted
    assert len(set(wanted)) > 1
