"""Every public rule equals plain NumPy, keeps dtypes, and is the same under jit, vmap and with lists and numbers."""

from __future__ import annotations

import contextlib
import functools

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from jaxq import rules
from jaxq.verify import rule_cases as cases

EACH = pytest.mark.parametrize("name", cases.NAMES)
BATCH = 8


@functools.cache
def batched(name):
    return jax.jit(lambda given: jax.vmap(lambda one: cases.rule(name)(**one))(given))


def batch_of(name, seed, dtype, lengths):
    rng = np.random.default_rng(seed)
    singles = [cases.arguments(name, rng, dtype, lengths, ties=i % 2 == 1) for i in range(BATCH)]
    return singles, {key: np.stack([single[key] for single in singles]) for key in singles[0]}


def test_no_public_rule_is_missing_here():
    assert set(cases.NAMES) | cases.OTHERS == set(rules.__all__)
    assert len(set(rules.__all__)) == len(rules.__all__)
    assert all(hasattr(rules, name) for name in rules.__all__)


@EACH
@settings(max_examples=5, deadline=None, derandomize=True)
@given(seed=st.integers(0, 2**32 - 1), lengths=st.sampled_from(cases.LENGTHS))
def test_float32_batches_equal_plain_numpy(name, seed, lengths):
    singles, batch = batch_of(name, seed, np.float32, lengths)
    expected = np.stack([cases.reference(name)(**cases.in_float64(single)) for single in singles])
    result = batched(name)(batch)
    assert result.dtype == np.float32
    np.testing.assert_allclose(result, expected, rtol=1e-5, atol=2e-5)


@EACH
@settings(max_examples=2, deadline=None, derandomize=True)
@given(seed=st.integers(0, 2**32 - 1))
def test_float64_batches_equal_plain_numpy(name, seed):
    singles, batch = batch_of(name, seed, np.float64, cases.LENGTHS[0])
    expected = np.stack([cases.reference(name)(**single) for single in singles])
    with jax.enable_x64(True):
        result = batched(name)(batch)
    assert result.dtype == np.float64
    np.testing.assert_allclose(result, expected, rtol=1e-12, atol=1e-12)


@EACH
def test_outside_jit_and_with_lists_and_python_numbers_the_result_is_the_same(name):
    singles, batch = batch_of(name, 1, np.float32, cases.LENGTHS[0])
    by_batch, plain = batched(name)(batch)[0], cases.rule(name)(**singles[0])
    listed = cases.rule(name)(**{key: value.tolist() for key, value in singles[0].items()}) if lists(name) else plain
    np.testing.assert_allclose(plain, by_batch, rtol=1e-5, atol=1e-6)
    np.testing.assert_allclose(listed, plain, rtol=1e-6, atol=1e-6)
    assert np.shape(listed) == plain.shape
    assert isinstance(plain, jax.Array)
    assert plain.dtype == np.float32


def lists(name):
    return name not in ("polyak_update", "periodic_update")  # to these a list is a tree


def strong(name, dtype, *, numbers=False):
    """Strongly typed arguments; with ``numbers``, scalars as a user would type them."""
    given = cases.arguments(name, np.random.default_rng(2), dtype, cases.LENGTHS[0])
    return {key: value.item() if numbers and not value.ndim else jnp.asarray(value) for key, value in given.items()}


@EACH
@pytest.mark.parametrize("dtype", [np.float32, np.float64])
def test_the_dtype_is_kept_and_strong(name, dtype):
    with jax.enable_x64(True):  # in float32 too: a stray Python float would turn the result into float64
        result = jax.eval_shape(lambda given: cases.rule(name)(**given), strong(name, dtype))
        assert result.dtype == dtype
        assert not result.weak_type


@EACH
@pytest.mark.parametrize("x64", [False, True])
def test_python_numbers_do_not_change_the_dtype(name, x64):
    with jax.enable_x64(True) if x64 else contextlib.nullcontext():
        given = strong(name, np.float32, numbers=True)
        result = jax.eval_shape(lambda given: cases.rule(name)(**given), given)
        if any(getattr(value, "ndim", 0) for value in given.values()):
            assert result.dtype == np.float32
            assert not result.weak_type
        else:
            assert result.weak_type  # numbers alone: no dtype was asked for


def test_float64_is_worked_in_float64():
    with jax.enable_x64(True):
        q_tm1, q_t = jnp.array([1.0, 1.0 + 1e-12]), jnp.array([1.0, 1.0 + 1e-12])
        error = rules.q_learning(q_tm1, jnp.array(0), jnp.float64(0), jnp.float64(1), q_t)
    np.testing.assert_allclose(error, 1e-12, rtol=1e-3)


@pytest.mark.parametrize("name", [name for name, given in cases.RULES.items() if any("T" in s for _, s in given)])
def test_a_trajectory_without_steps_has_no_returns_and_a_gradient(name):
    given = cases.arguments(name, np.random.default_rng(3), np.float32, {**cases.LENGTHS[0], "T": 0})
    assert cases.rule(name)(**given).shape == (0,)

    def total(of):
        return jnp.sum(cases.rule(name)(**{**given, **of}))

    gradients = jax.grad(total)({key: jnp.asarray(value) for key, value in cases.floats(given).items()})
    assert all(gradients[key].shape == given[key].shape for key in gradients)
