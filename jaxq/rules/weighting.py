"""A value and its weight, where a weight of 0 leaves nothing."""

from __future__ import annotations

import jax.numpy as jnp

from jaxq.types import Array, ArrayLike


def weighted(weight: ArrayLike, value: ArrayLike) -> Array:
    """weight value, and 0 for nothing of an infinite value: what is never taken, or never reached, may be masked.

    Actions that are not allowed have values of -inf, and where none is, behind a termination, so is the greatest of
    them. A value that is no number stays one: a training that has diverged is not hidden.

    >>> weighted(jnp.array([0.0, 0.5]), jnp.array([-jnp.inf, 4.0])).tolist()
    [0.0, 2.0]
    """
    weight = jnp.asarray(weight)
    return weight * jnp.where((weight == 0) & jnp.isinf(value), 0, value)
