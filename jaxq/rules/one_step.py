"""Rules of one transition: a target out of the successor's value, and the error of the action that was taken.

``td_error`` is the one place that stops the gradient: what is moved towards is a constant, and only ``q_tm1`` is
differentiated. Every named rule is a value put into ``td_target`` and that into ``td_error``.
"""

from __future__ import annotations

import jax
import jax.numpy as jnp

from jaxq.rules import values
from jaxq.rules.shapes import arrays
from jaxq.rules.weighting import weighted
from jaxq.types import Array, ArrayLike


def td_target(r_t: ArrayLike, discount_t: ArrayLike, v_t: ArrayLike) -> Array:
    """What one transition says that its action was worth.

    G = r_t + discount_t v_t, and r_t behind a termination, be v_t infinite. Shapes: all [] -> []. Raises ValueError for
    other shapes. Sutton and Barto, *Reinforcement Learning*, 2018, equation 6.2.

    >>> float(td_target(1.0, 0.5, jnp.array(4.0)))
    3.0
    """
    r_t, discount_t, v_t = arrays(r_t=(r_t, ""), discount_t=(discount_t, ""), v_t=(v_t, ""))
    return r_t + weighted(discount_t, v_t)


def td_error(q_tm1: ArrayLike, a_tm1: ArrayLike, target_tm1: ArrayLike) -> Array:
    """Temporal-difference error of one action value, with no gradient through the target.

    delta = target_tm1 - q_tm1[a_tm1]. Shapes: q_tm1 [A], the rest [] -> []. Raises ValueError for other shapes,
    TypeError for an action that is no integer. Sutton and Barto, 2018, equation 6.5.

    >>> float(td_error(jnp.array([0.5, 2.0]), jnp.array(1), 3.0))
    1.0
    """
    q_tm1, a_tm1, target_tm1 = arrays(q_tm1=(q_tm1, "A"), a_tm1=(a_tm1, ""), target_tm1=(target_tm1, ""))
    return jax.lax.stop_gradient(target_tm1) - values.action_value(q_tm1, a_tm1)


def q_learning(q_tm1: ArrayLike, a_tm1: ArrayLike, r_t: ArrayLike, discount_t: ArrayLike, q_t: ArrayLike) -> Array:
    """TD error of Q-learning.

    delta = r_t + discount_t max_a q_t[a] - q_tm1[a_tm1]. Shapes: q_tm1 [A], q_t [A], the rest [] -> []. Raises
    ValueError and TypeError as ``td_error``. Watkins and Dayan, *Q-learning*, 1992.

    >>> float(q_learning(jnp.array([0.5, 2.0]), jnp.array(0), 1.0, 0.9, jnp.array([0.0, 10.0])))
    9.5
    """
    q_tm1, q_t = arrays(q_tm1=(q_tm1, "A"), q_t=(q_t, "A"))
    return td_error(q_tm1, a_tm1, td_target(r_t, discount_t, values.greedy_value(q_t)))


def double_q_learning(
    q_tm1: ArrayLike,
    a_tm1: ArrayLike,
    r_t: ArrayLike,
    discount_t: ArrayLike,
    q_t_value: ArrayLike,
    q_t_selector: ArrayLike,
) -> Array:
    """TD error of double Q-learning.

    delta = r_t + discount_t q_t_value[argmax_a q_t_selector[a]] - q_tm1[a_tm1]. Shapes: q_tm1, q_t_value and
    q_t_selector [A], the rest [] -> []. Raises ValueError and TypeError as ``td_error``. Van Hasselt, *Double
    Q-learning*, 2010.

    >>> q_tm1, value, selector = jnp.array([0.5, 2.0]), jnp.array([4.0, 10.0]), jnp.array([3.0, 2.0])
    >>> float(double_q_learning(q_tm1, jnp.array(0), 1.0, 0.5, value, selector))
    2.5
    """
    q_tm1, q_t_value = arrays(q_tm1=(q_tm1, "A"), q_t_value=(q_t_value, "A"))
    return td_error(q_tm1, a_tm1, td_target(r_t, discount_t, values.double_value(q_t_value, q_t_selector)))


def sarsa(
    q_tm1: ArrayLike, a_tm1: ArrayLike, r_t: ArrayLike, discount_t: ArrayLike, q_t: ArrayLike, a_t: ArrayLike
) -> Array:
    """TD error of SARSA.

    delta = r_t + discount_t q_t[a_t] - q_tm1[a_tm1], a_t the action taken next. Shapes: q_tm1, q_t [A], the rest []
    -> []. Raises ValueError and TypeError as ``td_error``. Rummery and Niranjan, 1994; Sutton and Barto, 2018,
    equation 6.7.

    >>> float(sarsa(jnp.array([0.5, 2.0]), jnp.array(0), 1.0, 0.5, jnp.array([4.0, 10.0]), jnp.array(0)))
    2.5
    """
    q_tm1, q_t = arrays(q_tm1=(q_tm1, "A"), q_t=(q_t, "A"))
    return td_error(q_tm1, a_tm1, td_target(r_t, discount_t, values.action_value(q_t, a_t)))


def expected_sarsa(
    q_tm1: ArrayLike, a_tm1: ArrayLike, r_t: ArrayLike, discount_t: ArrayLike, q_t: ArrayLike, probs_a_t: ArrayLike
) -> Array:
    """TD error of expected SARSA.

    delta = r_t + discount_t sum_a probs_a_t[a] q_t[a] - q_tm1[a_tm1]. Shapes: q_tm1, q_t, probs_a_t [A], the rest []
    -> []. Raises ValueError and TypeError as ``td_error``. Van Seijen et al., *A Theoretical and Empirical Analysis of
    Expected Sarsa*, 2009.

    >>> float(expected_sarsa(jnp.array([0.5, 2.0]), 0, 1.0, 0.5, jnp.array([4.0, 8.0]), jnp.array([0.75, 0.25])))
    3.0
    """
    q_tm1, q_t = arrays(q_tm1=(q_tm1, "A"), q_t=(q_t, "A"))
    return td_error(q_tm1, a_tm1, td_target(r_t, discount_t, values.expected_value(q_t, probs_a_t)))


def soft_q_learning(
    q_tm1: ArrayLike, a_tm1: ArrayLike, r_t: ArrayLike, discount_t: ArrayLike, q_t: ArrayLike, temperature: ArrayLike
) -> Array:
    """TD error of soft Q-learning, whose optimal policy is the Boltzmann policy of its own action values.

    delta = r_t + discount_t tau log sum_a exp(q_t[a] / tau) - q_tm1[a_tm1]. Shapes: q_tm1, q_t [A], the rest [] -> [].
    tau must be above 0. Raises ValueError and TypeError as ``td_error``. Haarnoja et al., *Reinforcement Learning with
    Deep Energy-Based Policies*, 2017.

    >>> round(float(soft_q_learning(jnp.zeros(2), 0, 1.0, 0.5, jnp.zeros(2), 2.0)), 4)  # 1 + 0.5 * 2 log 2
    1.6931
    """
    q_tm1, q_t = arrays(q_tm1=(q_tm1, "A"), q_t=(q_t, "A"))
    return td_error(q_tm1, a_tm1, td_target(r_t, discount_t, values.soft_value(q_t, temperature)))


def munchausen_q_learning(
    q_tm1: ArrayLike,
    a_tm1: ArrayLike,
    r_t: ArrayLike,
    discount_t: ArrayLike,
    q_t: ArrayLike,
    q_tm1_target: ArrayLike,
    temperature: ArrayLike = 0.03,
    munchausen_scale: ArrayLike = 0.9,
    clip_min: ArrayLike = -1.0,
) -> Array:
    """TD error of Munchausen Q-learning: soft Q-learning whose reward includes the log-probability of the action.

    delta = r_t + alpha clip(tau log pi(a_tm1), l_0, 0) + discount_t sum_a pi_t[a] (q_t[a] - tau log pi_t[a])
    - q_tm1[a_tm1], pi = softmax(q_tm1_target / tau), pi_t = softmax(q_t / tau); the sum is the soft value of q_t.
    alpha is ``munchausen_scale`` and l_0 ``clip_min``; the defaults are the paper's. Shapes: q_tm1, q_t, q_tm1_target
    [A], the rest [] -> []. ``q_t`` and ``q_tm1_target`` come from the target network. tau must be above 0. Raises
    ValueError and TypeError as ``td_error``. Vieillard, Pietquin and Geist, *Munchausen Reinforcement Learning*, 2020.

    >>> q = jnp.array([0.0, 10.0])  # the other action is so much better that the bonus is clipped: 1 - 0.9
    >>> round(float(munchausen_q_learning(q, jnp.array(0), 1.0, 0.0, q, q)), 4)
    0.1
    """
    q_tm1, q_tm1_target = arrays(q_tm1=(q_tm1, "A"), q_tm1_target=(q_tm1_target, "A"))
    a_tm1, r_t, munchausen_scale, clip_min = arrays(
        a_tm1=(a_tm1, ""), r_t=(r_t, ""), munchausen_scale=(munchausen_scale, ""), clip_min=(clip_min, "")
    )
    scaled_log_pi = values.action_value(q_tm1_target, a_tm1) - values.soft_value(q_tm1_target, temperature)
    bonus = munchausen_scale * jnp.clip(scaled_log_pi, clip_min, 0)
    return soft_q_learning(q_tm1, a_tm1, r_t + bonus, discount_t, q_t, temperature)


def advantage_learning(
    q_tm1: ArrayLike,
    a_tm1: ArrayLike,
    r_t: ArrayLike,
    discount_t: ArrayLike,
    q_t: ArrayLike,
    q_tm1_target: ArrayLike,
    action_gap_scale: ArrayLike,
) -> Array:
    """TD error of advantage learning, which lowers an action by its distance from the best.

    delta = r_t + discount_t max_a q_t[a] - alpha (max_a q_tm1_target[a] - q_tm1_target[a_tm1]) - q_tm1[a_tm1].
    Shapes: q_tm1, q_t, q_tm1_target [A], the rest [] -> []. alpha, ``action_gap_scale``, is in [0, 1). ``q_t`` and
    ``q_tm1_target`` come from the target network. Raises ValueError and TypeError as ``td_error``. Baird, 1999;
    Bellemare et al., *Increasing the Action Gap*, 2016.

    >>> q = jnp.array([1.0, 3.0])
    >>> float(advantage_learning(q, jnp.array(0), 1.0, 0.5, q, q, 0.25))  # 1 + 1.5 - 0.5 - 1
    1.0
    """
    q_tm1, q_t, q_tm1_target = arrays(q_tm1=(q_tm1, "A"), q_t=(q_t, "A"), q_tm1_target=(q_tm1_target, "A"))
    a_tm1, action_gap_scale = arrays(a_tm1=(a_tm1, ""), action_gap_scale=(action_gap_scale, ""))
    gap = values.greedy_value(q_tm1_target) - values.action_value(q_tm1_target, a_tm1)
    target_tm1 = td_target(r_t, discount_t, values.greedy_value(q_t)) - action_gap_scale * gap
    return td_error(q_tm1, a_tm1, target_tm1)


def persistent_q_learning(
    q_tm1: ArrayLike,
    a_tm1: ArrayLike,
    r_t: ArrayLike,
    discount_t: ArrayLike,
    q_t: ArrayLike,
    action_gap_scale: ArrayLike,
) -> Array:
    """TD error of persistent Q-learning, which bootstraps in part from repeating the action.

    delta = r_t + discount_t ((1 - alpha) max_a q_t[a] + alpha q_t[a_tm1]) - q_tm1[a_tm1]. Shapes: q_tm1, q_t [A], the
    rest [] -> []. alpha, ``action_gap_scale``, is in [0, 1]. Raises ValueError and TypeError as ``td_error``. Bellemare
    et al., *Increasing the Action Gap*, 2016.

    >>> float(persistent_q_learning(jnp.zeros(2), jnp.array(0), 1.0, 0.5, jnp.array([2.0, 6.0]), 0.5))
    3.0
    """
    q_tm1, q_t = arrays(q_tm1=(q_tm1, "A"), q_t=(q_t, "A"))
    a_tm1, action_gap_scale = arrays(a_tm1=(a_tm1, ""), action_gap_scale=(action_gap_scale, ""))
    greedy, repeated = values.greedy_value(q_t), values.action_value(q_t, a_tm1)
    v_t = weighted(1 - action_gap_scale, greedy) + weighted(action_gap_scale, repeated)
    return td_error(q_tm1, a_tm1, td_target(r_t, discount_t, v_t))


def persistent_advantage_learning(
    q_tm1: ArrayLike,
    a_tm1: ArrayLike,
    r_t: ArrayLike,
    discount_t: ArrayLike,
    q_t: ArrayLike,
    q_tm1_target: ArrayLike,
    action_gap_scale: ArrayLike,
) -> Array:
    """TD error of persistent advantage learning: advantage learning, but no less than repeating the action gives.

    delta = max(delta of ``advantage_learning``, r_t + discount_t q_t[a_tm1] - q_tm1[a_tm1]). Shapes: q_tm1, q_t,
    q_tm1_target [A], the rest [] -> []. The paper's operator; where alpha weighs the second gap too, as in some agents
    for Atari, it is the maximum of ``advantage_learning`` and ``persistent_q_learning``. Raises ValueError and
    TypeError as ``td_error``. Bellemare et al., *Increasing the Action Gap*, 2016.

    >>> q = jnp.array([1.0, 3.0])
    >>> float(persistent_advantage_learning(q, jnp.array(0), 1.0, 0.5, q, q, 0.75))  # max(0, 1 + 0.5 - 1)
    0.5
    """
    of_advantage = advantage_learning(q_tm1, a_tm1, r_t, discount_t, q_t, q_tm1_target, action_gap_scale)
    return jnp.maximum(of_advantage, sarsa(q_tm1, a_tm1, r_t, discount_t, q_t, a_tm1))


def averaged_q_learning(
    q_tm1: ArrayLike, a_tm1: ArrayLike, r_t: ArrayLike, discount_t: ArrayLike, q_t: ArrayLike
) -> Array:
    """TD error of Q-learning towards the mean of an ensemble, or of the last target networks.

    delta = r_t + discount_t max_a 1/K sum_k q_t[k, a] - q_tm1[a_tm1]. Shapes: q_tm1 [A], q_t [K, A], the rest [] -> [].
    Raises ValueError and TypeError as ``td_error``. Anschel, Baram and Shimkin, *Averaged-DQN*, 2017.

    >>> float(averaged_q_learning(jnp.zeros(2), jnp.array(0), 1.0, 0.5, jnp.array([[0.0, 4.0], [2.0, 8.0]])))
    4.0
    """
    return q_learning(q_tm1, a_tm1, r_t, discount_t, values.averaged(q_t))


def maxmin_q_learning(
    q_tm1: ArrayLike, a_tm1: ArrayLike, r_t: ArrayLike, discount_t: ArrayLike, q_t: ArrayLike
) -> Array:
    """TD error of Maxmin Q-learning, towards the least of an ensemble.

    delta = r_t + discount_t max_a min_k q_t[k, a] - q_tm1[a_tm1]. Shapes: q_tm1 [A], q_t [K, A], the rest [] -> [].
    With ``random_subset`` it is the rule of REDQ. Raises ValueError and TypeError as ``td_error``. Lan et al., *Maxmin
    Q-learning*, 2020; Chen et al., *Randomized Ensembled Double Q-Learning*, 2021.

    >>> float(maxmin_q_learning(jnp.zeros(2), jnp.array(0), 1.0, 0.5, jnp.array([[0.0, 4.0], [2.0, 8.0]])))
    3.0
    """
    return q_learning(q_tm1, a_tm1, r_t, discount_t, values.maxmin(q_t))
