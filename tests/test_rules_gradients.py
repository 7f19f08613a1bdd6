"""Gradients flow through what an error is taken of alone; targets have the derivatives that NumPy measures."""

from __future__ import annotations

import functools

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxq import rules
from jaxq.verify import rule_cases as cases

LENGTHS = {"A": 3, "T": 5, "K": 4, "M": 3, "N": 2, "S": 3}
ERRORS = [name for name in cases.NAMES if cases.error_of(name)]
TARGETS = [name for name in cases.NAMES if not cases.error_of(name)]
BOTH = pytest.mark.parametrize("through", [lambda f: f, jax.jit], ids=["plain", "jit"])


@functools.cache
def derivative(name):
    return jax.jit(jax.grad(lambda of, rest: jnp.sum(cases.rule(name)(**of, **rest))))


def gradients(name, given):
    """Of the sum of a rule's results, by every float argument, in float64."""
    of = cases.floats(given)
    with jax.enable_x64(True):
        return jax.device_get(derivative(name)(of, {key: given[key] for key in given if key not in of}))


def measured(name, given, argument, step=1e-6):
    """The same by one argument, as central differences of the reference in NumPy."""
    gradient = np.zeros(given[argument].shape)
    for cell in np.ndindex(*gradient.shape):
        ends = []
        for sign in (1, -1):
            moved = given[argument].copy()
            moved[cell] += sign * step
            ends.append(np.sum(cases.reference(name)(**{**given, argument: moved})))
        gradient[cell] = (ends[0] - ends[1]) / (2 * step)
    return gradient


@pytest.mark.parametrize("seed", [0, 1, 2])
@pytest.mark.parametrize("name", ERRORS)
def test_an_error_is_differentiated_by_what_it_is_taken_of_alone(name, seed):
    given = cases.arguments(name, np.random.default_rng(seed), np.float64, LENGTHS)
    found = gradients(name, given)
    of = found.pop(cases.error_of(name))
    np.testing.assert_allclose(of, measured(name, given, cases.error_of(name)), rtol=1e-6, atol=1e-7)
    assert np.any(of)
    for argument, gradient in found.items():
        np.testing.assert_array_equal(gradient, 0.0, err_msg=argument)


@pytest.mark.parametrize("seed", [0, 1, 2])
@pytest.mark.parametrize("name", TARGETS)
def test_a_target_or_value_has_the_derivatives_that_numpy_measures(name, seed):
    given = cases.arguments(name, np.random.default_rng(seed), np.float64, LENGTHS)
    # Only within their range: at the edges these are no functions of two sides, or the projection has a kink.
    keep = {"discount_t"} if name == "categorical_target" else {"tau"} if name == "periodic_step" else set()
    given = {k: np.asarray(np.clip(v, 0.1, 0.9)) if k in keep else v for k, v in given.items()}
    for argument, gradient in gradients(name, given).items():
        expected = measured(name, given, argument)
        np.testing.assert_allclose(gradient, expected, rtol=1e-6, atol=2e-7, err_msg=argument)


@BOTH
@pytest.mark.parametrize("name", [name for name in ERRORS if cases.error_of(name) == "q_tm1"])
def test_the_derivative_of_a_td_error_is_minus_one_in_the_cell_taken(name, through):
    given = cases.arguments(name, np.random.default_rng(4), np.float32, LENGTHS)

    def total(q_tm1):
        return jnp.sum(cases.rule(name)(**{**given, "q_tm1": q_tm1}))

    gradient = through(jax.grad(total))(jnp.asarray(given["q_tm1"]))
    np.testing.assert_array_equal(gradient, -np.eye(LENGTHS["A"])[given["a_tm1"]])


def test_the_derivative_of_the_cross_entropy_is_softmax_minus_target_in_the_row_taken():
    given = cases.arguments("categorical_error", np.random.default_rng(5), np.float32, LENGTHS)
    gradient = jax.grad(rules.categorical_error)(given["q_logits_tm1"], given["a_tm1"], given["target_tm1"])
    expected = np.zeros((3, 4))
    row = np.exp(given["q_logits_tm1"][given["a_tm1"]])
    expected[given["a_tm1"]] = row / row.sum() - given["target_tm1"]
    np.testing.assert_allclose(gradient, expected, atol=1e-6)


@BOTH
def test_the_gradient_of_half_the_squared_error_is_the_semi_gradient(through):
    q_tm1, q_t = jnp.array([1.0, 4.0]), jnp.array([2.0, 6.0])

    def loss(q_tm1, q_t):
        return 0.5 * jnp.square(rules.q_learning(q_tm1, jnp.array(0), 1.0, 0.5, q_t))

    by_q_tm1, by_q_t = through(jax.grad(loss, argnums=(0, 1)))(q_tm1, q_t)
    np.testing.assert_allclose(by_q_tm1, [-(1.0 + 0.5 * 6.0 - 1.0), 0.0])
    np.testing.assert_array_equal(by_q_t, [0.0, 0.0])
    shared = through(jax.grad(lambda q: loss(q, q)))(q_tm1)  # one network on both sides: the target stays a constant
    np.testing.assert_allclose(shared, [-(1.0 + 0.5 * 4.0 - 1.0), 0.0])


@pytest.mark.parametrize("edge", [0.0, 1.0])
@pytest.mark.parametrize("name", ["lambda_returns", "n_step_bootstrapped_returns", "off_policy_returns"])
def test_a_weight_at_its_edge_has_the_derivative_of_its_neighbourhood(name, edge):
    given = cases.arguments(name, np.random.default_rng(6), np.float64, LENGTHS)
    weight = {"off_policy_returns": "c_t", "lambda_returns": "lambda_"}.get(name, "lambda_t")
    given |= {weight: np.asarray(edge), "discount_t": np.full(5, 0.9), "cut_t": np.array([0, 1, 0, 0, 0], bool)}
    gradient = gradients(name, given)[weight]
    assert abs(gradient) > 0.01
    np.testing.assert_allclose(gradient, measured(name, given, weight), rtol=1e-6)


@pytest.mark.parametrize("name", ERRORS)
@pytest.mark.parametrize("bad", [np.nan, -np.inf])
def test_what_is_wrong_with_an_action_not_taken_does_not_leak(name, bad):
    given = cases.arguments(name, np.random.default_rng(7), np.float32, LENGTHS)
    argument = cases.error_of(name)
    taken = np.arange(3) == given["a_tm1"][..., None] if given["a_tm1"].ndim else np.arange(3) == given["a_tm1"]
    if argument == "q_logits_tm1":
        taken = taken[:, None]

    def total(of):
        return jnp.sum(cases.rule(name)(**{**given, argument: of}) ** 2)

    both = jax.value_and_grad(total)
    clean, wrong = both(given[argument]), both(np.where(taken, given[argument], np.float32(bad)))
    assert np.isfinite(clean[0])
    jax.tree.map(np.testing.assert_array_equal, wrong, clean)
    shows = both(np.where(taken, np.float32(bad), given[argument]))
    assert not np.isfinite(shows[0])


def test_the_action_values_of_a_selector_never_reach_a_gradient_or_a_value():
    selector = jnp.array([jnp.inf, 1.0])
    assert rules.double_value(jnp.array([5.0, jnp.nan]), selector) == 5.0
    assert rules.action_value(jnp.array([5.0, jnp.nan, -jnp.inf]), jnp.array(0)) == 5.0
    np.testing.assert_array_equal(jax.grad(rules.double_value)(jnp.array([5.0, jnp.nan]), selector), [1.0, 0.0])
    np.testing.assert_array_equal(jax.grad(rules.double_value, 1)(jnp.array([5.0, 3.0]), jnp.array([2.0, 1.0])), 0.0)


def test_nan_among_the_values_that_a_maximum_is_taken_of_shows():
    nan = jnp.array([1.0, jnp.nan])
    assert np.isnan(rules.greedy_value(nan))
    assert np.isnan(rules.q_learning(jnp.ones(2), jnp.array(0), 1.0, 0.5, nan))
    assert np.isnan(rules.soft_value(nan, 1.0))
    assert np.isnan(rules.expected_value(nan, jnp.array([1.0, 0.0])))
