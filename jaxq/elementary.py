"""Sine with cosine and the decimal logarithm of float32 numbers, as plain arithmetic that XLA vectorises and fuses.

On a CPU XLA's own sine and cosine take most of the time of a CartPole step: each reduces the angle for itself, for
angles of any size. Its logarithm of a few lanes stays scalar, and so does every conversion of a float to an integer,
which must mind what does not fit.
"""

from __future__ import annotations

import jax.numpy as jnp
import numpy as np
from jax.lax import bitcast_convert_type

from jaxq.types import Array

# 1.5 * 2^23: added to a number below 2^22, it rounds it to an integer, half to even, and leaves that in the low bits.
_ROUND = np.float32(12582912.0)
# pi / 2 in three parts. The first two have 8 and 9 bits, so that their product with a quadrant below 2^15 is exact.
_HALF_PI = (np.float32(201 / 2**7), np.float32(507 / 2**20), np.float32(np.pi / 2 - 201 / 2**7 - 507 / 2**20))
# Polynomials in r^2 on [-pi/4, pi/4]: (sin r - r) / r^3 and (cos r - 1 + r^2 / 2) / r^4.
_SINE = (np.float32(-1.6666654611e-1), np.float32(8.3321608736e-3), np.float32(-1.9515295891e-4))
_COSINE = (np.float32(4.166664568298827e-2), np.float32(-1.388731625493765e-3), np.float32(2.443315711809948e-5))
# Polynomial in m on [sqrt(1/2) - 1, sqrt(2) - 1]: (ln(1 + m) - m + m^2 / 2) / m^3.
_LOGARITHM = tuple(
    np.float32(c)
    for c in (
        *(3.3333331174e-1, -2.4999993993e-1, 2.0000714765e-1, -1.6668057665e-1, 1.4249322787e-1),
        *(-1.2420140846e-1, 1.1676998740e-1, -1.1514610310e-1, 7.0376836292e-2),
    )
)
_ROOT_OF_HALF = np.float32(np.sqrt(0.5)).view(np.int32)


def sin_cos(angle: Array) -> tuple[Array, Array]:
    """Sine and cosine of an angle in radians.

    Shapes: [...] -> [...] and [...]. float32 within 2e-7 of the true values up to 50,000 rad and within [-1, 1] by
    that much for any finite angle; other dtypes are left to ``jax.numpy``. Coefficients, and the reduction by pi / 2 in
    three parts: Moshier, *Methods and Programs for Mathematical Functions*, 1989 (Cephes, ``sinf`` and ``cosf``).

    >>> [round(float(value), 6) for value in sin_cos(jnp.float32(0.5))]
    [0.479426, 0.877583]
    """
    angle = jnp.asarray(angle)
    if angle.dtype != jnp.float32:
        return jnp.sin(angle), jnp.cos(angle)
    rounded = angle * np.float32(2 / np.pi) + _ROUND
    quadrant = bitcast_convert_type(rounded, jnp.int32) - _ROUND.view(np.int32)
    # NaN for an infinite angle, whose quadrant is some number
    quarters = quadrant.astype(jnp.float32) + (angle - angle)
    r = angle
    for part in _HALF_PI:
        r = r - quarters * part
    r = jnp.clip(r, -0.8, 0.8)  # pi / 4 and a little: without effect unless the angle is too large to reduce
    square = r * r
    sine = r + r * square * _polynomial(square, _SINE)
    cosine = 1 - np.float32(0.5) * square + square * square * _polynomial(square, _COSINE)
    turned = (quadrant & 1) != 0
    s, c = jnp.where(turned, cosine, sine), jnp.where(turned, sine, cosine)
    return jnp.where((quadrant & 2) != 0, -s, s), jnp.where(((quadrant + 1) & 2) != 0, -c, c)


def log10(x: Array) -> Array:
    """Decimal logarithm of a positive number.

    Shapes: [...] -> [...]. float32 from 2^-126 on within 2e-7 of the larger of 1 and the true value, 1.2e-7 where XLA
    fuses products with sums; meaningless below, NaN for NaN and infinity. Other dtypes are left to ``jax.numpy``.
    x = 2^e (1 + m) with m in [sqrt(1/2) - 1, sqrt(2) - 1]; coefficients: Moshier, *Methods and Programs for
    Mathematical Functions*, 1989 (Cephes, ``logf``).

    >>> round(float(log10(jnp.float32(2))), 6)
    0.30103
    """
    x = jnp.asarray(x)
    if x.dtype != jnp.float32:
        return jnp.log10(x)
    bits = bitcast_convert_type(x, jnp.int32)
    e = (bits - _ROOT_OF_HALF) >> 23
    m = bitcast_convert_type(bits - (e << 23), jnp.float32) - 1
    square = m * m
    natural = m - np.float32(0.5) * square + m * square * _polynomial(m, _LOGARITHM)
    value = natural * np.float32(1 / np.log(10)) + e.astype(jnp.float32) * np.float32(np.log10(2))
    return value + (x - x)  # NaN where x is, and for infinity


def _polynomial(x: Array, coefficients: tuple[np.float32, ...]) -> Array:
    value = jnp.full_like(x, coefficients[-1])
    for coefficient in reversed(coefficients[:-1]):
        value = coefficient + x * value
    return value
