"""Projections keep mass and mean, distributions without spread are plain Q-learning, quantile losses find quantiles."""

from __future__ import annotations

import functools

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from jaxq import rules
from jaxq.verify import numpy_rules_distributions

seeds = st.integers(0, 2**32 - 1)
examples = settings(max_examples=15, deadline=None, derandomize=True)
close = functools.partial(np.testing.assert_allclose, rtol=1e-5, atol=1e-5)
project = jax.jit(rules.categorical_l2_project)


@pytest.mark.parametrize("count", [2, 3, 51])
@examples
@given(seed=seeds)
def test_a_projection_on_uniform_atoms_is_the_algorithm_of_c51(count, seed):
    rng = np.random.default_rng(seed)
    z_q, probs = np.linspace(-10, 10, count), rng.dirichlet(np.ones(count))
    z_p = rng.choice([0.0, 0.5, 1.0, 2.0]) * z_q + rng.choice([0.0, 20 / (count - 1), rng.normal()])
    expected = numpy_rules_distributions.project_uniform(z_p, probs, z_q)
    with jax.enable_x64(True):
        np.testing.assert_allclose(project(z_p, probs, z_q), expected, rtol=1e-11, atol=1e-12)
    close(project(*(x.astype(np.float32) for x in (z_p, probs, z_q))), expected)


@examples
@given(seed=seeds, counts=st.sampled_from([(1, 1), (1, 4), (4, 1), (4, 4), (4, 7)]))
def test_a_projection_keeps_mass_and_the_mean_of_what_is_not_clipped(seed, counts):
    rng = np.random.default_rng(seed)
    z_p, z_q = rng.normal(size=counts[0]), -2 + np.cumsum(rng.uniform(0.01, 2, counts[1]))
    probs = rng.dirichlet(np.ones(counts[0]))
    z_p, probs, z_q = (x.astype(np.float32) for x in (z_p, probs, z_q))
    mass = np.asarray(project(z_p, probs, z_q))
    close(mass, numpy_rules_distributions.categorical_l2_project(z_p, probs, z_q))
    close(mass.sum(), 1.0)
    assert np.all(mass >= 0)
    close(mass @ z_q, probs @ np.clip(z_p, z_q[0], z_q[-1]))
    close(project(np.full_like(z_p, np.inf), probs, z_q)[-1], 1.0)
    close(project(np.full_like(z_p, -np.inf), probs, z_q)[0], 1.0)


@examples
@given(seed=seeds, count=st.sampled_from([1, 5]))
def test_a_projection_on_its_own_atoms_is_the_identity(seed, count):
    rng = np.random.default_rng(seed)
    z = np.cumsum(rng.uniform(0.01, 9, count)).astype(np.float32) - 20
    probs = rng.dirichlet(np.ones(count)).astype(np.float32)
    np.testing.assert_allclose(project(z, probs, z), probs, rtol=4e-7)
    order = rng.permutation(count)  # what is projected need not be sorted
    np.testing.assert_allclose(project(z[order], probs[order], z), probs, rtol=4e-7)


@examples
@given(seed=seeds, actions=st.sampled_from([1, 3]))
def test_certain_distributions_move_towards_the_target_of_q_learning(seed, actions):
    rng = np.random.default_rng(seed)
    atoms, hot = np.linspace(-3, 3, 7).astype(np.float32), rng.integers(7, size=actions)
    logits = np.where(np.arange(7) == hot[:, None], np.float32(200), np.float32(0))
    q_t = atoms[hot]
    np.testing.assert_allclose(rules.categorical_values(atoms, logits), q_t, atol=1e-6)
    r_t, discount_t = np.float32(rng.normal()), np.float32(rng.random())
    scalar = rules.td_target(r_t, discount_t, rules.greedy_value(q_t))
    target = rules.categorical_target(atoms, r_t, discount_t, atoms, logits, q_t)
    close(target, project(scalar[None], np.ones(1, np.float32), atoms))
    close(target @ atoms, np.clip(scalar, -3, 3))
    logits_tm1, a_tm1 = rng.normal(size=(actions, 7)).astype(np.float32), rng.integers(actions)
    loss = rules.categorical_q_learning(atoms, logits_tm1, a_tm1, r_t, discount_t, atoms, logits)
    close(loss, rules.categorical_error(logits_tm1, a_tm1, target))
    double = rules.categorical_double_q_learning(atoms, logits_tm1, a_tm1, r_t, discount_t, atoms, logits, q_t)
    assert loss == double
    entropy = -np.sum(np.where(target > 0, target * np.log(np.maximum(target, 1e-30)), 0))
    assert loss >= entropy - 1e-5  # the cross-entropy is least where the distribution is the target


def test_an_extreme_distribution_has_a_finite_loss_and_gradient():
    logits, target = jnp.array([[1e4, -1e4, 0.0]]), jnp.array([0.0, 1.0, 0.0])
    loss, gradient = jax.value_and_grad(rules.categorical_error)(logits, 0, target)
    assert loss == 2e4
    np.testing.assert_allclose(gradient, [[1.0, -1.0, 0.0]])


@pytest.mark.parametrize("huber_param", [0.0, 1e-6, 0.5, 1.0, 1e6])
@pytest.mark.parametrize("u", [0.0, 1e-9, 0.5, 1.0, 30.0])
def test_one_quantile_is_half_the_huber_loss_and_half_the_absolute_error_at_0(huber_param, u):
    half = rules.quantile_regression_loss([1.0], [0.5], [1.0 + u], huber_param)
    u = np.float32(1.0 + u) - np.float32(1.0)
    huber = u if huber_param == 0 else u * u / 2 if u <= huber_param else huber_param * (u - huber_param / 2)
    np.testing.assert_allclose(half, huber / 2, rtol=1e-5)
    other_side = rules.quantile_regression_loss([1.0 + u], [0.5], [1.0], huber_param)
    np.testing.assert_allclose(other_side, half, rtol=1e-5)


@pytest.mark.parametrize("huber_param", [0.0, 1.0])
def test_the_gradient_of_a_quantile_loss_is_finite_at_its_kinks(huber_param):
    for target in ([0.0], [1.0], [-1.0], [0.0, 1.0, 1e30]):
        gradient = jax.grad(rules.quantile_regression_loss)(
            jnp.zeros(1), jnp.array([0.5]), jnp.array(target), huber_param
        )
        assert np.all(np.isfinite(gradient))
    exact = jax.grad(rules.quantile_regression_loss)(jnp.zeros(1), jnp.array([0.5]), jnp.zeros(1), huber_param)
    assert abs(exact[0]) <= 0.5  # between the slopes of the two sides


@examples
@given(seed=seeds, count=st.sampled_from([1, 4]))
def test_implicit_quantiles_with_kappa_1_are_quantiles_and_scale_with_kappa(seed, count):
    rng = np.random.default_rng(seed)
    dist, selector, following = rng.normal(size=(3, count, 2)).astype(np.float32)
    given = (dist, rng.random(count).astype(np.float32), rng.integers(2), np.float32(1.0), np.float32(0.5))
    assert rules.implicit_quantile(*given, selector, following) == rules.quantile_q_learning(
        *given, selector, following, 1.0
    )
    for kappa in (0.5, 2.0):
        once = rules.quantile_q_learning(*given, selector, following, kappa)
        close(rules.implicit_quantile(*given, selector, following, kappa), once / kappa)
    small = rules.implicit_quantile(*given, selector, following, 1e-5)  # towards 0 it is the quantile loss
    np.testing.assert_allclose(small, rules.quantile_q_learning(*given, selector, following), rtol=1e-3, atol=1e-4)


def test_the_quantile_loss_is_least_at_the_quantiles():
    samples, tau = jnp.arange(1.0, 101.0), rules.quantile_midpoints(5)
    descend = jax.jit(lambda theta: theta - 5.0 * jax.grad(rules.quantile_regression_loss)(theta, tau, samples))
    theta = jnp.zeros(5)
    for _ in range(400):
        theta = descend(theta)
    np.testing.assert_allclose(theta, [10, 30, 50, 70, 90], atol=1.1)


def test_quantiles_of_one_number_are_plain_q_learning():
    q_tm1, q_t = jnp.array([[1.0, 4.0]]), jnp.array([[2.0, 6.0]])
    error = rules.q_learning(q_tm1[0], 0, 1.0, 0.5, q_t[0])
    assert rules.quantile_q_learning(q_tm1, rules.quantile_midpoints(1), 0, 1.0, 0.5, q_t, q_t) == abs(error) / 2


@pytest.mark.parametrize("count", [1, 2, 32, 200])
def test_quantile_midpoints_are_the_middles_of_equal_shares(count):
    tau = rules.quantile_midpoints(count)
    np.testing.assert_allclose(tau, [(2 * i + 1) / (2 * count) for i in range(count)], rtol=1e-6)
    assert tau.shape == (count,)
    with jax.enable_x64(True):
        assert rules.quantile_midpoints(count).dtype == np.float64
