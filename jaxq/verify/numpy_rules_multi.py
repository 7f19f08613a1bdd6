"""The rules of trajectories once more, as sums over all lengths of a bootstrap: see ``numpy_rules``."""

from __future__ import annotations

import math

import numpy as np

from jaxq.verify.numpy_rules import Numbers, expected_value

# Returns


def _ends(steps: Numbers, cut_t: Numbers) -> Numbers:
    """For each step the last one that its return may see."""
    cuts = np.zeros(steps, bool) if cut_t is None else cut_t
    return [next((k for k in range(t, steps) if cuts[k]), steps - 1) for t in range(steps)]


def _corrected(r_t: Numbers, discount_t: Numbers, v_t: Numbers, t: Numbers, length: Numbers) -> Numbers:
    """length rewards from step t on, and the value of the state reached, all discounted."""
    total, weight = 0.0, 1.0
    for k in range(t, t + length):
        total += weight * r_t[k]
        weight *= discount_t[k]
    return total + weight * v_t[t + length - 1]


def n_step_bootstrapped_returns(
    r_t: Numbers, discount_t: Numbers, v_t: Numbers, n: Numbers, lambda_t: Numbers = 1.0, cut_t: Numbers = None
) -> Numbers:
    """sum_k (lambda_t .. lambda_{t+k-2}) (1 - lambda_{t+k-1}) G^{t:t+k}, the longest return getting the remainder."""
    lambda_t = np.broadcast_to(lambda_t, np.shape(r_t))
    returns = np.zeros(len(r_t))
    for t, end in enumerate(_ends(len(r_t), cut_t)):
        longest = min(n, end - t + 1)
        for length in range(1, longest + 1):
            weight = math.prod(lambda_t[t : t + length - 1])
            if length < longest:
                weight *= 1 - lambda_t[t + length - 1]
            returns[t] += weight * _corrected(r_t, discount_t, v_t, t, length)
    return returns


def lambda_returns(
    r_t: Numbers, discount_t: Numbers, v_t: Numbers, lambda_: Numbers = 1.0, cut_t: Numbers = None
) -> Numbers:
    return n_step_bootstrapped_returns(r_t, discount_t, v_t, len(r_t) + 1, lambda_, cut_t)


def off_policy_returns(
    q_t: Numbers, a_t: Numbers, r_t: Numbers, discount_t: Numbers, c_t: Numbers, pi_t: Numbers, cut_t: Numbers = None
) -> Numbers:
    """Munos et al., equation 3: a target is the first TD error's and all corrected errors after it, weighted."""
    steps = len(r_t)
    c_t = np.broadcast_to(c_t, steps)
    v_t = [expected_value(q, pi) for q, pi in zip(q_t, pi_t, strict=True)]
    returns = np.zeros(steps)
    for t, end in enumerate(_ends(steps, cut_t)):
        returns[t] = r_t[t] + discount_t[t] * v_t[t]
        for k in range(t + 1, end + 1):
            weight = math.prod(discount_t[i] * c_t[i] for i in range(t, k))
            returns[t] += weight * (r_t[k] + discount_t[k] * v_t[k] - q_t[k - 1][a_t[k - 1]])
    return returns


def watkins_lambda(q_t: Numbers, a_t: Numbers, lambda_: Numbers) -> Numbers:
    lambda_ = np.broadcast_to(lambda_, len(a_t))
    return np.array([lam if q[a] == max(list(q)) else 0.0 for q, a, lam in zip(q_t, a_t, lambda_, strict=True)])


def retrace_weights(a_t: Numbers, pi_t: Numbers, mu_t: Numbers, lambda_: Numbers, eps: Numbers = 1e-8) -> Numbers:
    lambda_ = np.broadcast_to(lambda_, len(a_t))
    return np.array([lambda_[k] * min(1.0, pi_t[k][a] / (mu_t[k] + eps)) for k, a in enumerate(a_t)])


# Rescaling


def signed_hyperbolic(x: Numbers, eps: Numbers = 1e-3) -> Numbers:
    x = np.asarray(x, np.longdouble)
    return np.asarray(np.sign(x) * (np.sqrt(np.abs(x) + 1) - 1) + eps * x, float)


def signed_parabolic(x: Numbers, eps: Numbers = 1e-3) -> Numbers:
    x, eps = np.asarray(x, np.longdouble), np.longdouble(eps)
    if eps == 0:
        return np.asarray(np.sign(x) * ((np.abs(x) + 1) ** 2 - 1), float)
    root = (np.sqrt(1 + 4 * eps * (np.abs(x) + 1 + eps)) - 1) / (2 * eps)
    return np.asarray(np.sign(x) * (root**2 - 1), float)


HYPERBOLIC = (signed_hyperbolic, signed_parabolic)
IDENTITY = (np.asarray, np.asarray)


def transformed_lambda_returns(
    tx_pair: Numbers, r_t: Numbers, discount_t: Numbers, v_t: Numbers, lambda_: Numbers = 1.0, cut_t: Numbers = None
) -> Numbers:
    return tx_pair[0](lambda_returns(r_t, discount_t, tx_pair[1](v_t), lambda_, cut_t))


def transformed_n_step_returns(
    tx_pair: Numbers,
    r_t: Numbers,
    discount_t: Numbers,
    v_t: Numbers,
    n: Numbers,
    lambda_t: Numbers = 1.0,
    cut_t: Numbers = None,
) -> Numbers:
    return tx_pair[0](n_step_bootstrapped_returns(r_t, discount_t, tx_pair[1](v_t), n, lambda_t, cut_t))


def transformed_off_policy_returns(
    tx_pair: Numbers,
    q_t: Numbers,
    a_t: Numbers,
    r_t: Numbers,
    discount_t: Numbers,
    c_t: Numbers,
    pi_t: Numbers,
    cut_t: Numbers = None,
) -> Numbers:
    return tx_pair[0](off_policy_returns(tx_pair[1](q_t), a_t, r_t, discount_t, c_t, pi_t, cut_t))


# One trajectory


def _errors(q_tm1: Numbers, a_tm1: Numbers, targets: Numbers) -> Numbers:
    return np.array([target - q[a] for q, a, target in zip(q_tm1, a_tm1, targets, strict=True)])


def _taken(q_t: Numbers, a_t: Numbers) -> Numbers:
    return np.array([q[a] for q, a in zip(q_t, a_t, strict=True)])


def n_step_q_learning(
    q_tm1: Numbers,
    a_tm1: Numbers,
    target_q_t: Numbers,
    a_t: Numbers,
    r_t: Numbers,
    discount_t: Numbers,
    n: Numbers,
    cut_t: Numbers = None,
    tx_pair: Numbers = IDENTITY,
) -> Numbers:
    v_t = _taken(target_q_t, a_t)
    return _errors(q_tm1, a_tm1, transformed_n_step_returns(tx_pair, r_t, discount_t, v_t, n, cut_t=cut_t))


def sarsa_lambda(
    q_tm1: Numbers,
    a_tm1: Numbers,
    r_t: Numbers,
    discount_t: Numbers,
    q_t: Numbers,
    a_t: Numbers,
    lambda_: Numbers,
    cut_t: Numbers = None,
    tx_pair: Numbers = IDENTITY,
) -> Numbers:
    v_t = _taken(q_t, a_t)
    return _errors(q_tm1, a_tm1, transformed_lambda_returns(tx_pair, r_t, discount_t, v_t, lambda_, cut_t))


def q_lambda(
    q_tm1: Numbers,
    a_tm1: Numbers,
    r_t: Numbers,
    discount_t: Numbers,
    q_t: Numbers,
    lambda_: Numbers,
    cut_t: Numbers = None,
    tx_pair: Numbers = IDENTITY,
) -> Numbers:
    v_t = np.array([max(list(q)) for q in q_t])
    return _errors(q_tm1, a_tm1, transformed_lambda_returns(tx_pair, r_t, discount_t, v_t, lambda_, cut_t))


def retrace(
    q_tm1: Numbers,
    q_t: Numbers,
    a_tm1: Numbers,
    a_t: Numbers,
    r_t: Numbers,
    discount_t: Numbers,
    pi_t: Numbers,
    mu_t: Numbers,
    lambda_: Numbers,
    eps: Numbers = 1e-8,
    cut_t: Numbers = None,
    tx_pair: Numbers = IDENTITY,
) -> Numbers:
    c_t = retrace_weights(a_t, pi_t, mu_t, lambda_, eps)
    targets = transformed_off_policy_returns(tx_pair, q_t, a_t, r_t, discount_t, c_t, pi_t, cut_t)
    return _errors(q_tm1, a_tm1, targets)
