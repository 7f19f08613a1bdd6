"""Policies draw what they say in the right proportions; schedules equal the tutorial's and hand-worked numbers."""

from __future__ import annotations

import contextlib

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp
from scipy import stats

from jaxq import policies, schedules

DRAWS = 40_000
FEW = st.sampled_from([-1.0, 0.0, 2.0, np.inf, -np.inf, np.nan])  # few values, many ties
MANY_ACTIONS = policies.FEW_ACTIONS + 3


def draws(policy, q, parameter, seed=7):
    keys = jax.random.split(jax.random.key(seed), DRAWS)
    actions = jax.jit(jax.vmap(policy, in_axes=(0, None, None)))(keys, jnp.asarray(q, jnp.float32), parameter)
    assert actions.dtype == np.int32
    return np.asarray(actions)


def assert_proportions(actions, probabilities):
    """Each action's count is within binomial bounds; an action of probability 0 is never drawn."""
    counts = np.bincount(actions, minlength=len(probabilities))
    assert len(counts) == len(probabilities)
    for count, probability in zip(counts, probabilities, strict=True):
        assert stats.binomtest(int(count), DRAWS, min(probability, 1.0)).pvalue > 1e-4


# Greedy


@settings(max_examples=100, deadline=None)
@given(hnp.arrays(np.float32, st.integers(1, MANY_ACTIONS), elements=FEW))
def test_greedy_takes_the_first_of_equals_as_numpy(q):
    action = policies.greedy(jnp.asarray(q))
    assert action == np.argmax(q)
    assert action.dtype == np.int32


@pytest.mark.parametrize("actions", [4, MANY_ACTIONS])
def test_greedy_is_the_same_under_vmap_and_jit(actions):
    q = np.random.default_rng(1).integers(0, 3, size=(200, actions)).astype(np.float32)
    np.testing.assert_array_equal(jax.jit(jax.vmap(policies.greedy))(q), np.argmax(q, axis=1))


# Epsilon-greedy


@pytest.mark.parametrize("q", [[0.0, 1.0], [1.0, 1.0], [0.0, 1.0, 5.0, 5.0, -2.0]])
@pytest.mark.parametrize("epsilon", [0.0, 0.3, 1.0])
def test_epsilon_greedy_explores_all_actions_equally_the_greedy_one_included(q, epsilon):
    probabilities = np.full(len(q), epsilon / len(q))
    probabilities[np.argmax(q)] += 1 - epsilon
    assert_proportions(draws(policies.epsilon_greedy, q, epsilon), probabilities)


def test_epsilon_greedy_draws_depend_on_the_key_alone():
    q = [0.0, 1.0, 2.0]
    one, again, other = (draws(policies.epsilon_greedy, q, 0.9, seed) for seed in (1, 1, 2))
    np.testing.assert_array_equal(one, again)
    assert np.mean(one == other) < 0.6


def test_whether_to_explore_does_not_depend_on_which_action_would_be_drawn():
    always = draws(policies.epsilon_greedy, [0.0] * 5, 1.0)  # the same key: the action that exploring draws
    sometimes = draws(policies.epsilon_greedy, [0.0] * 5, 0.5)
    explored = (sometimes == always) & (always > 0)
    counts = [np.bincount(always[keep], minlength=5)[1:] for keep in (explored, ~explored)]
    assert stats.chi2_contingency(counts).pvalue > 1e-4
    assert np.all(sometimes[~explored] == 0)  # otherwise the greedy one


@pytest.mark.parametrize(
    "words", [(0, 0), (0, 2**32 - 1), (0, 2**31), (0, 0x55555556), (0, 0x55555555), (0, 123456789)]
)
def test_the_action_drawn_is_the_words_share_of_the_actions(monkeypatch, words):
    monkeypatch.setattr(jax.random, "bits", lambda key, shape, dtype: jnp.array(words, dtype).reshape(shape))
    for actions in (1, 2, 3, 5, 7, 8, 11, 127, 128, 129, 1000, 2**16):
        drawn = policies.epsilon_greedy(jax.random.key(0), jnp.zeros(actions), 1.0)
        assert drawn == words[1] * actions // 2**32
    with pytest.raises(ValueError, match=r"^num_actions: 65537 "):
        policies.epsilon_greedy(jax.random.key(0), jnp.zeros(2**16 + 1), 1.0)


@pytest.mark.parametrize("word", [0, 2**32 - 1])
def test_epsilon_0_never_explores_and_epsilon_1_always_does(monkeypatch, word):
    monkeypatch.setattr(jax.random, "bits", lambda key, shape, dtype: jnp.array([word, 0], dtype))
    assert policies.epsilon_greedy(jax.random.key(0), jnp.array([0.0, 1.0]), 0.0) == 1
    assert policies.epsilon_greedy(jax.random.key(0), jnp.array([0.0, 1.0]), 1.0) == 0


# Boltzmann


@pytest.mark.parametrize("q", [[0.0, 1.0], [0.0, 1.0, 0.5, -1.0, 2.0]])
@pytest.mark.parametrize("temperature", [0.5, 1.0, 10.0])
def test_boltzmann_draws_in_proportion_to_the_exponential(q, temperature):
    weights = np.exp(np.array(q) / temperature)
    assert_proportions(draws(policies.boltzmann, q, temperature), weights / weights.sum())


def test_boltzmann_at_a_low_temperature_is_greedy_and_large_values_do_not_overflow():
    assert np.all(draws(policies.boltzmann, [1e4, -1e4, 1.2e4], 1e-3) == 2)


@pytest.mark.parametrize("policy", [policies.epsilon_greedy, policies.boltzmann])
@pytest.mark.parametrize("x64", [False, True])
def test_one_draw_equals_its_place_in_a_batch(policy, x64):
    with jax.enable_x64(True) if x64 else contextlib.nullcontext():
        q = jnp.asarray(np.random.default_rng(2).normal(size=(20, 3)), jnp.float32)
        rates = jnp.linspace(0.1, 1, 20, dtype=jnp.float32)
        batched = jax.jit(jax.vmap(policy))(jax.random.split(jax.random.key(3), 20), q, rates)
        keys = jax.random.split(jax.random.key(3), 20)
        looped = [int(policy(key, q[i], rates[i])) for i, key in enumerate(keys)]
    np.testing.assert_array_equal(batched, looped)
    assert len(set(looped)) == 3


# Schedules


@pytest.mark.parametrize(("low", "high"), [(0.01, 1.0), (0.1, 0.5)])
@pytest.mark.parametrize("coefficient", [25, 7, 400])
def test_log10_decay_equals_the_tutorials(tutorial, low, high, coefficient):
    episodes = np.arange(5001, dtype=np.int32)
    expected = np.array([tutorial.decay(int(episode), low, high, coefficient) for episode in episodes])
    schedule = jax.jit(jax.vmap(schedules.log10_decay, in_axes=(0, None, None, None)))
    ours = schedule(episodes, low, high, float(coefficient))
    assert ours.dtype == np.float32
    # One rounding each of the quotient, the logarithm (at most 3) and the difference.
    np.testing.assert_allclose(ours, expected, rtol=0, atol=4 * np.finfo(np.float32).eps)
    with jax.enable_x64(True):
        precise = schedule(episodes, *(jnp.float64(number) for number in (low, high, coefficient)))
        assert precise.dtype == np.float64
    np.testing.assert_allclose(precise, expected, rtol=0, atol=1e-12)
    assert len(np.unique(expected)) > 30


def test_log10_decay_is_clipped_to_its_bounds_exactly():
    ours = jax.vmap(schedules.log10_decay, in_axes=(0, None, None, None))(jnp.array([0, 24, 4999]), 0.01, 1.0, 25.0)
    np.testing.assert_array_equal(ours, np.float32([1.0, 1.0, 0.01]))


@pytest.mark.parametrize(("count", "expected"), [(0, 0.9), (1000, 0.3626975), (2000, 0.1650350)])
def test_exponential_hand_values(count, expected):
    ours = schedules.exponential(jnp.array(count), 0.9, 0.05, 1000.0)
    np.testing.assert_allclose(ours, expected, rtol=1e-6)
    np.testing.assert_allclose(schedules.exponential(jnp.array(10**9), 0.9, 0.05, 1000.0), 0.05, rtol=1e-6)


@pytest.mark.parametrize(("count", "expected"), [(0, 1.0), (25, 0.775), (50, 0.55), (100, 0.1), (10**6, 0.1)])
def test_linear_hand_values(count, expected):
    np.testing.assert_allclose(schedules.linear(jnp.array(count), 1.0, 0.1, 100), expected, rtol=1e-6)


@pytest.mark.parametrize("count", [0, 1, 1000])
@pytest.mark.parametrize("horizon", [0, 0.0, jnp.int32(0), jnp.float32(0)])
def test_a_horizon_of_0_gives_the_end(count, horizon):
    ours = schedules.linear(jnp.array(count), 1.0, 0.25, horizon)
    assert ours == 0.25
    gradients = jax.grad(schedules.linear, argnums=(2, 3))(jnp.array(count), 1.0, 0.25, float(horizon))
    assert gradients == (1.0, 0.0)  # and no NaN from the division that is not used


SCHEDULES = {
    schedules.linear: (1.0, 0.1, 300.0),
    schedules.exponential: (1.0, 0.1, 300.0),
    schedules.log10_decay: (0.1, 1.0, 25.0),
}


@pytest.mark.parametrize("schedule", SCHEDULES, ids=lambda f: f.__name__)
def test_schedules_fall_within_their_bounds_and_batch_over_counts_and_numbers(schedule):
    counts, numbers = jnp.arange(0, 1000, 7), jnp.array(SCHEDULES[schedule])
    values = jax.jit(jax.vmap(schedule, in_axes=(0, None, None, None)))(counts, *numbers)
    assert values.dtype == np.float32
    assert np.all(np.diff(values) <= 0)
    assert values[0] > values[-1] + 0.5
    assert np.all((values >= np.float32(0.1) - 1e-6) & (values <= 1))
    both = jax.vmap(schedule, in_axes=(None, 0, 0, 0))(jnp.array(100), *(jnp.stack([n, 0.5 * n]) for n in numbers))
    for i, factor in enumerate((1.0, 0.5)):
        np.testing.assert_allclose(both[i], schedule(jnp.array(100), *(factor * numbers)), rtol=1e-6)
