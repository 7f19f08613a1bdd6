"""Exact action values of a finite MDP: what a learner should find.

Arrays as in ``mdp``: transition [S, A, S], reward [S, A] or [S, A, S], terminal [S] bool. They may be traced; the work
is done in the dtype of ``transition``, at least float32; float64 needs ``jax_enable_x64``. With c(s) = 0 in a terminal
state and 1 elsewhere, both solve

    Q(s, a) = c(s) sum_s' P(s' | s, a) (R(s, a, s') + gamma c(s') V(s')).
"""

from __future__ import annotations

import math

import jax
import jax.numpy as jnp
import numpy as np

from jaxq.envs.mdp import check_distribution, check_mdp, in_float, known
from jaxq.types import Array, ArrayLike


def value_iteration(
    transition: ArrayLike,
    reward: ArrayLike,
    gamma: ArrayLike,
    terminal: ArrayLike | None = None,
    *,
    tolerance: float | None = None,
    max_sweeps: int = 1_000_000,
) -> Array:
    """Optimal action values, V(s) = max_a Q(s, a), by sweeps over all states until they stand still.

    Ends when no value changes by more than ``tolerance`` times the largest |Q|, or 1 if that is larger: then the error
    is at most gamma / (1 - gamma) times that change. The default tolerance is eight roundings of the dtype. All values
    are NaN if ``max_sweeps`` were not enough, as with gamma 1 where a reward may be earned for ever.

    Shapes: transition [S, A, S], reward [S, A] or [S, A, S], gamma [], terminal [S] -> [S, A], zeros in terminal rows.
    Raises ValueError for arrays that ``finite_mdp`` refuses, and, where it is known, for a gamma outside [0, 1].
    Bellman, 1957; Sutton and Barto, 2018, section 4.4.

    >>> round(float(value_iteration(np.ones((1, 1, 1)), np.ones((1, 1)), 0.5)[0, 0]), 5)
    2.0
    """
    p, r, c = _arrays(transition, reward, gamma, terminal)
    enough = 8 * float(jnp.finfo(p.dtype).eps) if tolerance is None else tolerance
    if not 0 < enough < math.inf:
        raise ValueError(f"tolerance: {tolerance} is not allowed: None or a number above 0")
    if max_sweeps < 1:
        raise ValueError(f"max_sweeps: {max_sweeps} is not allowed: at least 1")

    def moves(carry: tuple[Array, Array, Array]) -> Array:
        _, moving, sweeps = carry
        return moving & (sweeps < max_sweeps)

    def sweep(carry: tuple[Array, Array, Array]) -> tuple[Array, Array, Array]:
        q, _, sweeps = carry
        after = _backup(p, r, c, gamma, jnp.max(q, axis=-1))
        change, size = jnp.max(jnp.abs(after - q)), jnp.max(jnp.abs(after))
        finite = jnp.isfinite(change)
        moving = ~(finite & (change <= enough * jnp.maximum(size, 1)))
        return after, moving, jnp.where(finite, sweeps + 1, max_sweeps)

    start = (jnp.zeros_like(r), jnp.ones((), bool), jnp.zeros((), jnp.int32))
    q, moving, _ = jax.lax.while_loop(moves, sweep, start)
    return jnp.where(moving, jnp.nan, q)


def policy_evaluation(
    transition: ArrayLike, reward: ArrayLike, gamma: ArrayLike, policy: ArrayLike, terminal: ArrayLike | None = None
) -> Array:
    """Action values of a policy, V(s) = sum_a pi(a | s) Q(s, a), by solving the linear equations.

    V = (I - gamma P_pi)^-1 r_pi over the states that are not terminal. With gamma 1 the policy must end every episode;
    otherwise the equations have no solution, and values are not finite or mean nothing.

    Shapes: transition [S, A, S], reward [S, A] or [S, A, S], gamma [], policy [S, A], terminal [S] -> [S, A], zeros in
    terminal rows. Raises ValueError for arrays that ``finite_mdp`` refuses, a policy that is not a distribution per
    state and, where it is known, a gamma outside [0, 1]. Sutton and Barto, 2018, section 4.1.

    >>> policy_evaluation(np.ones((1, 1, 1)), np.ones((1, 1)), 0.5, np.ones((1, 1))).tolist()
    [[2.0]]
    """
    p, r, c = _arrays(transition, reward, gamma, terminal)
    check_distribution("policy", policy, r.shape)
    pi = jnp.asarray(policy, p.dtype)
    # Nothing is worth anything after an end: its columns are 0. What its own row says is not read.
    onward = jnp.einsum("sa,sat->st", pi, p, precision="highest") * c
    v = jnp.linalg.solve(jnp.eye(len(c), dtype=p.dtype) - jnp.asarray(gamma, p.dtype) * onward, jnp.sum(pi * r, -1))
    return _backup(p, r, c, gamma, v)


def _backup(p: Array, r: Array, c: Array, gamma: ArrayLike, v: Array) -> Array:
    """One step ahead of the values of states: p [S, A, S], r [S, A], c [S], v [S] -> [S, A]."""
    ahead = jnp.matmul(p, c * v, precision="highest")
    return c[:, None] * (r + jnp.asarray(gamma, p.dtype) * ahead)


def _arrays(
    transition: ArrayLike, reward: ArrayLike, gamma: ArrayLike, terminal: ArrayLike | None
) -> tuple[Array, Array, Array]:
    """Transition, expected reward [S, A] and c [S], of one dtype and checked."""
    num_states, _ = check_mdp(transition, reward, terminal)
    if np.shape(gamma) != ():
        raise ValueError(f"gamma: shape {np.shape(gamma)} is not allowed: (); jax.vmap adds a batch")
    if known(gamma) and not 0 <= float(np.asarray(gamma)) <= 1:
        raise ValueError(f"gamma: {gamma} is not allowed: a number in [0, 1]")
    p = in_float(transition)
    r = jnp.asarray(reward, p.dtype)
    r = jnp.sum(p * r, -1) if r.ndim == 3 else r
    c = jnp.ones(num_states, p.dtype) if terminal is None else 1 - jnp.asarray(terminal).astype(p.dtype)
    return p, r, c
