"""Exact action values of a finite MDP, what a learner should find, and how often a policy is where.

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

from jaxq.envs.mdp import check_distribution, check_mdp, check_start, in_float, known
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

    Ends when no value changes by more than ``tolerance`` times what it is the sum of, |r(s, a)| + gamma E |V(s')|: then
    the error is at most gamma / (1 - gamma) times the largest change. So rewards of any scale give values of the same
    relative accuracy. The default tolerance is eight roundings of the dtype. All values are NaN if ``max_sweeps`` were
    not enough, as with gamma 1 where a reward may be earned for ever.

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
        v = jnp.max(q, axis=-1)
        after, size = _backup(p, r, c, gamma, v), _backup(p, jnp.abs(r), c, gamma, jnp.abs(v))
        change = jnp.abs(after - q)
        finite = jnp.all(jnp.isfinite(change))
        moving = ~(finite & jnp.all(change <= enough * size))
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


def stationary_distribution(
    transition: ArrayLike, policy: ArrayLike, terminal: ArrayLike | None = None, start: ArrayLike | None = None
) -> Array:
    """How often a policy acts in each state in the long run, an episode's end followed by the next one's start.

    d(s') = sum_s d(s) P_pi(s, s') with P_pi(s, s') = sum_a pi(a | s) (c(s') P(s' | s, a) + e(s, a) start(s')), where
    c(s') is 0 in a terminal state and 1 elsewhere, and e(s, a) = sum_s' (1 - c(s')) P(s' | s, a) is the probability of
    an end. States that are never reached from ``start`` are acted in never. All values are NaN where that does not
    determine d: where no state is reached from all that are acted in, as with two sets of states that are never left.
    Time limits play no part.

    Shapes: transition [S, A, S], policy [S, A], terminal [S] and start [S], both or neither -> [S], sums to 1. They may
    be traced. Raises ValueError for arrays and a start that ``finite_mdp`` refuses, and for one of ``terminal`` and
    ``start`` without the other. Sutton and Barto, 2018, section 9.2.

    >>> there_and_back = np.array([[[0.0, 1.0]], [[0.5, 0.5]]])
    >>> np.asarray(stationary_distribution(there_and_back, np.ones((2, 1))), float).round(4).tolist()
    [0.3333, 0.6667]
    """
    p, _, c = _arrays(transition, np.zeros(np.shape(transition)[:2]), 0.0, terminal)
    check_distribution("policy", policy, p.shape[:2])
    if (terminal is None) != (start is None):
        raise ValueError("start: an MDP with terminal states needs it, and no other takes it")
    pi = jnp.asarray(policy, p.dtype) * c[:, None]
    onward = jnp.einsum("sa,sat->st", pi, p, precision="highest")
    acted = jnp.ones_like(c, bool)
    if start is not None:
        check_distribution("start", start, c.shape)
        check_start(start, terminal)
        first = jnp.asarray(start, p.dtype)
        ended = jnp.sum(onward * (1 - c), -1)
        onward = onward * c + jnp.outer(ended, first)
    reached = _closure(onward > 0)
    if start is not None:
        acted = jnp.any((first > 0)[:, None] & reached, axis=0)
    determined = jnp.any(acted & jnp.all(reached | ~acted[:, None], axis=0))
    # d (I - P) = 0 and sum d = 1 as one system over the states that are acted in; where d is unique, adding 1 to every
    # entry makes it regular. The others stand alone in it, with 0.
    inside = jnp.outer(acted, acted)
    balance = jnp.eye(len(c), dtype=p.dtype) - jnp.where(inside, onward, 0) + inside
    d = jnp.clip(jnp.linalg.solve(balance.T, acted.astype(p.dtype)), 0)
    return jnp.where(determined, d / jnp.sum(d), jnp.nan)


def _closure(step: Array) -> Array:
    """Which states are reached from each, itself among them. Shapes: step [S, S] bool -> [S, S] bool."""
    reached = step | jnp.eye(len(step), dtype=bool)
    for _ in range(math.ceil(math.log2(max(2, len(step))))):  # ways of up to 1, 2, 4, ... steps
        reached = jnp.matmul(reached.astype(jnp.float32), reached.astype(jnp.float32)) > 0
    return reached


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
