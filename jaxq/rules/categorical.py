"""Rules for categorical distributions of the return: C51 and its projection.

A distribution is K atoms, strictly increasing, and K logits or probabilities. The error of such a rule is a loss: the
cross-entropy of the projected target and the distribution of the action that was taken.

Bellemare, Dabney and Munos, *A Distributional Perspective on Reinforcement Learning*, 2017.
"""

from __future__ import annotations

import jax
import jax.numpy as jnp

from jaxq.rules.indexing import taken
from jaxq.rules.shapes import arrays
from jaxq.types import Array, ArrayLike


def categorical_values(q_atoms: ArrayLike, q_logits: ArrayLike) -> Array:
    """Action values of categorical distributions: their means.

    q[a] = sum_k softmax(q_logits[a])[k] q_atoms[k]. Shapes: q_atoms [K], q_logits [A, K] -> [A]. Raises ValueError for
    other shapes. Bellemare et al., 2017.

    >>> categorical_values(jnp.array([0.0, 2.0]), jnp.zeros((1, 2))).tolist()
    [1.0]
    """
    q_logits, q_atoms = arrays(q_logits=(q_logits, "AK"), q_atoms=(q_atoms, "K"))
    return jnp.sum(jax.nn.softmax(q_logits) * q_atoms, axis=-1)


def categorical_l2_project(z_p: ArrayLike, probs: ArrayLike, z_q: ArrayLike) -> Array:
    """A distribution on other atoms: each atom's probability goes to its two neighbours, the nearer one getting more.

    p_q[i] = sum_j probs[j] tent_i(clip(z_p[j], z_q[0], z_q[-1])), where tent_i is 1 at z_q[i], 0 at its neighbours and
    linear between them. The nearest distribution in the Cramer distance; it keeps the mean of what is not clipped.
    Shapes: z_p, probs [K], z_q [M], strictly increasing -> [M]. Raises ValueError for other shapes. Bellemare et al.,
    2017, equation 7.

    >>> categorical_l2_project(jnp.array([0.5, 9.0]), jnp.array([0.5, 0.5]), jnp.array([0.0, 1.0, 2.0])).tolist()
    [0.25, 0.25, 0.5]
    """
    z_p, probs, z_q = arrays(z_p=(z_p, "K"), probs=(probs, "K"), z_q=(z_q, "M"))
    z = jnp.clip(z_p, z_q[0], z_q[-1])
    last = z_q.shape[0] - 1
    if not last:
        return jnp.sum(probs, keepdims=True)
    # An atom has weight on two tents at most: with their place known it is added there, not multiplied with all.
    lower = jnp.clip(jnp.searchsorted(z_q, z, side="right", method="compare_all") - 1, 0, last - 1)
    share = (z - z_q[lower]) / jnp.diff(z_q)[lower]
    projected = jnp.zeros(z_q.shape, jnp.result_type(share, probs))
    return projected.at[lower].add((1 - share) * probs).at[lower + 1].add(share * probs)


def categorical_target(
    q_atoms_tm1: ArrayLike,
    r_t: ArrayLike,
    discount_t: ArrayLike,
    q_atoms_t: ArrayLike,
    q_logits_t: ArrayLike,
    q_t_selector: ArrayLike,
) -> Array:
    """Distribution that one transition moves towards: the successor's, of the selected action, shrunk and shifted.

    Phi(r_t + discount_t q_atoms_t, softmax(q_logits_t[argmax_a q_t_selector[a]])), Phi the projection on q_atoms_tm1.
    Shapes: q_atoms_tm1 [M], q_atoms_t [K], q_logits_t [A, K], q_t_selector [A], the rest [] -> [M]. Raises ValueError
    for other shapes. Bellemare et al., 2017.

    >>> atoms, logits = jnp.array([0.0, 1.0, 2.0]), jnp.zeros((1, 3))
    >>> categorical_target(atoms, 1.0, 0.0, atoms, logits, jnp.zeros(1)).round(6).tolist()
    [0.0, 1.0, 0.0]
    """
    q_logits_t, q_atoms_t, q_t_selector = arrays(
        q_logits_t=(q_logits_t, "AK"), q_atoms_t=(q_atoms_t, "K"), q_t_selector=(q_t_selector, "A")
    )
    r_t, discount_t, q_atoms_tm1 = arrays(r_t=(r_t, ""), discount_t=(discount_t, ""), q_atoms_tm1=(q_atoms_tm1, "M"))
    probs = jax.nn.softmax(taken(q_logits_t, jnp.argmax(q_t_selector)))
    return categorical_l2_project(r_t + discount_t * q_atoms_t, probs, q_atoms_tm1)


def categorical_error(q_logits_tm1: ArrayLike, a_tm1: ArrayLike, target_tm1: ArrayLike) -> Array:
    """Cross-entropy of a target and the distribution of the action taken, with no gradient through the target.

    L = -sum_k target_tm1[k] log softmax(q_logits_tm1[a_tm1])[k]. Shapes: q_logits_tm1 [A, K], a_tm1 [], target_tm1 [K]
    -> []. Raises ValueError for other shapes, TypeError for an action that is no integer. Bellemare et al., 2017.

    >>> round(float(categorical_error(jnp.zeros((1, 2)), jnp.array(0), jnp.array([1.0, 0.0]))), 4)  # log 2
    0.6931
    """
    q_logits_tm1, a_tm1, target_tm1 = arrays(
        q_logits_tm1=(q_logits_tm1, "AK"), a_tm1=(a_tm1, ""), target_tm1=(target_tm1, "K")
    )
    return -jnp.sum(jax.lax.stop_gradient(target_tm1) * jax.nn.log_softmax(taken(q_logits_tm1, a_tm1)))


def categorical_double_q_learning(
    q_atoms_tm1: ArrayLike,
    q_logits_tm1: ArrayLike,
    a_tm1: ArrayLike,
    r_t: ArrayLike,
    discount_t: ArrayLike,
    q_atoms_t: ArrayLike,
    q_logits_t: ArrayLike,
    q_t_selector: ArrayLike,
) -> Array:
    """Loss of double Q-learning for categorical distributions: ``q_t_selector`` selects, ``q_logits_t`` values.

    L = ``categorical_error`` of the ``categorical_target``. Shapes: q_atoms_tm1 [K], q_logits_tm1 [A, K], q_atoms_t,
    q_logits_t of the same or another number of atoms, q_t_selector [A], the rest [] -> []. Raises ValueError for other
    shapes, TypeError for an action that is no integer. Bellemare et al., 2017; Van Hasselt et al., 2016.

    >>> atoms, logits, selector = jnp.array([0.0, 1.0]), jnp.zeros((2, 2)), jnp.array([0.0, 1.0])
    >>> loss = categorical_double_q_learning(atoms, logits, jnp.array(0), 1.0, 0.9, atoms, logits, selector)
    >>> round(float(loss), 4)
    0.6931
    """
    q_logits_tm1, q_atoms_tm1, q_logits_t = arrays(
        q_logits_tm1=(q_logits_tm1, "AK"), q_atoms_tm1=(q_atoms_tm1, "K"), q_logits_t=(q_logits_t, "AM")
    )
    target_tm1 = categorical_target(q_atoms_tm1, r_t, discount_t, q_atoms_t, q_logits_t, q_t_selector)
    return categorical_error(q_logits_tm1, a_tm1, target_tm1)


def categorical_q_learning(
    q_atoms_tm1: ArrayLike,
    q_logits_tm1: ArrayLike,
    a_tm1: ArrayLike,
    r_t: ArrayLike,
    discount_t: ArrayLike,
    q_atoms_t: ArrayLike,
    q_logits_t: ArrayLike,
) -> Array:
    """Loss of Q-learning for categorical distributions: C51.

    ``categorical_double_q_learning`` with the action that is greedy in the means of q_logits_t. Shapes: q_atoms_tm1
    [K], q_logits_tm1 [A, K], q_atoms_t, q_logits_t of the same or another number of atoms, the rest [] -> []. Raises
    ValueError for other shapes, TypeError for an action that is no integer. Bellemare et al., 2017.

    >>> atoms, logits = jnp.array([0.0, 1.0]), jnp.zeros((2, 2))
    >>> round(float(categorical_q_learning(atoms, logits, jnp.array(0), 1.0, 0.9, atoms, logits)), 4)
    0.6931
    """
    q_logits_t, q_atoms_t = arrays(q_logits_t=(q_logits_t, "AK"), q_atoms_t=(q_atoms_t, "K"))
    selector = categorical_values(q_atoms_t, q_logits_t)
    return categorical_double_q_learning(
        q_atoms_tm1, q_logits_tm1, a_tm1, r_t, discount_t, q_atoms_t, q_logits_t, selector
    )
