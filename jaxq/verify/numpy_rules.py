"""The rules once more, from the papers' equations: plain loops over Python numbers and NumPy's float64.

Nothing here, in ``numpy_rules_distributions`` or ``numpy_rules_multi``, is shared with ``jaxq.rules``: returns are sums
over all lengths of a bootstrap (the forward view), where the library works backwards; a soft value is an expectation
with its entropy, where the library takes a logarithm of a sum; a projection is what the paper prints, where the library
sums tents.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np

Numbers = Any  # one number, or an array of them: float64 or int, Python's or NumPy's

# Values of one state


def action_value(q_t: Numbers, a_t: Numbers) -> Numbers:
    return q_t[a_t]


def greedy_value(q_t: Numbers) -> Numbers:
    return max(list(q_t))


def first_greatest(values: Numbers) -> Numbers:
    best = 0
    for i, value in enumerate(values):
        if value > values[best]:
            best = i
    return best


def double_value(q_t_value: Numbers, q_t_selector: Numbers) -> Numbers:
    return q_t_value[first_greatest(q_t_selector)]


def expected_value(q_t: Numbers, probs_a_t: Numbers) -> Numbers:
    return sum(p * q for p, q in zip(probs_a_t, q_t, strict=True))


def boltzmann(q: Numbers, temperature: Numbers) -> Numbers:
    weights = [math.exp((x - max(q)) / temperature) for x in q]
    return [w / sum(weights) for w in weights]


def soft_value(q_t: Numbers, temperature: Numbers) -> Numbers:
    return sum(p * (q - temperature * math.log(p)) for p, q in zip(boltzmann(q_t, temperature), q_t, strict=True) if p)


def averaged(q_t: Numbers) -> Numbers:
    return np.array([sum(column) / len(column) for column in q_t.T])


def maxmin(q_t: Numbers) -> Numbers:
    return np.array([min(list(column)) for column in q_t.T])


# One transition


def td_target(r_t: Numbers, discount_t: Numbers, v_t: Numbers) -> Numbers:
    return r_t + discount_t * v_t


def td_error(q_tm1: Numbers, a_tm1: Numbers, target_tm1: Numbers) -> Numbers:
    return target_tm1 - q_tm1[a_tm1]


def q_learning(q_tm1: Numbers, a_tm1: Numbers, r_t: Numbers, discount_t: Numbers, q_t: Numbers) -> Numbers:
    return r_t + discount_t * greedy_value(q_t) - q_tm1[a_tm1]


def double_q_learning(
    q_tm1: Numbers, a_tm1: Numbers, r_t: Numbers, discount_t: Numbers, q_t_value: Numbers, q_t_selector: Numbers
) -> Numbers:
    return r_t + discount_t * double_value(q_t_value, q_t_selector) - q_tm1[a_tm1]


def sarsa(q_tm1: Numbers, a_tm1: Numbers, r_t: Numbers, discount_t: Numbers, q_t: Numbers, a_t: Numbers) -> Numbers:
    return r_t + discount_t * q_t[a_t] - q_tm1[a_tm1]


def expected_sarsa(
    q_tm1: Numbers, a_tm1: Numbers, r_t: Numbers, discount_t: Numbers, q_t: Numbers, probs_a_t: Numbers
) -> Numbers:
    return r_t + discount_t * expected_value(q_t, probs_a_t) - q_tm1[a_tm1]


def soft_q_learning(
    q_tm1: Numbers, a_tm1: Numbers, r_t: Numbers, discount_t: Numbers, q_t: Numbers, temperature: Numbers
) -> Numbers:
    return r_t + discount_t * soft_value(q_t, temperature) - q_tm1[a_tm1]


def munchausen_q_learning(
    q_tm1: Numbers,
    a_tm1: Numbers,
    r_t: Numbers,
    discount_t: Numbers,
    q_t: Numbers,
    q_tm1_target: Numbers,
    temperature: Numbers = 0.03,
    munchausen_scale: Numbers = 0.9,
    clip_min: Numbers = -1.0,
) -> Numbers:
    log_pi = (q_tm1_target[a_tm1] - max(q_tm1_target)) / temperature
    log_pi -= math.log(sum(math.exp((q - max(q_tm1_target)) / temperature) for q in q_tm1_target))
    bonus = munchausen_scale * min(0, max(clip_min, temperature * log_pi))
    return r_t + bonus + discount_t * soft_value(q_t, temperature) - q_tm1[a_tm1]


def advantage_learning(
    q_tm1: Numbers,
    a_tm1: Numbers,
    r_t: Numbers,
    discount_t: Numbers,
    q_t: Numbers,
    q_tm1_target: Numbers,
    action_gap_scale: Numbers,
) -> Numbers:
    bellman = r_t + discount_t * greedy_value(q_t)
    return bellman - action_gap_scale * (greedy_value(q_tm1_target) - q_tm1_target[a_tm1]) - q_tm1[a_tm1]


def persistent_q_learning(
    q_tm1: Numbers, a_tm1: Numbers, r_t: Numbers, discount_t: Numbers, q_t: Numbers, action_gap_scale: Numbers
) -> Numbers:
    bellman = r_t + discount_t * greedy_value(q_t)
    return bellman - action_gap_scale * discount_t * (greedy_value(q_t) - q_t[a_tm1]) - q_tm1[a_tm1]


def persistent_advantage_learning(
    q_tm1: Numbers,
    a_tm1: Numbers,
    r_t: Numbers,
    discount_t: Numbers,
    q_t: Numbers,
    q_tm1_target: Numbers,
    action_gap_scale: Numbers,
) -> Numbers:
    gap = action_gap_scale * (greedy_value(q_tm1_target) - q_tm1_target[a_tm1])
    next_gap = discount_t * (greedy_value(q_t) - q_t[a_tm1])
    return r_t + discount_t * greedy_value(q_t) - min(gap, next_gap) - q_tm1[a_tm1]


def averaged_q_learning(q_tm1: Numbers, a_tm1: Numbers, r_t: Numbers, discount_t: Numbers, q_t: Numbers) -> Numbers:
    return q_learning(q_tm1, a_tm1, r_t, discount_t, averaged(q_t))


def maxmin_q_learning(q_tm1: Numbers, a_tm1: Numbers, r_t: Numbers, discount_t: Numbers, q_t: Numbers) -> Numbers:
    return q_learning(q_tm1, a_tm1, r_t, discount_t, maxmin(q_t))


# Tables and target networks


def update_table(table: Numbers, state: Numbers, action: Numbers, amount: Numbers) -> Numbers:
    table = table.copy()
    table[state, action] += amount
    return table


def _faded(trace: Numbers, decay_t: Numbers) -> Numbers:
    return np.array([[decay_t * e for e in row] for row in trace])


def accumulating_trace(trace: Numbers, state: Numbers, action: Numbers, decay_t: Numbers) -> Numbers:
    trace = _faded(trace, decay_t)
    trace[state, action] += 1
    return trace


def replacing_trace(trace: Numbers, state: Numbers, action: Numbers, decay_t: Numbers) -> Numbers:
    trace = _faded(trace, decay_t)
    trace[state, action] = 1
    return trace


def dutch_trace(trace: Numbers, state: Numbers, action: Numbers, decay_t: Numbers, step_size: Numbers) -> Numbers:
    """Van Seijen and Sutton: e = gamma lambda e + x - alpha gamma lambda (e . x) x, with x 1 in the visited cell."""
    x = np.zeros_like(trace)
    x[state, action] = 1
    return decay_t * trace + x - step_size * decay_t * np.sum(trace * x) * x


def polyak_update(online: Numbers, target: Numbers, tau: Numbers) -> Numbers:
    return target + tau * (online - target)


def periodic_step(updates: Numbers, period: Numbers, tau: Numbers = 1.0) -> Numbers:
    return tau if updates in range(0, updates + 1, period) else 0.0


def periodic_update(online: Numbers, target: Numbers, updates: Numbers, period: Numbers) -> Numbers:
    return online if updates in range(0, updates + 1, period) else target
