"""Value rescaling: values that are squashed, so that one network serves rewards of any size.

A ``TxPair`` is a squashing function and its inverse. Returns are worked in true values and squashed again; the rules of
``multi_step`` take a pair.

Pohlen et al., *Observe and Look Further*, 2018; Van Hasselt et al., *General Non-Linear Bellman Equations*, 2019.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import jax.numpy as jnp

from jaxq.rules import returns
from jaxq.types import Array, ArrayLike


class TxPair(NamedTuple):
    """A strictly increasing function of values and its inverse, both elementwise."""

    apply: Callable[[Array], Array]
    apply_inv: Callable[[Array], Array]


def signed_hyperbolic(x: ArrayLike, eps: float = 1e-3) -> Array:
    """Squashes a value: near its half at 0, near its root far away, with a slope of at least eps.

    h(x) = sign(x) (sqrt(|x| + 1) - 1) + eps x. Shapes: any, elementwise. Worked as x / (sqrt(|x| + 1) + 1) + eps x,
    which loses no digits near 0. Pohlen et al., *Observe and Look Further*, 2018.

    >>> signed_hyperbolic(jnp.array([-3.0, 0.0, 3.0]), eps=0.0).tolist()
    [-1.0, 0.0, 1.0]
    """
    x, infinite, finite = _parted(x)
    return jnp.where(infinite, x, finite / (jnp.sqrt(jnp.abs(finite) + 1) + 1) + eps * finite)


def signed_parabolic(x: ArrayLike, eps: float = 1e-3) -> Array:
    """The inverse of ``signed_hyperbolic``.

    h^-1(x) = sign(x) (((sqrt(1 + 4 eps (|x| + 1 + eps)) - 1) / (2 eps))^2 - 1). Shapes: any, elementwise. Worked as
    u (|u| + 2), u = 2 x / (sqrt((1 + 2 eps)^2 + 4 eps |x|) + 1 + 2 eps): the formula of the paper subtracts numbers
    that are nearly the same, loses three of float32's seven digits and has none at eps 0. Pohlen et al., 2018.

    >>> signed_parabolic(jnp.array([-1.0, 0.0, 1.0]), eps=0.0).tolist()
    [-3.0, 0.0, 3.0]
    """
    x, infinite, finite = _parted(x)
    u = 2 * finite / (jnp.sqrt((1 + 2 * eps) ** 2 + 4 * eps * jnp.abs(finite)) + (1 + 2 * eps))
    return jnp.where(infinite, x, u * (jnp.abs(u) + 2))


def _parted(x: ArrayLike) -> tuple[Array, Array, Array]:
    """Floating-point numbers, which are infinite, and the finite ones with 0 for these: a mask of -inf stays one."""
    x = jnp.asarray(x)
    x = x if jnp.issubdtype(x.dtype, jnp.inexact) else x.astype(float)
    infinite = jnp.isinf(x)
    return x, infinite, jnp.where(infinite, 0, x)


def _identity(x: Array) -> Array:
    return x


IDENTITY_PAIR = TxPair(_identity, _identity)
SIGNED_HYPERBOLIC_PAIR = TxPair(signed_hyperbolic, signed_parabolic)


def transformed_lambda_returns(
    tx_pair: TxPair,
    r_t: ArrayLike,
    discount_t: ArrayLike,
    v_t: ArrayLike,
    lambda_: ArrayLike = 1.0,
    *,
    cut_t: ArrayLike | None = None,
) -> Array:
    """Lambda returns of squashed values, squashed.

    h(G(r_t, discount_t, h^-1(v_t))). Shapes and errors as ``returns.lambda_returns``. Van Hasselt et al., 2019.

    >>> transformed_lambda_returns(IDENTITY_PAIR, jnp.ones(1), jnp.full(1, 0.5), jnp.full(1, 4.0)).tolist()
    [3.0]
    """
    true = returns.lambda_returns(r_t, discount_t, tx_pair.apply_inv(jnp.asarray(v_t)), lambda_, cut_t=cut_t)
    return tx_pair.apply(true)


def transformed_off_policy_returns(
    tx_pair: TxPair,
    q_t: ArrayLike,
    a_t: ArrayLike,
    r_t: ArrayLike,
    discount_t: ArrayLike,
    c_t: ArrayLike,
    pi_t: ArrayLike,
    *,
    cut_t: ArrayLike | None = None,
) -> Array:
    """Off-policy returns of squashed values, squashed.

    h(G(h^-1(q_t), r_t, discount_t, c_t, pi_t)). Shapes and errors as ``returns.off_policy_returns``. Kapturowski et
    al., *Recurrent Experience Replay in Distributed Reinforcement Learning*, 2019.

    >>> q_t, pi_t = jnp.array([[2.0, 4.0]]), jnp.full((1, 2), 0.5)
    >>> a_t, one = jnp.zeros(1, int), jnp.ones(1)
    >>> transformed_off_policy_returns(IDENTITY_PAIR, q_t, a_t, one, one, 1.0, pi_t).tolist()
    [4.0]
    """
    true = returns.off_policy_returns(tx_pair.apply_inv(jnp.asarray(q_t)), a_t, r_t, discount_t, c_t, pi_t, cut_t=cut_t)
    return tx_pair.apply(true)


def transformed_n_step_returns(
    tx_pair: TxPair,
    r_t: ArrayLike,
    discount_t: ArrayLike,
    v_t: ArrayLike,
    n: int,
    lambda_t: ArrayLike = 1.0,
    *,
    cut_t: ArrayLike | None = None,
) -> Array:
    """n-step returns of squashed values, squashed.

    h(G^n(r_t, discount_t, h^-1(v_t))). Shapes and errors as ``returns.n_step_bootstrapped_returns``. Kapturowski et
    al., *Recurrent Experience Replay in Distributed Reinforcement Learning*, 2019.

    >>> transformed_n_step_returns(IDENTITY_PAIR, jnp.ones(2), jnp.full(2, 0.5), jnp.full(2, 4.0), n=2).tolist()
    [2.5, 3.0]
    """
    true = returns.n_step_bootstrapped_returns(
        r_t, discount_t, tx_pair.apply_inv(jnp.asarray(v_t)), n, lambda_t, cut_t=cut_t
    )
    return tx_pair.apply(true)
