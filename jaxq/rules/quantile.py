"""Rules for quantiles of the return: QR-DQN and implicit quantile networks.

``dist_q`` is [N, A]: N quantiles of each action's return; ``tau`` [N] says which ones. The error of such a rule is a
loss: the quantile regression of what the action taken predicts on the quantiles of the target.

Dabney et al., *Distributional Reinforcement Learning with Quantile Regression*, 2018; Dabney et al., *Implicit Quantile
Networks for Distributional Reinforcement Learning*, 2018.
"""

from __future__ import annotations

import jax
import jax.numpy as jnp

from jaxq.rules.indexing import taken
from jaxq.rules.shapes import arrays, whole
from jaxq.types import Array, ArrayLike


def quantile_midpoints(count: int) -> Array:
    """The quantiles that QR-DQN predicts.

    tau_i = (2 i + 1) / (2 N), i = 0 .. N - 1. Shapes: -> [N]. Raises ValueError for a count below 1. Dabney et al.,
    2018 (QR-DQN), lemma 2.

    >>> quantile_midpoints(2).tolist()
    [0.25, 0.75]
    """
    count = whole("count", count)
    return (jnp.arange(count, dtype=float) + 0.5) / count


def quantile_values(dist_q: ArrayLike) -> Array:
    """Action values of quantiles: their means.

    q[a] = 1/N sum_i dist_q[i, a]. Shapes: dist_q [N, A] -> [A]. Raises ValueError for other shapes. Dabney et al.,
    2018.

    >>> quantile_values(jnp.array([[0.0, 1.0], [2.0, 1.0]])).tolist()
    [1.0, 1.0]
    """
    (dist_q,) = arrays(dist_q=(dist_q, "NA"))
    return jnp.mean(dist_q, axis=0)


def quantile_regression_loss(
    dist_src: ArrayLike, tau_src: ArrayLike, dist_target: ArrayLike, huber_param: ArrayLike = 0.0
) -> Array:
    """Quantile regression of N predictions on samples of a target.

    L = sum_i mean_j |tau_i - 1(u_ij < 0)| H(u_ij), u_ij = dist_target[j] - dist_src[i]; H(u) = |u| with ``huber_param``
    0, else the Huber loss: u^2 / 2 up to huber_param, then its tangent. Shapes: dist_src [N], tau_src [N] in [0, 1],
    dist_target [M], huber_param [] -> []. Raises ValueError for other shapes. Dabney et al., 2018 (QR-DQN), equations 9
    and 10.

    >>> float(quantile_regression_loss(jnp.array([1.0]), jnp.array([0.25]), jnp.array([2.0, 0.0])))  # (0.25 + 0.75) / 2
    0.5
    """
    dist_src, tau_src, dist_target, huber_param = arrays(
        dist_src=(dist_src, "N"), tau_src=(tau_src, "N"), dist_target=(dist_target, "M"), huber_param=(huber_param, "")
    )
    error = dist_target[None, :] - dist_src[:, None]
    size = jnp.abs(error)
    near = jnp.minimum(size, huber_param)
    distance = jnp.where(huber_param > 0, near * (size - 0.5 * near), size)
    # Two means and one weight each, not a weight for every pair: a third of the time.
    above = jnp.mean(jnp.where(error < 0, 0, distance), axis=1)
    below = jnp.mean(jnp.where(error < 0, distance, 0), axis=1)
    return jnp.sum(tau_src * above + (1 - tau_src) * below)


def quantile_target(r_t: ArrayLike, discount_t: ArrayLike, dist_q_t_selector: ArrayLike, dist_q_t: ArrayLike) -> Array:
    """Quantiles that one transition moves towards: the successor's, of the selected action, shrunk and shifted.

    G[j] = r_t + discount_t dist_q_t[j, a*], a* = argmax_a of the means of dist_q_t_selector. Shapes: dist_q_t [N, A],
    dist_q_t_selector [M, A], the rest [] -> [N]. Raises ValueError for other shapes. Dabney et al., 2018.

    >>> quantile_target(1.0, 0.5, jnp.array([[0.0, 1.0]]), jnp.array([[9.0, 2.0], [9.0, 4.0]])).tolist()
    [2.0, 3.0]
    """
    r_t, discount_t, dist_q_t, dist_q_t_selector = arrays(
        r_t=(r_t, ""),
        discount_t=(discount_t, ""),
        dist_q_t=(dist_q_t, "NA"),
        dist_q_t_selector=(dist_q_t_selector, "MA"),
    )
    return r_t + discount_t * taken(dist_q_t, jnp.argmax(quantile_values(dist_q_t_selector)), axis=1)


def quantile_error(
    dist_q_tm1: ArrayLike, tau_q_tm1: ArrayLike, a_tm1: ArrayLike, target_tm1: ArrayLike, huber_param: ArrayLike = 0.0
) -> Array:
    """Quantile regression of the action taken on a target, with a gradient through ``dist_q_tm1`` alone.

    L = ``quantile_regression_loss`` of dist_q_tm1[:, a_tm1]. Shapes: dist_q_tm1 [N, A], tau_q_tm1 [N], target_tm1 [M],
    the rest [] -> []. Raises ValueError for other shapes, TypeError for an action that is no integer. Dabney et al.,
    2018.

    >>> float(quantile_error(jnp.array([[1.0, 7.0]]), jnp.array([0.25]), jnp.array(0), jnp.array([2.0, 0.0])))
    0.5
    """
    dist_q_tm1, *constants = arrays(
        dist_q_tm1=(dist_q_tm1, "NA"),
        tau_q_tm1=(tau_q_tm1, "N"),
        a_tm1=(a_tm1, ""),
        target_tm1=(target_tm1, "M"),
        huber_param=(huber_param, ""),
    )
    tau_q_tm1, a_tm1, target_tm1, huber_param = jax.lax.stop_gradient(constants)
    return quantile_regression_loss(taken(dist_q_tm1, a_tm1, axis=1), tau_q_tm1, target_tm1, huber_param)


def quantile_q_learning(
    dist_q_tm1: ArrayLike,
    tau_q_tm1: ArrayLike,
    a_tm1: ArrayLike,
    r_t: ArrayLike,
    discount_t: ArrayLike,
    dist_q_t_selector: ArrayLike,
    dist_q_t: ArrayLike,
    huber_param: ArrayLike = 0.0,
) -> Array:
    """Loss of Q-learning for quantiles: QR-DQN, and double where the selector is the online network's.

    L = ``quantile_error`` of the ``quantile_target``. Shapes: dist_q_tm1 [N, A], tau_q_tm1 [N], dist_q_t_selector and
    dist_q_t of the same or other numbers of quantiles, the rest [] -> []. Raises ValueError for other shapes, TypeError
    for an action that is no integer. Dabney et al., 2018 (QR-DQN).

    >>> dist = jnp.array([[0.0, 2.0], [0.0, 4.0]])
    >>> float(quantile_q_learning(dist, quantile_midpoints(2), jnp.array(1), 1.0, 0.5, dist, dist))  # 0.125 + 0.375
    0.5
    """
    dist_q_tm1, dist_q_t = arrays(dist_q_tm1=(dist_q_tm1, "NA"), dist_q_t=(dist_q_t, "MA"))
    target_tm1 = quantile_target(r_t, discount_t, dist_q_t_selector, dist_q_t)
    return quantile_error(dist_q_tm1, tau_q_tm1, a_tm1, target_tm1, huber_param)


def implicit_quantile(
    dist_q_tm1: ArrayLike,
    tau_q_tm1: ArrayLike,
    a_tm1: ArrayLike,
    r_t: ArrayLike,
    discount_t: ArrayLike,
    dist_q_t_selector: ArrayLike,
    dist_q_t: ArrayLike,
    huber_param: ArrayLike = 1.0,
) -> Array:
    """Loss of implicit quantile networks, whose quantiles are drawn anew for each transition.

    L = 1/kappa sum_i mean_j |tau_i - 1(u_ij < 0)| H_kappa(u_ij): ``quantile_q_learning`` over kappa, ``huber_param``,
    which must be above 0. The caller draws ``tau_q_tm1``, and the quantiles of selector and target, uniformly from
    [0, 1]. Shapes and errors as ``quantile_q_learning``. Dabney et al., 2018 (IQN), equations 2 and 3.

    >>> dist, tau = jnp.array([[0.0, 2.0], [0.0, 4.0]]), jnp.array([0.3, 0.9])
    >>> once = implicit_quantile(dist, tau, jnp.array(1), 1.0, 0.5, dist, dist)
    >>> bool(once == quantile_q_learning(dist, tau, jnp.array(1), 1.0, 0.5, dist, dist, huber_param=1.0))
    True
    """
    loss = quantile_q_learning(dist_q_tm1, tau_q_tm1, a_tm1, r_t, discount_t, dist_q_t_selector, dist_q_t, huber_param)
    return loss / jax.lax.stop_gradient(huber_param)
