"""Values of one state: what a rule bootstraps from, out of a row of action values.

Double Q-learning, ensembles and soft values are each a choice made here; the error that they go into is the same.
"""

from __future__ import annotations

import jax
import jax.numpy as jnp

from jaxq.rules.indexing import taken
from jaxq.rules.shapes import arrays, whole
from jaxq.rules.weighting import weighted
from jaxq.types import Array, ArrayLike, Key


def action_value(q_t: ArrayLike, a_t: ArrayLike) -> Array:
    """Value of one action, as SARSA bootstraps from the action that is taken next.

    v_t = q_t[a_t]. Shapes: q_t [A], a_t [] -> []. An action outside 0 .. A - 1 has value 0. Raises ValueError for other
    shapes, TypeError for an action that is no integer. Rummery and Niranjan, 1994; Sutton and Barto, 2018, section 6.4.

    >>> float(action_value(jnp.array([1.0, 3.0]), jnp.array(0)))
    1.0
    """
    q_t, a_t = arrays(q_t=(q_t, "A"), a_t=(a_t, ""))
    return taken(q_t, a_t)


def greedy_value(q_t: ArrayLike) -> Array:
    """Value under the greedy policy.

    v_t = max_a q_t[a]. Shapes: q_t [A] -> []. Raises ValueError for other shapes. Watkins, *Learning from Delayed
    Rewards*, 1989.

    >>> float(greedy_value(jnp.array([1.0, 3.0])))
    3.0
    """
    (q_t,) = arrays(q_t=(q_t, "A"))
    return jnp.max(q_t)


def double_value(q_t_value: ArrayLike, q_t_selector: ArrayLike) -> Array:
    """Value where one estimate selects the action, the first of equals, and another one values it.

    v_t = q_t_value[argmax_a q_t_selector[a]]. Shapes: both [A] -> []. Raises ValueError for other shapes. Van Hasselt,
    *Double Q-learning*, 2010; in DQN ``q_t_value`` comes from the target network and ``q_t_selector`` from the online
    one (Van Hasselt et al., 2016).

    >>> float(double_value(jnp.array([1.0, 3.0]), jnp.array([5.0, 4.0])))
    1.0
    """
    q_t_value, q_t_selector = arrays(q_t_value=(q_t_value, "A"), q_t_selector=(q_t_selector, "A"))
    return action_value(q_t_value, jnp.argmax(q_t_selector))


def expected_value(q_t: ArrayLike, probs_a_t: ArrayLike) -> Array:
    """Expected value under a policy.

    v_t = sum_a probs_a_t[a] q_t[a]. Shapes: both [A] -> []. An action that is never taken may be masked with -inf.
    Raises ValueError for other shapes. Van Seijen et al., *A Theoretical and Empirical Analysis of Expected Sarsa*,
    2009.

    >>> float(expected_value(jnp.array([1.0, 3.0]), jnp.array([0.25, 0.75])))
    2.5
    """
    q_t, probs_a_t = arrays(q_t=(q_t, "A"), probs_a_t=(probs_a_t, "A"))
    return jnp.sum(weighted(probs_a_t, q_t))


def soft_value(q_t: ArrayLike, temperature: ArrayLike) -> Array:
    """Value under the Boltzmann policy with its entropy as a reward: a smooth maximum.

    v_t = tau log sum_a exp(q_t[a] / tau) = sum_a pi[a] (q_t[a] - tau log pi[a]), pi = softmax(q_t / tau).
    Shapes: q_t [A], temperature [] -> []. tau must be above 0; towards 0 it is the greedy value. Raises ValueError for
    other shapes. Haarnoja et al., *Reinforcement Learning with Deep Energy-Based Policies*, 2017.

    >>> round(float(soft_value(jnp.array([1.0, 1.0]), 2.0)), 4)  # 1 + 2 log 2
    2.3863
    """
    q_t, temperature = arrays(q_t=(q_t, "A"), temperature=(temperature, ""))
    # Differences from the greatest: they overflow at no temperature, and lose no digits where values are far from 0.
    top = jax.lax.stop_gradient(jnp.max(q_t))
    top = jnp.where(jnp.isfinite(top), top, 0)
    masked = jnp.isneginf(q_t)  # stays so at any temperature, which has no gradient there
    below = jnp.where(masked, -jnp.inf, (jnp.where(masked, top, q_t) - top) / temperature)
    return top + temperature * jax.nn.logsumexp(below)


def averaged(q_t: ArrayLike) -> Array:
    """Action values of an ensemble: the mean of its members.

    q_t[a] = 1/K sum_k q_t[k, a]. Shapes: q_t [K, A] -> [A]. Raises ValueError for other shapes. Anschel, Baram and
    Shimkin, *Averaged-DQN*, 2017.

    >>> averaged(jnp.array([[1.0, 3.0], [3.0, 1.0]])).tolist()
    [2.0, 2.0]
    """
    (q_t,) = arrays(q_t=(q_t, "KA"))
    return jnp.mean(q_t, axis=0)


def maxmin(q_t: ArrayLike) -> Array:
    """Action values of an ensemble: the least of its members, of which Maxmin Q-learning takes the greatest.

    q_t[a] = min_k q_t[k, a]. Shapes: q_t [K, A] -> [A]. Raises ValueError for other shapes. Lan et al., *Maxmin
    Q-learning*, 2020. Of a ``random_subset`` it is the target of REDQ.

    >>> maxmin(jnp.array([[1.0, 3.0], [3.0, 2.0]])).tolist()
    [1.0, 2.0]
    """
    (q_t,) = arrays(q_t=(q_t, "KA"))
    return jnp.min(q_t, axis=0)


def random_subset(key: Key, q_t: ArrayLike, size: int) -> Array:
    """So many members of an ensemble, every set of them equally likely; the key is consumed.

    P(M) = 1 / binomial(K, size) for every set M. Shapes: q_t [K, A] -> [size, A]. Raises ValueError for other shapes,
    and for a size that is not in 1 .. K. Chen et al., *Randomized Ensembled Double Q-Learning*, 2021.

    >>> random_subset(jax.random.key(0), jnp.array([[1.0], [2.0]]), 2).sum().tolist()
    3.0
    """
    (q_t,) = arrays(q_t=(q_t, "KA"))
    members = q_t.shape[0]
    size = whole("size", size, members)
    return q_t[jax.random.choice(key, members, (size,), replace=False)]
