"""The discretised observation is the tutorial's own, to the last float32 number on either side of every edge."""

from __future__ import annotations

import gymnasium
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from jaxq.envs import cartpole, discretise, tutorial_edges
from jaxq.types import Env, Step

TUTORIAL = (1, 1, 6, 3)
SPECIAL = np.array([0.0, -0.0, np.inf, -np.inf, 1e-45, -1e-45, 1e-39, -1e-39, 1.2e-38, 3.4e38, -3.4e38], np.float32)


def looking(coordinates):
    """An environment whose state is its observation; an action is added to it."""

    def step(key, state, action):
        del key
        after = state + action
        return after, Step(after, jnp.float32(action), after[0] > 1, after[0] > 2)

    return Env(lambda key: jnp.zeros(coordinates), step, lambda state: state, 5, (coordinates,))


@jax.jit
def buckets(values, edges):
    """One coordinate's bucket of each value, edges traced: compiled once for each number of buckets."""
    return jax.vmap(lambda value: discretise(looking(1), (edges,)).observe(value[None]))(values)


def indices(observations, edges):
    return jax.jit(jax.vmap(discretise(looking(len(edges)), edges).observe))(jnp.asarray(observations))


def neighbours(values, ulps=4):
    """The float32 numbers from ``ulps`` below to ``ulps`` above each value."""
    values = np.asarray(values, np.float32)
    up, down, rows = values, values, [values]
    for _ in range(ulps):
        up, down = np.nextafter(up, np.float32(np.inf)), np.nextafter(down, np.float32(-np.inf))
        rows += [up, down]
    return np.concatenate(rows)


def telling_values(rng, low, high, edges):
    """Values of one coordinate: around its edges and bounds, inside, outside, and the odd numbers of float32."""
    width = float(high) - float(low)
    return np.concatenate(
        [
            neighbours(edges),
            neighbours([low, high]),
            rng.uniform(low - width / 2, high + width / 2, 200).astype(np.float32),
            SPECIAL,
        ]
    )


@pytest.fixture(scope="module")
def bounds(tutorial):
    with gymnasium.make("CartPole-v1") as env:
        return tutorial.state_bounds(env)


def edges_of(bounds, counts=TUTORIAL):
    return tutorial_edges(*zip(*bounds, strict=True), counts)


@pytest.mark.parametrize("counts", [TUTORIAL, (3, 2, 7, 4), (10, 10, 10, 10), (1, 1, 1, 1)])
def test_random_and_edge_observations_fall_into_the_tutorials_buckets(tutorial, bounds, counts):
    rng = np.random.default_rng(1)
    edges = edges_of(bounds, counts)
    columns = [telling_values(rng, *bounds[i], edges[i]) for i in range(4)]
    observations = np.stack([rng.permutation(np.resize(column, 3000)) for column in columns], axis=1)
    assert observations.dtype == np.float32
    expected = [np.ravel_multi_index(tutorial.discretise(obs, bounds, counts), counts) for obs in observations]
    np.testing.assert_array_equal(indices(observations, edges), expected)
    assert len(set(expected)) > 0.3 * min(np.prod(counts), len(observations))


def test_the_observations_of_gymnasiums_episodes_fall_into_the_tutorials_buckets(tutorial, bounds):
    observations = []
    with gymnasium.make("CartPole-v1") as env:
        env.action_space.seed(2)
        obs, _ = env.reset(seed=2)
        for _ in range(2000):
            observations.append(obs)
            obs, _, terminated, truncated, _ = env.step(env.action_space.sample())
            if terminated or truncated:
                observations.append(obs)
                obs, _ = env.reset()
    expected = [np.ravel_multi_index(tutorial.discretise(obs, bounds), TUTORIAL) for obs in observations]
    np.testing.assert_array_equal(indices(np.array(observations), edges_of(bounds)), expected)
    assert len(set(expected)) >= 10  # of the 12 that angles within the threshold can reach


@st.composite
def intervals(draw):
    """Bounds as np.float32 or as Python floats, wide enough that float32 can tell the buckets apart."""
    middle = draw(st.floats(-100, 100))
    half_width = draw(st.floats(1e-3, 1e3))
    kind = draw(st.sampled_from([np.float32, float]))
    low, high = kind(middle - half_width), kind(middle + half_width)
    assume(half_width > 1e-2 * abs(middle))
    return low, high


@settings(max_examples=100, deadline=None)
@given(intervals(), st.integers(1, 9), st.integers(0, 2**32 - 1))
def test_any_bounds_and_any_number_of_buckets_follow_the_formula(tutorial, interval, count, seed):
    low, high = interval
    (edges,) = tutorial_edges([low], [high], [count])
    values = telling_values(np.random.default_rng(seed), low, high, edges)
    expected = [tutorial.bucket(value, low, high, count) for value in values]
    np.testing.assert_array_equal(buckets(values, edges), expected)


@settings(max_examples=200, deadline=None)
@given(intervals(), st.integers(1, 30))
def test_edges_are_float32_ascending_and_within_the_bounds(interval, count):
    low, high = interval
    (edges,) = tutorial_edges([low], [high], [count])
    assert edges.dtype == np.float32
    assert edges.shape == (count - 1,)
    assert np.all(np.diff(edges) > 0)
    assert np.all((edges > np.float32(low)) & (edges <= np.float32(high)))


def test_bounds_of_float32_and_of_python_round_differently_and_each_as_numpy_does(tutorial):
    differing = 0
    for high in np.linspace(0.1, 3, 30, dtype=np.float32):
        for count in (4, 6, 7):
            rows = []
            for kind in (np.float32, float):
                low_, high_ = kind(-high), kind(high)
                (edges,) = tutorial_edges([low_], [high_], [count])
                for value in neighbours(edges, 2):
                    expected = tutorial.bucket(value, low_, high_, count)
                    assert int(np.sum(value >= edges)) == expected
                rows.append(edges)
            differing += not np.array_equal(*rows)
    assert differing > 0


def test_hand_worked_edges():
    (edges,) = tutorial_edges([-1.0], [1.0], [3])
    # round(v + 1): the sum is a float32 number, and the last ones that round to 0.5 and the first to 1.5 are halves,
    # which go to the even 0 and 2.
    assert edges.tolist() == [-0.5 + 2.0**-24, 0.5 - 2.0**-24]
    np.testing.assert_array_equal(buckets(np.float32([-1, -0.5, 0, 0.4999, 0.5, 1]), edges), [0, 0, 1, 1, 2, 2])


def test_a_value_on_an_edge_has_reached_it():
    edges = np.float32([-1, 0, 0.5])
    values = np.float32([-1.5, -1, -0.5, -0.0, 0.0, 0.25, 0.5, 9])
    np.testing.assert_array_equal(buckets(values, edges), [0, 1, 1, 2, 2, 2, 3, 3])


def test_nan_falls_into_bucket_0_of_its_coordinate_and_infinities_into_the_outer_ones():
    edges = (np.float32([0, 1]), np.float32([0, 1, 2]))
    observations = np.float32([[np.nan, 1.5], [0.5, np.nan], [np.nan, np.nan], [-np.inf, np.inf], [np.inf, -np.inf]])
    np.testing.assert_array_equal(indices(observations, edges), [0 * 4 + 2, 1 * 4 + 0, 0, 3, 2 * 4])


def test_the_index_is_flat_in_c_order():
    counts = (2, 3, 4)
    edges = tuple(np.arange(1, count, dtype=np.float32) for count in counts)
    observations = np.stack(np.meshgrid(*map(np.arange, counts), indexing="ij"), -1).reshape(-1, 3).astype(np.float32)
    np.testing.assert_array_equal(indices(observations, edges), np.arange(24))


def test_a_step_carries_the_index_and_leaves_the_rest():
    plain = looking(2)
    env = discretise(plain, (np.float32([0, 1]), np.float32([5])))
    assert (env.num_states, env.obs_shape, env.num_actions) == (6, (), 5)
    key = jax.random.key(0)
    state, happened = env.step(key, jnp.array([0.0, 3.0]), 2.0)
    other, expected = plain.step(key, jnp.array([0.0, 3.0]), 2.0)
    np.testing.assert_array_equal(state, other)
    assert happened.obs == 2 * 2 + 1
    assert happened.obs.dtype == np.int32
    assert env.observe(state) == happened.obs
    assert happened[1:] == expected[1:]


def test_edges_may_be_traced_and_batched_under_jit_and_vmap():
    rng = np.random.default_rng(3)
    rows = [(np.sort(rng.normal(size=(4, n)), -1)).astype(np.float32) for n in (2, 3)]
    observations = rng.normal(size=(50, 2)).astype(np.float32)
    traces = []

    @jax.jit
    def batched(edges):
        traces.append(edges)
        return jax.vmap(lambda one: jax.vmap(discretise(looking(2), one).observe)(jnp.asarray(observations)))(edges)

    together = batched(tuple(rows))
    for i in range(4):
        edges = tuple(row[i] for row in rows)
        observe = discretise(looking(2), edges).observe
        np.testing.assert_array_equal(together[i], indices(observations, edges))
        np.testing.assert_array_equal(together[i, :5], [int(observe(obs)) for obs in jnp.asarray(observations[:5])])
        expected = sum(np.sum(observations[:, k, None] >= edges[k], -1) * w for k, w in ((0, 4), (1, 1)))
        np.testing.assert_array_equal(together[i], expected)
    batched(tuple(-row[:, ::-1] for row in rows))
    assert len(traces) == 1


def test_cartpole_is_discretised_from_its_float32_observation_also_with_a_float64_state(tutorial, bounds):
    edges = edges_of(bounds)
    # A float64 angle just below an edge, whose nearest float32 number is the edge itself.
    angle = float(edges[2][3]) * (1 - 1e-9)
    with jax.enable_x64(True):
        env = discretise(cartpole(dtype=np.float64), edges)
        state = env.reset(jax.random.key(0))._replace(theta=jnp.float64(angle), theta_dot=jnp.float64(0))
        index = int(env.observe(state))
    obs = np.array([0, 0, angle, 0]).astype(np.float32)
    assert index == np.ravel_multi_index(tutorial.discretise(obs, bounds), TUTORIAL)
    assert angle < float(edges[2][3]) == float(obs[2])


@pytest.mark.parametrize(
    ("low", "high"),
    [
        (1.0, 1.0),
        (1.0, -1.0),
        (1.0, 1.0 + 1e-12),
        (np.nan, 1.0),
        (0.0, np.nan),
        (-np.inf, 1.0),
        (0.0, np.inf),
        (-1e300, 1e300),
        (-1e-40, 1e-40),
    ],
)
def test_bounds_that_are_not_an_interval_are_an_error_that_names_the_row(low, high):
    with pytest.raises(
        ValueError, match=r"^bounds\[1\]: low .* must be below high .*, both of a size that float32 can scale$"
    ):
        tutorial_edges([0.0, low], [1.0, high], [2, 2])


@pytest.mark.parametrize("count", [0, -1])
def test_a_count_below_1_is_an_error_that_names_the_row(count):
    with pytest.raises(ValueError, match=rf"^num_buckets\[1\]: {count} must be at least 1$"):
        tutorial_edges([0.0, 0.0], [1.0, 1.0], [2, count])


def test_rows_that_do_not_match_are_an_error():
    with pytest.raises(ValueError, match="argument 3 is shorter"):
        tutorial_edges([0.0, 0.0], [1.0, 1.0], [2])
    with pytest.raises(ValueError, match=r"^edges: 3 rows, but an observation has shape \(4,\)$"):
        discretise(cartpole(), [np.zeros(1)] * 3)
    with pytest.raises(ValueError, match=r"^edges: 1 rows, but an observation has shape \(\)$"):
        discretise(discretise(looking(1), [np.zeros(1)]), [np.zeros(1)])


@pytest.mark.parametrize(
    ("row", "said"),
    [
        ([1.0, 0.0], r"edges: .* in row 1 is not allowed: ascending numbers"),
        ([np.nan], "in row 1 is not allowed"),
        (0.5, "edges: 0.5 in row 1 is not allowed"),
        (np.arange(10_000_000.0), "buckets are too many: at most 2147483647"),
    ],
)
def test_edges_that_are_none_are_refused(row, said):
    with pytest.raises(ValueError, match=said):
        discretise(cartpole(), [np.arange(299.0), row, [0.0], [0.0]])
