"""Running moments: the mean and variance of numbers that come one at a time."""

from __future__ import annotations

from typing import NamedTuple

import jax.numpy as jnp
from jax.typing import DTypeLike

from jaxq.types import Array, ArrayLike

#: What the moments at the start weigh, as if so much of a number had been seen; Gymnasium's.
FIRST_WEIGHT = 1e-4


class Moments(NamedTuple):
    """Mean and variance of what was seen, both [...], and how many numbers that were, the weight, [] float.

    In float32 the weight stands still at 2^24; from there on the mean follows the last 2^24 numbers.
    """

    mean: Array
    variance: Array
    weight: Array


def no_moments(shape: tuple[int, ...] = (), dtype: DTypeLike = jnp.float32) -> Moments:
    """Moments of nothing: mean 0 and variance 1, of little weight."""
    return Moments(jnp.zeros(shape, dtype), jnp.ones(shape, dtype), jnp.asarray(FIRST_WEIGHT, dtype))


def seen(moments: Moments, value: Array) -> Moments:
    """The moments after one more number.

    n' = n + 1, d = x - m, m' = m + d / n', v' = (n v + d^2 n / n') / n'. Shapes: value as the mean. Chan, Golub and
    LeVeque, *Updating Formulae and a Pairwise Algorithm for Computing Sample Variances*, 1979.

    >>> one = seen(no_moments(), jnp.float32(3))
    >>> round(float(one.mean), 3)
    3.0
    """
    mean, variance, weight = moments
    total = weight + 1
    delta = jnp.asarray(value, mean.dtype) - mean
    return Moments(mean + delta / total, (variance * weight + jnp.square(delta) * weight / total) / total, total)


def normalised(moments: Moments, value: Array, epsilon: ArrayLike) -> Array:
    """(x - m) / sqrt(v + epsilon). Shapes: value as the mean."""
    return (jnp.asarray(value, moments.mean.dtype) - moments.mean) / jnp.sqrt(moments.variance + epsilon)
