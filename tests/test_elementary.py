"""Sine with cosine, and the logarithm, against float64 NumPy."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxq.elementary import log10, sin_cos

#: Compiled, a product and a sum may be one instruction, which rounds once; one by one they round twice.
WAYS = pytest.mark.parametrize("way", [jax.jit, lambda function: function], ids=["compiled", "one by one"])


@WAYS
@pytest.mark.parametrize("limit", [0.2, 0.8, 3.2, 100.0, 50_000.0])
def test_within_2e_7_of_float64(limit, way):
    angles = np.random.default_rng(0).uniform(-limit, limit, 100_000).astype(np.float32)
    sine, cosine = way(sin_cos)(angles)
    exact = angles.astype(np.float64)
    assert np.abs(sine - np.sin(exact)).max() < 2e-7
    assert np.abs(cosine - np.cos(exact)).max() < 2e-7


@pytest.mark.parametrize("limit", [1e6, 1e12, 3e38])
def test_an_angle_too_large_to_reduce_stays_bounded(limit):
    angles = np.random.default_rng(0).uniform(-limit, limit, 10_000).astype(np.float32)
    for values in jax.jit(sin_cos)(angles):
        assert np.abs(values).max() <= 1 + 2e-7


def test_special_angles():
    sine, cosine = sin_cos(jnp.array([0.0, -0.0, np.nan, np.inf]))
    assert sine[0] == sine[1] == 0
    assert cosine[0] == cosine[1] == 1
    assert np.isnan(sine[2:]).all()
    assert np.isnan(cosine[2:]).all()


def test_odd_and_even_to_the_bit():
    angles = jnp.linspace(0, 20, 1001)
    sine, cosine = sin_cos(angles)
    mirrored_sine, mirrored_cosine = sin_cos(-angles)
    np.testing.assert_array_equal(mirrored_sine, -sine)
    np.testing.assert_array_equal(mirrored_cosine, cosine)


def test_float64_is_numpys():
    with jax.enable_x64(True):
        angles = jnp.linspace(-50, 50, 1001)
        sine, cosine = sin_cos(angles)
        np.testing.assert_allclose(sine, np.sin(angles), atol=1e-15, rtol=0)
        np.testing.assert_allclose(cosine, np.cos(angles), atol=1e-15, rtol=0)


@WAYS
@pytest.mark.parametrize(("low", "high"), [(1, 2**24), (0.5, 2), (1 - 1e-3, 1 + 1e-3), (1.2e-38, 3.4e38)])
def test_the_logarithm_is_close_to_float64(low, high, way):
    exponents = np.random.default_rng(0).uniform(np.log(low), np.log(high), 100_000)
    numbers = np.exp(exponents).astype(np.float32)
    exact = np.log10(numbers.astype(np.float64))
    error = np.abs(way(log10)(numbers) - exact)
    assert np.max(error / np.maximum(1, np.abs(exact))) < (1.2e-7 if way is jax.jit else 2e-7)


def test_the_logarithm_of_special_numbers():
    powers = jnp.float32(10) ** jnp.arange(0, 7)
    np.testing.assert_allclose(log10(powers), np.arange(0, 7), rtol=1.2e-7)
    assert log10(jnp.float32(1)) == 0
    assert np.isnan(log10(jnp.array([np.nan, np.inf], jnp.float32))).all()
    with jax.enable_x64(True):
        numbers = jnp.geomspace(1e-300, 1e300, 1001)
        np.testing.assert_array_equal(log10(numbers), jnp.log10(numbers))
