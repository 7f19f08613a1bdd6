"""Rules of one trajectory: a return for every step of it, and the errors of the actions that were taken.

Rows of ``q_tm1`` and ``q_t`` are [T, A]: q_tm1[k] belongs to the state in which a_tm1[k] was taken, q_t[k] to the true
successor. ``cut_t`` marks the steps after which another episode begins (see ``returns``); with ``tx_pair`` the action
values are squashed ones (see ``rescaling``).
"""

from __future__ import annotations

import jax
import jax.numpy as jnp

from jaxq.rules import rescaling, values
from jaxq.rules.one_step import td_error
from jaxq.rules.rescaling import IDENTITY_PAIR, TxPair
from jaxq.rules.shapes import arrays, per_step
from jaxq.types import Array, ArrayLike


def n_step_q_learning(
    q_tm1: ArrayLike,
    a_tm1: ArrayLike,
    target_q_t: ArrayLike,
    a_t: ArrayLike,
    r_t: ArrayLike,
    discount_t: ArrayLike,
    n: int,
    *,
    cut_t: ArrayLike | None = None,
    tx_pair: TxPair = IDENTITY_PAIR,
) -> Array:
    """TD errors of n-step Q-learning.

    delta_t = G^n_t - q_tm1[a_tm1] with G^n the n-step returns of v_t = target_q_t[a_t]; a_t is the greedy action of
    ``target_q_t``, or the online network's for double Q-learning. Shapes: q_tm1, target_q_t [T, A], a_tm1, a_t, r_t,
    discount_t [T], cut_t [T] bool -> [T]. Raises ValueError for other shapes and for n below 1, TypeError for actions
    that are no integers. Mnih et al., 2016; with ``SIGNED_HYPERBOLIC_PAIR`` Kapturowski et al., 2019.

    >>> q_tm1, a_tm1, q_t, a_t = jnp.zeros((2, 2)), jnp.array([0, 1]), jnp.full((2, 2), 4.0), jnp.array([0, 1])
    >>> n_step_q_learning(q_tm1, a_tm1, q_t, a_t, jnp.ones(2), jnp.full(2, 0.5), n=2).tolist()
    [2.5, 3.0]
    """
    q_tm1, a_tm1, target_q_t, a_t, r_t, discount_t = arrays(
        q_tm1=(q_tm1, "TA"),
        a_tm1=(a_tm1, "T"),
        target_q_t=(target_q_t, "TA"),
        a_t=(a_t, "T"),
        r_t=(r_t, "T"),
        discount_t=(discount_t, "T"),
    )
    v_t = jax.vmap(values.action_value)(target_q_t, a_t)
    target_tm1 = rescaling.transformed_n_step_returns(tx_pair, r_t, discount_t, v_t, n, cut_t=cut_t)
    return jax.vmap(td_error)(q_tm1, a_tm1, target_tm1)


def sarsa_lambda(
    q_tm1: ArrayLike,
    a_tm1: ArrayLike,
    r_t: ArrayLike,
    discount_t: ArrayLike,
    q_t: ArrayLike,
    a_t: ArrayLike,
    lambda_: ArrayLike,
    *,
    cut_t: ArrayLike | None = None,
    tx_pair: TxPair = IDENTITY_PAIR,
) -> Array:
    """TD errors of SARSA(lambda), forward view.

    delta_t = G_t - q_tm1[a_tm1] with G the lambda returns of v_t = q_t[a_t]. Shapes: q_tm1, q_t [T, A], a_tm1, r_t,
    discount_t, a_t [T], lambda_ [] or [T], cut_t [T] bool -> [T]. Raises ValueError for other shapes, TypeError for
    actions that are no integers. Sutton and Barto, 2018, section 12.7.

    >>> q_tm1, a_tm1 = jnp.zeros((2, 2)), jnp.array([0, 1])
    >>> q_t, a_t = jnp.array([[2.0, 0.0], [4.0, 0.0]]), jnp.array([0, 0])
    >>> sarsa_lambda(q_tm1, a_tm1, jnp.ones(2), jnp.full(2, 0.5), q_t, a_t, 1.0).tolist()
    [2.5, 3.0]
    """
    q_tm1, a_tm1, r_t, discount_t, q_t, a_t = arrays(
        q_tm1=(q_tm1, "TA"),
        a_tm1=(a_tm1, "T"),
        r_t=(r_t, "T"),
        discount_t=(discount_t, "T"),
        q_t=(q_t, "TA"),
        a_t=(a_t, "T"),
    )
    v_t = jax.vmap(values.action_value)(q_t, a_t)
    target_tm1 = rescaling.transformed_lambda_returns(tx_pair, r_t, discount_t, v_t, lambda_, cut_t=cut_t)
    return jax.vmap(td_error)(q_tm1, a_tm1, target_tm1)


def q_lambda(
    q_tm1: ArrayLike,
    a_tm1: ArrayLike,
    r_t: ArrayLike,
    discount_t: ArrayLike,
    q_t: ArrayLike,
    lambda_: ArrayLike,
    *,
    cut_t: ArrayLike | None = None,
    tx_pair: TxPair = IDENTITY_PAIR,
) -> Array:
    """TD errors of Q(lambda): Peng's with a scalar, Watkins's with the lambda of ``returns.watkins_lambda``.

    delta_t = G_t - q_tm1[a_tm1] with G the lambda returns of v_t = max_a q_t[a]. Shapes: q_tm1, q_t [T, A], a_tm1, r_t,
    discount_t [T], lambda_ [] or [T], cut_t [T] bool -> [T]. Raises ValueError for other shapes, TypeError for actions
    that are no integers. Peng and Williams, *Incremental Multi-Step Q-Learning*, 1996; Watkins, 1989.

    >>> q_tm1, a_tm1, q_t = jnp.zeros((2, 2)), jnp.array([0, 1]), jnp.array([[2.0, 0.0], [4.0, 0.0]])
    >>> q_lambda(q_tm1, a_tm1, jnp.ones(2), jnp.full(2, 0.5), q_t, 0.0).tolist()
    [2.0, 3.0]
    """
    q_tm1, a_tm1, r_t, discount_t, q_t = arrays(
        q_tm1=(q_tm1, "TA"), a_tm1=(a_tm1, "T"), r_t=(r_t, "T"), discount_t=(discount_t, "T"), q_t=(q_t, "TA")
    )
    v_t = jnp.max(q_t, axis=-1)
    target_tm1 = rescaling.transformed_lambda_returns(tx_pair, r_t, discount_t, v_t, lambda_, cut_t=cut_t)
    return jax.vmap(td_error)(q_tm1, a_tm1, target_tm1)


def retrace(
    q_tm1: ArrayLike,
    q_t: ArrayLike,
    a_tm1: ArrayLike,
    a_t: ArrayLike,
    r_t: ArrayLike,
    discount_t: ArrayLike,
    pi_t: ArrayLike,
    mu_t: ArrayLike,
    lambda_: ArrayLike,
    eps: float = 1e-8,
    *,
    cut_t: ArrayLike | None = None,
    tx_pair: TxPair = IDENTITY_PAIR,
) -> Array:
    """TD errors of Retrace(lambda): safe off-policy learning from a trajectory of any policy.

    delta_t = G_t - q_tm1[a_tm1] with G the off-policy returns of c_t = lambda min(1, pi_t[a_t] / (mu_t + eps));
    mu_t is the probability with which a_t was taken. Shapes: q_tm1, q_t, pi_t [T, A], a_tm1, a_t, r_t,
    discount_t, mu_t [T], lambda_ [] or [T], cut_t [T] bool -> [T]. Raises ValueError for other shapes, TypeError for
    actions that are no integers. Munos et al., *Safe and Efficient Off-Policy Reinforcement Learning*, 2016.

    >>> q_tm1, q_t, pi_t = jnp.zeros((2, 2)), jnp.array([[2.0, 4.0], [6.0, 0.0]]), jnp.full((2, 2), 0.5)
    >>> a = jnp.zeros(2, int)
    >>> retrace(q_tm1, q_t, a, a, jnp.ones(2), jnp.full(2, 0.5), pi_t, jnp.full(2, 0.5), 1.0, eps=0.0).tolist()
    [2.75, 2.5]
    """
    q_tm1, q_t, a_tm1, a_t, pi_t = arrays(
        q_tm1=(q_tm1, "TA"), q_t=(q_t, "TA"), a_tm1=(a_tm1, "T"), a_t=(a_t, "T"), pi_t=(pi_t, "TA")
    )
    c_t = retrace_weights(a_t, pi_t, mu_t, lambda_, eps)
    target_tm1 = rescaling.transformed_off_policy_returns(tx_pair, q_t, a_t, r_t, discount_t, c_t, pi_t, cut_t=cut_t)
    return jax.vmap(td_error)(q_tm1, a_tm1, target_tm1)


def retrace_weights(a_t: ArrayLike, pi_t: ArrayLike, mu_t: ArrayLike, lambda_: ArrayLike, eps: float = 1e-8) -> Array:
    """How much of what follows Retrace believes.

    c_t = lambda min(1, pi_t[a_t] / (mu_t + eps)). Shapes: a_t, mu_t [T], pi_t [T, A], lambda_ [] or [T] -> [T]. Raises
    ValueError for other shapes, TypeError for actions that are no integers. Munos et al., 2016.

    >>> retrace_weights(jnp.array([0]), jnp.array([[0.25, 0.75]]), jnp.array([0.5]), 1.0, eps=0.0).tolist()
    [0.5]
    """
    pi_t, a_t, mu_t, lambda_ = arrays(
        pi_t=(pi_t, "TA"), a_t=(a_t, "T"), mu_t=(mu_t, "T"), lambda_=(lambda_, per_step(lambda_))
    )
    # Where eps is too small for the dtype, an action of no probability under either policy has a weight of 0 yet.
    behaviour_t = jnp.maximum(mu_t + eps, jnp.finfo(mu_t.dtype).tiny)
    return lambda_ * jnp.minimum(1, jax.vmap(values.action_value)(pi_t, a_t) / behaviour_t)
