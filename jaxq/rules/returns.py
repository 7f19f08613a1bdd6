"""Returns of one trajectory, for every step of it: what multi-step rules move towards.

``r_t``, ``discount_t`` and the values of the states reached are [T]; the trajectory need not begin or end with an
episode. A discount of 0 (a termination) ends a return there. Where an episode was cut for another reason, the discount
goes on but the next row is another episode's: ``cut_t`` says so, and the return bootstraps there from ``v_t``, which
must be the value of the true successor. A termination may be marked in ``cut_t`` as well.
"""

from __future__ import annotations

import jax
import jax.numpy as jnp

from jaxq.rules import values
from jaxq.rules.indexing import taken
from jaxq.rules.shapes import arrays, per_step, whole
from jaxq.rules.weighting import weighted
from jaxq.types import Array, ArrayLike

#: Steps of an n-step return that are one pass over the trajectory: more of them compile longer and are no faster.
UNROLLED = 8


def lambda_returns(
    r_t: ArrayLike, discount_t: ArrayLike, v_t: ArrayLike, lambda_: ArrayLike = 1.0, *, cut_t: ArrayLike | None = None
) -> Array:
    """Lambda returns: bootstraps of every length, weighted.

    G_t = r_t + discount_t ((1 - lambda_t) v_t + lambda_t G_{t+1}), with lambda_t = 0 in the last step and at a cut.
    With lambda 1 it is the discounted return, with 0 the one-step target. Shapes: r_t, discount_t, v_t [T], lambda_ []
    or [T], cut_t [T] bool -> [T]. Raises ValueError for other shapes. Sutton and Barto, 2018, equation 12.18.

    >>> lambda_returns(jnp.ones(2), jnp.full(2, 0.5), jnp.array([2.0, 4.0])).tolist()  # 1 + 0.5 * 3, 1 + 0.5 * 4
    [2.5, 3.0]
    >>> lambda_returns(jnp.ones(2), jnp.full(2, 0.5), jnp.array([2.0, 4.0]), cut_t=jnp.array([True, False])).tolist()
    [2.0, 3.0]
    """
    r_t, discount_t, v_t = arrays(r_t=(r_t, "T"), discount_t=(discount_t, "T"), v_t=(v_t, "T"))
    over = _over(discount_t, cut_t)
    lambda_ = _weights(lambda_, "lambda_", discount_t, over)
    return _returns(r_t, discount_t, weighted(1 - lambda_, v_t), lambda_, None if cut_t is None else over)


def n_step_bootstrapped_returns(
    r_t: ArrayLike,
    discount_t: ArrayLike,
    v_t: ArrayLike,
    n: int,
    lambda_t: ArrayLike = 1.0,
    *,
    cut_t: ArrayLike | None = None,
) -> Array:
    """Returns of n rewards followed by a bootstrap; of fewer where the trajectory or an episode ends before.

    G^1_t = r_t + discount_t v_t;  G^n_t = r_t + discount_t ((1 - lambda_t) v_t + lambda_t G^{n-1}_{t+1}), with
    lambda_t = 0 in the last step and at a cut. Shapes: r_t, discount_t, v_t [T], lambda_t [] or [T], cut_t [T] bool
    -> [T]. Raises ValueError for other shapes and for n below 1. Sutton and Barto, 2018, equations 7.1 and 12.18.

    >>> r_t, discount_t, v_t = jnp.ones(3), jnp.full(3, 0.5), jnp.array([8.0, 4.0, 2.0])
    >>> n_step_bootstrapped_returns(r_t, discount_t, v_t, n=2).tolist()  # 1 + 0.5 + 0.25 * 4, 1 + 0.5 + 0.25 * 2, ...
    [2.5, 2.0, 2.0]
    """
    r_t, discount_t, v_t = arrays(r_t=(r_t, "T"), discount_t=(discount_t, "T"), v_t=(v_t, "T"))
    n = whole("n", n)
    over = _over(discount_t, cut_t)
    lambda_t = _weights(lambda_t, "lambda_t", discount_t, over)

    steps, rest_t = n - 1, weighted(1 - lambda_t, v_t)
    if n >= r_t.shape[0]:  # a return of every step to the end
        return _returns(r_t, discount_t, rest_t, lambda_t, None if cut_t is None else over)

    known_t, share_t = r_t + weighted(discount_t, rest_t), discount_t * lambda_t

    def longer(_: Array, shorter: Array) -> Array:
        return known_t + share_t * jnp.where(over, 0, jnp.concatenate([shorter[1:], shorter[-1:]]))

    one_step = (r_t + weighted(discount_t, v_t)).astype(jnp.result_type(r_t, discount_t, v_t, lambda_t))
    return jax.lax.fori_loop(0, steps, longer, one_step, unroll=max(1, min(steps, UNROLLED)))


def off_policy_returns(
    q_t: ArrayLike,
    a_t: ArrayLike,
    r_t: ArrayLike,
    discount_t: ArrayLike,
    c_t: ArrayLike,
    pi_t: ArrayLike,
    *,
    cut_t: ArrayLike | None = None,
) -> Array:
    """Returns under a target policy pi, from a trajectory of another one: the family of Retrace.

    G_t = r_t + discount_t (sum_a pi_t[a] q_t[a] - c_t q_t[a_t] + c_t G_{t+1}), with c_t = 0 in the last step and at a
    cut. With mu the policy that acted, c_t = lambda min(1, pi / mu) is Retrace, pi / mu importance sampling, pi tree
    backup, and lambda the Q(lambda) of Harutyunyan et al. Shapes: q_t, pi_t [T, A], a_t, r_t, discount_t [T], c_t [] or
    [T], cut_t [T] bool -> [T]. Raises ValueError for other shapes, TypeError for actions that are no integers. Munos et
    al., *Safe and Efficient Off-Policy Reinforcement Learning*, 2016.

    >>> q_t, a_t, pi_t = jnp.array([[2.0, 4.0], [6.0, 0.0]]), jnp.array([0, 0]), jnp.full((2, 2), 0.5)
    >>> off_policy_returns(q_t, a_t, jnp.ones(2), jnp.full(2, 0.5), 1.0, pi_t).tolist()  # 1 + 0.5 (3 - 2 + 2.5)
    [2.75, 2.5]
    """
    q_t, a_t, r_t, discount_t, pi_t = arrays(
        q_t=(q_t, "TA"), a_t=(a_t, "T"), r_t=(r_t, "T"), discount_t=(discount_t, "T"), pi_t=(pi_t, "TA")
    )
    expected, chosen = jax.vmap(values.expected_value)(q_t, pi_t), jax.vmap(values.action_value)(q_t, a_t)
    over = _over(discount_t, cut_t)
    c_t = _weights(c_t, "c_t", discount_t, over)
    rest_t = expected - weighted(c_t, chosen)
    return _returns(r_t, discount_t, rest_t, c_t, None if cut_t is None else over)


def watkins_lambda(q_t: ArrayLike, a_t: ArrayLike, lambda_: ArrayLike) -> Array:
    """Lambda of Watkins's Q(lambda): 0 where the action taken next is not greedy, so that the return ends before it.

    lambda_t = lambda 1(q_t[a_t] = max_a q_t[a]). Shapes: q_t [T, A], a_t [T], lambda_ [] or [T] -> [T]. Raises
    ValueError for other shapes, TypeError for actions that are no integers. Watkins, 1989; Sutton and Barto, 2018,
    section 12.10.

    >>> watkins_lambda(jnp.array([[1.0, 2.0], [1.0, 2.0]]), jnp.array([0, 1]), 0.5).tolist()
    [0.0, 0.5]
    """
    q_t, a_t, lambda_ = arrays(q_t=(q_t, "TA"), a_t=(a_t, "T"), lambda_=(lambda_, per_step(lambda_)))
    greedy = jax.vmap(taken)(q_t == jnp.max(q_t, axis=-1, keepdims=True), a_t)
    return jnp.where(greedy, lambda_, jnp.zeros((), jnp.result_type(q_t, lambda_)))


def _over(discount_t: Array, cut_t: ArrayLike | None) -> Array:
    """Steps after which nothing is known to follow, [T] bool: the cuts and the last one."""
    steps = discount_t.shape[0]
    over = jnp.arange(steps) == steps - 1
    if cut_t is not None:
        _, cut_t = arrays(discount_t=(discount_t, "T"), cut_t=(cut_t, "T"))
        over = over | cut_t.astype(bool)
    return over


def _weights(weight: ArrayLike, name: str, discount_t: Array, over: Array) -> Array:
    """The weight of what follows each step, [T], 0 where nothing does."""
    _, weight = arrays(discount_t=(discount_t, "T"), **{name: (weight, per_step(weight))})
    return jnp.where(over, jnp.zeros((), jnp.result_type(discount_t, weight)), weight)


def _returns(r_t: Array, discount_t: Array, rest_t: Array, weight_t: Array, over: Array | None) -> Array:
    """G_t = r_t + discount_t (rest_t + weight_t G_{t+1}), from the last step to the first; without cuts no ``over``."""
    dtype = jnp.result_type(r_t, discount_t, rest_t, weight_t)
    known_t, share_t = (r_t + weighted(discount_t, rest_t)).astype(dtype), (discount_t * weight_t).astype(dtype)
    return jax.lax.scan(_back, jnp.zeros((), dtype), (known_t, share_t, over), reverse=True)[1]


def _back(following: Array, step: tuple[Array, Array, Array | None]) -> tuple[Array, Array]:
    """One step back in time; a function of the module, so that a scan outside jit is compiled once.

    What follows in another episode is replaced, not only weighted with 0: it may be infinite, or no number.
    """
    known_t, share_t, over = step
    value = known_t + share_t * (following if over is None else jnp.where(over, 0, following))
    return value, value
