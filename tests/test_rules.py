"""The rules are worked by hand, follow from each other, equal plain NumPy, and differentiate where they should."""

from __future__ import annotations

import contextlib

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from jaxq import rules

BOTH = pytest.mark.parametrize("through", [lambda f: f, jax.jit], ids=["plain", "jit"])
#: XLA on a CPU takes subnormal numbers for 0, NumPy does not.
numbers = st.floats(-1e3, 1e3, width=32, allow_subnormal=False)
discounts = st.floats(0, 1, width=32, allow_subnormal=False)
N_STEP_RETURN = jax.jit(rules.n_step_return)


def rows(actions=4):
    return hnp.arrays(np.float32, actions, elements=numbers)


# Worked by hand


@BOTH
@pytest.mark.parametrize(
    ("rule", "arguments", "expected"),
    [
        (rules.greedy_value, ([1.0, -2.0, 3.0],), 3.0),
        (rules.greedy_value, ([-5.0, -2.0],), -2.0),
        (rules.double_value, ([1.0, -2.0, 3.0], [0.0, 7.0, 6.0]), -2.0),
        (rules.double_value, ([1.0, -2.0, 3.0], [6.0, 2.0, 6.0]), 1.0),  # the first of equals
        (rules.sarsa_value, ([1.0, -2.0, 3.0], 1), -2.0),
        (rules.expected_value, ([1.0, -2.0, 3.0], [0.5, 0.25, 0.25]), 0.75),
        (rules.td_error, ([1.0, 4.0], 1, 0.5, 0.9, 10.0), 5.5),
        (rules.td_error, ([1.0, 4.0], 0, -1.0, 0.0, 10.0), -2.0),
        (rules.q_learning, ([1.0, 4.0], 0, 1.0, 0.5, [2.0, 6.0]), 3.0),
        (rules.q_learning, ([1.0, 4.0], 1, 1.0, 0.0, [2.0, 6.0]), -3.0),
        (rules.n_step_return, ([1.0, 2.0, 3.0], [0.5, 0.5, 0.5], 8.0), 1 + 0.5 * (2 + 0.5 * (3 + 0.5 * 8))),
        (rules.n_step_return, ([1.0, 2.0, 3.0], [0.5, 0.0, 0.5], 8.0), 2.0),
        (rules.n_step_return, ([1.0], [0.0], 8.0), 1.0),
    ],
)
def test_rules_give_the_numbers_worked_by_hand(through, rule, arguments, expected):
    result = through(rule)(*(jnp.asarray(argument) for argument in arguments))
    np.testing.assert_allclose(result, expected, rtol=1e-6)
    assert result.shape == ()


# Relations


@settings(max_examples=50, deadline=None)
@given(rows(), rows(), st.integers(0, 3), numbers, discounts)
def test_q_learning_is_the_td_error_of_the_greedy_value(q_tm1, q_t, action, reward, discount):
    value = rules.greedy_value(q_t)
    assert value == q_t.max()
    assert rules.q_learning(q_tm1, action, reward, discount, q_t) == rules.td_error(
        q_tm1, action, reward, discount, value
    )


@settings(max_examples=50, deadline=None)
@given(rows(), st.integers(0, 3))
def test_expected_value_under_a_certain_policy_is_the_sarsa_value(q_t, action):
    certain = np.eye(4, dtype=np.float32)[action]
    assert rules.expected_value(q_t, certain) == rules.sarsa_value(q_t, action) == q_t[action]


@settings(max_examples=50, deadline=None)
@given(rows(), rows())
def test_double_value_with_one_array_is_the_greedy_value_and_never_above_it(q_t, selector_t):
    assert rules.double_value(q_t, q_t) == rules.greedy_value(q_t)
    assert rules.double_value(q_t, selector_t) <= rules.greedy_value(q_t)
    assert rules.double_value(q_t, selector_t) == rules.sarsa_value(q_t, np.argmax(selector_t))


@settings(max_examples=50, deadline=None)
@given(rows(), st.integers(0, 3), numbers, discounts, numbers)
def test_a_return_of_one_step_is_the_one_step_target(q_tm1, action, reward, discount, value):
    reward, discount, value = np.float32(reward), np.float32(discount), np.float32(value)
    target = N_STEP_RETURN(reward[None], discount[None], value)
    error = rules.td_error(q_tm1, action, reward, discount, value)
    np.testing.assert_allclose(target - q_tm1[action], error, rtol=1e-6, atol=1e-3)


@settings(max_examples=30, deadline=None)
@given(st.integers(1, 8), st.integers(0, 2**32 - 1))
def test_an_n_step_return_equals_a_loop_in_numpy(length, seed):
    rng = np.random.default_rng(seed)
    rewards, value = rng.normal(size=length), rng.normal()
    gammas = 0.99 * (rng.random(length) < 0.8)
    expected, weight = 0.0, 1.0
    for reward, discount in zip(rewards, gammas, strict=True):
        expected += weight * reward
        weight *= discount
    expected += weight * value
    with jax.enable_x64(True):
        result = N_STEP_RETURN(jnp.asarray(rewards), jnp.asarray(gammas), jnp.asarray(value))
        assert result.dtype == np.float64
    np.testing.assert_allclose(result, expected, rtol=1e-12, atol=1e-12)


def test_a_discount_of_0_cuts_off_all_that_follows():
    rewards, discounts = jnp.arange(1.0, 6.0), jnp.array([0.9, 0.9, 0.0, 0.9, 0.9])
    whole = rules.n_step_return(rewards, discounts, 100.0)
    other = rules.n_step_return(rewards.at[3:].set(-7.0), discounts.at[3:].set(0.1), -55.0)
    assert whole == other == rules.n_step_return(rewards[:3], discounts[:3], 100.0)


# Gradients

Q_TM1, Q_T, SELECTOR, PROBS = (jnp.array(row) for row in ([1.0, 4.0], [2.0, 6.0], [9.0, 3.0], [0.3, 0.7]))
TARGETS = {
    "greedy": lambda q_t, selector, probs: rules.greedy_value(q_t),
    "double": lambda q_t, selector, probs: rules.double_value(q_t, selector),
    "sarsa": lambda q_t, selector, probs: rules.sarsa_value(q_t, jnp.array(1)),
    "expected": lambda q_t, selector, probs: rules.expected_value(q_t, probs),
    "n-step": lambda q_t, selector, probs: rules.n_step_return(jnp.ones(2), jnp.full(2, 0.9), jnp.max(q_t)),
}


@BOTH
@pytest.mark.parametrize("name", TARGETS)
def test_the_gradient_flows_through_q_tm1_alone(name, through):
    def error(q_tm1, q_t, selector, probs):
        return rules.td_error(q_tm1, jnp.array(1), 1.0, 0.9, TARGETS[name](q_t, selector, probs))

    by_q_tm1, *others = through(jax.grad(error, argnums=(0, 1, 2, 3)))(Q_TM1, Q_T, SELECTOR, PROBS)
    np.testing.assert_array_equal(by_q_tm1, [0.0, -1.0])
    assert all(not np.any(gradient) for gradient in others)


def test_the_gradient_of_half_the_squared_error_is_the_semi_gradient():
    def loss(q_tm1, q_t):
        return 0.5 * jnp.square(rules.q_learning(q_tm1, jnp.array(0), 1.0, 0.5, q_t))

    by_q_tm1, by_q_t = jax.grad(loss, argnums=(0, 1))(Q_TM1, Q_T)
    np.testing.assert_allclose(by_q_tm1, [-(1.0 + 0.5 * 6.0 - 1.0), 0.0])
    np.testing.assert_array_equal(by_q_t, [0.0, 0.0])
    shared = jax.grad(lambda q: loss(q, q))(Q_TM1)  # one network on both sides: the target stays a constant
    np.testing.assert_allclose(shared, [-(1.0 + 0.5 * 4.0 - 1.0), 0.0])


# NaN


def test_nan_in_an_action_that_is_not_taken_does_not_leak():
    nan = jnp.nan
    q_tm1, q_t = jnp.array([nan, 2.0, jnp.inf]), jnp.array([5.0, nan, -jnp.inf])
    assert rules.td_error(q_tm1, jnp.array(1), 1.0, 0.5, 4.0) == 1.0
    assert rules.sarsa_value(q_t, jnp.array(0)) == 5.0
    assert rules.double_value(q_t, jnp.array([3.0, 2.0, 1.0])) == 5.0
    gradient = jax.grad(lambda q: jnp.square(rules.td_error(q, jnp.array(1), 1.0, 0.5, 4.0)))(q_tm1)
    np.testing.assert_array_equal(gradient, [0.0, -2.0, 0.0])


def test_nan_in_the_action_taken_or_in_any_next_value_shows():
    assert np.isnan(rules.td_error(jnp.array([jnp.nan, 2.0]), jnp.array(0), 1.0, 0.5, 4.0))
    assert np.isnan(rules.greedy_value(jnp.array([1.0, jnp.nan])))
    assert np.isnan(rules.q_learning(jnp.ones(2), jnp.array(0), 1.0, 0.5, jnp.array([1.0, jnp.nan])))


# Batches and dtypes


def example(rng, dtype, batch=()):
    """Arguments of every rule, batched the same."""
    q_tm1, q_t, selector, probs = (rng.normal(size=(*batch, 3)).astype(dtype) for _ in range(4))
    reward, discount, value = (rng.normal(size=batch).astype(dtype) for _ in range(3))
    rewards, discounts = (rng.normal(size=(*batch, 4)).astype(dtype) for _ in range(2))
    action = rng.integers(3, size=batch).astype(np.int32)
    return {
        rules.greedy_value: (q_t,),
        rules.double_value: (q_t, selector),
        rules.sarsa_value: (q_t, action),
        rules.expected_value: (q_t, probs),
        rules.td_error: (q_tm1, action, reward, discount, value),
        rules.q_learning: (q_tm1, action, reward, discount, q_t),
        rules.n_step_return: (rewards, discounts, value),
    }


RULES = pytest.mark.parametrize("rule", list(example(np.random.default_rng(0), np.float32)), ids=lambda f: f.__name__)


def test_every_public_rule_is_here():
    public = {
        f
        for name, f in vars(rules).items()
        if callable(f) and not name.startswith("_") and getattr(f, "__module__", "") == rules.__name__
    }
    assert public == set(example(np.random.default_rng(0), np.float32))


@RULES
def test_vmap_equals_a_loop(rule):
    arguments = example(np.random.default_rng(1), np.float32, (20,))[rule]
    batched = jax.jit(jax.vmap(rule))(*arguments)
    assert batched.shape == (20,)
    looped = [rule(*(jnp.asarray(argument[i]) for argument in arguments)) for i in range(20)]
    np.testing.assert_allclose(batched, looped, rtol=1e-6, atol=1e-6)


@BOTH
@RULES
@pytest.mark.parametrize("dtype", [np.float32, np.float64])
def test_results_keep_the_dtype_of_the_values(rule, through, dtype):
    with jax.enable_x64(True):  # in float32 too: a stray Python float would turn the result into float64
        arguments = [jnp.asarray(argument) for argument in example(np.random.default_rng(2), dtype)[rule]]
        result = through(rule)(*arguments)
        assert result.dtype == dtype
        assert not result.weak_type


@RULES
@pytest.mark.parametrize("x64", [False, True])
def test_python_numbers_do_not_change_the_dtype(rule, x64):
    with jax.enable_x64(True) if x64 else contextlib.nullcontext():
        arguments = example(np.random.default_rng(3), np.float32)[rule]
        arguments = [jnp.asarray(a) if a.ndim else a.item() for a in arguments]  # scalars as a user would type them
        result = jax.jit(rule)(*arguments)
        assert result.dtype == np.float32
        assert result.shape == ()


def test_float64_is_worked_in_float64():
    with jax.enable_x64(True):
        q_tm1, q_t = jnp.array([1.0, 1.0 + 1e-12]), jnp.array([1.0, 1.0 + 1e-12])
        error = rules.q_learning(q_tm1, jnp.array(0), jnp.float64(0), jnp.float64(1), q_t)
    np.testing.assert_allclose(error, 1e-12, rtol=1e-3)
