"""The mathematics of value-based learning: one transition at a time, scalars and one row of action values.

Batches are the caller's ``jax.vmap``. Names carry the timeline: ``q_tm1``, ``a_tm1`` belong to the state that was left
(Sutton and Barto's S_t, A_t), ``r_t``, ``discount_t``, ``q_t`` to the one that was reached (R_{t+1}, S_{t+1}).
``discount_t`` is gamma times 0 after a termination and gamma times 1 otherwise, truncation included, so that
termination, gamma and n-step all pass through one argument.

A rule is *which value of the next state* put into *one TD error*: double Q-learning is an array you pass. ``td_error``
is the one place that stops the gradient: what is moved towards is a constant, and only ``q_tm1`` is differentiated.
"""

from __future__ import annotations

import jax
import jax.numpy as jnp

from jaxq.types import Array


def greedy_value(q_t: Array) -> Array:
    """Value of the next state under the greedy policy.

    v_t = max_a q_t[a]. Shapes: q_t [A] -> []. Watkins, *Learning from Delayed Rewards*, 1989.

    >>> float(greedy_value(jnp.array([1.0, 3.0])))
    3.0
    """
    return jnp.max(q_t)


def double_value(q_t: Array, selector_t: Array) -> Array:
    """Value of the next state where one estimate selects the action and another one values it.

    v_t = q_t[argmax_a selector_t[a]]. Shapes: q_t [A], selector_t [A] -> []. Van Hasselt, *Double Q-learning*, 2010;
    in DQN ``q_t`` comes from the target network and ``selector_t`` from the online one (Van Hasselt et al., 2016).

    >>> float(double_value(jnp.array([1.0, 3.0]), jnp.array([5.0, 4.0])))
    1.0
    """
    return _pick(q_t, jnp.argmax(selector_t))


def sarsa_value(q_t: Array, a_t: Array) -> Array:
    """Value of the next state under the action that is taken there.

    v_t = q_t[a_t]. Shapes: q_t [A], a_t [] -> []. Rummery and Niranjan, 1994; Sutton and Barto, 2018, section 6.4.

    >>> float(sarsa_value(jnp.array([1.0, 3.0]), jnp.array(0)))
    1.0
    """
    return _pick(q_t, a_t)


def expected_value(q_t: Array, probs_t: Array) -> Array:
    """Expected value of the next state under a policy.

    v_t = sum_a probs_t[a] q_t[a]. Shapes: q_t [A], probs_t [A] -> []. Van Seijen et al., *A Theoretical and Empirical
    Analysis of Expected Sarsa*, 2009.

    >>> float(expected_value(jnp.array([1.0, 3.0]), jnp.array([0.25, 0.75])))
    2.5
    """
    return jnp.sum(probs_t * q_t)


def td_error(q_tm1: Array, a_tm1: Array, r_t: Array, discount_t: Array, v_t: Array) -> Array:
    """Temporal-difference error of one action value.

    delta = r_t + discount_t v_t - q_tm1[a_tm1], with no gradient through the target r_t + discount_t v_t.
    Shapes: q_tm1 [A], the rest [] -> [].
    Sutton and Barto, *Reinforcement Learning*, 2018, equation 6.5.

    >>> float(td_error(jnp.array([0.5, 2.0]), jnp.array(1), 1.0, 0.5, 4.0))
    1.0
    """
    return jax.lax.stop_gradient(r_t + discount_t * v_t) - _pick(q_tm1, a_tm1)


def q_learning(q_tm1: Array, a_tm1: Array, r_t: Array, discount_t: Array, q_t: Array) -> Array:
    """TD error of Q-learning.

    delta = r_t + discount_t max_a q_t[a] - q_tm1[a_tm1]. Shapes: q_tm1 [A], q_t [A], the rest [] -> [].
    Watkins and Dayan, *Q-learning*, 1992.

    >>> float(q_learning(jnp.array([0.5, 2.0]), jnp.array(0), 1.0, 0.9, jnp.array([0.0, 10.0])))
    9.5
    """
    return td_error(q_tm1, a_tm1, r_t, discount_t, greedy_value(q_t))


def n_step_return(r_t: Array, discount_t: Array, v_t: Array) -> Array:
    """Return of T rewards followed by a bootstrap from the last state.

    G = r_1 + d_1 (r_2 + d_2 (... (r_T + d_T v_T))). Shapes: r_t [T], discount_t [T], v_t [] (the value of the last
    state) -> []. A discount of 0 inside the window ends the return there. Sutton and Barto, 2018, equation 7.1.

    >>> float(n_step_return(jnp.array([1.0, 1.0]), jnp.array([0.5, 0.5]), jnp.array(4.0)))
    2.5
    """

    start = jnp.asarray(v_t, jnp.result_type(v_t, r_t, discount_t))
    return jax.lax.scan(_back, start, (r_t, discount_t), reverse=True)[0]


def _back(value: Array, step: tuple[Array, Array]) -> tuple[Array, None]:
    """One step back in time; a function of the module, so that a scan outside jit is compiled once."""
    reward, discount = step
    return reward + discount * value, None


def _pick(q: Array, action: Array) -> Array:
    """q[action] as a masked sum: under vmap on a CPU it stays vector code, where indexing becomes a gather loop."""
    return jnp.sum(jnp.where(jnp.arange(q.shape[-1]) == action, q, 0))
