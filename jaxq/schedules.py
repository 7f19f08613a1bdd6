"""Schedules: functions of a counter. Numbers may be traced."""

from __future__ import annotations

import jax.numpy as jnp

from jaxq.elementary import log10
from jaxq.types import Array


def linear(count: Array, start: Array, end: Array, horizon: Array) -> Array:
    """Straight line from ``start`` at count 0 to ``end`` at ``horizon``, then constant.

    s = start (1 - f) + end f, f = min(count / horizon, 1). Shapes: all [] -> []. A horizon of 0 gives ``end``.

    >>> float(linear(jnp.array(5), 1.0, 0.0, 10))
    0.5
    """
    horizon = jnp.asarray(horizon, jnp.result_type(float))
    fraction = jnp.where(horizon > 0, jnp.minimum(count / jnp.where(horizon > 0, horizon, 1), 1), 1)
    return start * (1 - fraction) + end * fraction  # exact at both ends


def exponential(count: Array, start: Array, end: Array, scale: Array) -> Array:
    """Exponential approach from ``start`` to ``end``.

    s = end + (start - end) exp(-count / scale). Shapes: all [] -> []. The scale must not be 0.

    >>> round(float(exponential(jnp.array(1000), 0.9, 0.05, 1000.0)), 6)  # 0.05 + 0.85 / e
    0.362698
    """
    return end + (start - end) * jnp.exp(-count / scale)


def log10_decay(count: Array, low: Array, high: Array, coefficient: Array) -> Array:
    """The tutorial's schedule: one minus a decimal logarithm, clipped.

    s = clip(1 - log10((count + 1) / coefficient), low, high). Shapes: all [] -> [].

    >>> float(log10_decay(jnp.array(0), 0.01, 1.0, 25.0))
    1.0
    """
    dtype = jnp.result_type(float, coefficient)
    # The coefficient's logarithm on its own: it leaves the loop, and the division of every step with it.
    decay = log10(jnp.asarray(count + 1, dtype)) - log10(jnp.asarray(coefficient, dtype))
    return jnp.clip(1 - decay, low, high)
