"""The rules once more, from the papers' equations: plain loops over Python numbers and NumPy's float64.

Nothing here, or in ``numpy_rules_multi``, is shared with ``jaxq.rules``: returns are sums over all lengths of a
bootstrap (the forward view), where the library works backwards; a soft value is an expectation with its entropy, where
the library takes a logarithm of a sum; a projection is what the paper prints, where the library sums tents.
"""

from __future__ import annotations

import math

import numpy as np

# Values of one state


def action_value(q_t, a_t):
    return q_t[a_t]


def greedy_value(q_t):
    return max(list(q_t))


def _first_greatest(values):
    best = 0
    for i, value in enumerate(values):
        if value > values[best]:
            best = i
    return best


def double_value(q_t_value, q_t_selector):
    return q_t_value[_first_greatest(q_t_selector)]


def expected_value(q_t, probs_a_t):
    return sum(p * q for p, q in zip(probs_a_t, q_t, strict=True))


def boltzmann(q, temperature):
    weights = [math.exp((x - max(q)) / temperature) for x in q]
    return [w / sum(weights) for w in weights]


def soft_value(q_t, temperature):
    return sum(p * (q - temperature * math.log(p)) for p, q in zip(boltzmann(q_t, temperature), q_t, strict=True) if p)


def averaged(q_t):
    return np.array([sum(column) / len(column) for column in q_t.T])


def maxmin(q_t):
    return np.array([min(list(column)) for column in q_t.T])


# One transition


def td_target(r_t, discount_t, v_t):
    return r_t + discount_t * v_t


def td_error(q_tm1, a_tm1, target_tm1):
    return target_tm1 - q_tm1[a_tm1]


def q_learning(q_tm1, a_tm1, r_t, discount_t, q_t):
    return r_t + discount_t * greedy_value(q_t) - q_tm1[a_tm1]


def double_q_learning(q_tm1, a_tm1, r_t, discount_t, q_t_value, q_t_selector):
    return r_t + discount_t * double_value(q_t_value, q_t_selector) - q_tm1[a_tm1]


def sarsa(q_tm1, a_tm1, r_t, discount_t, q_t, a_t):
    return r_t + discount_t * q_t[a_t] - q_tm1[a_tm1]


def expected_sarsa(q_tm1, a_tm1, r_t, discount_t, q_t, probs_a_t):
    return r_t + discount_t * expected_value(q_t, probs_a_t) - q_tm1[a_tm1]


def soft_q_learning(q_tm1, a_tm1, r_t, discount_t, q_t, temperature):
    return r_t + discount_t * soft_value(q_t, temperature) - q_tm1[a_tm1]


def munchausen_q_learning(
    q_tm1, a_tm1, r_t, discount_t, q_t, q_tm1_target, temperature=0.03, munchausen_scale=0.9, clip_min=-1.0
):
    log_pi = (q_tm1_target[a_tm1] - max(q_tm1_target)) / temperature
    log_pi -= math.log(sum(math.exp((q - max(q_tm1_target)) / temperature) for q in q_tm1_target))
    bonus = munchausen_scale * min(0, max(clip_min, temperature * log_pi))
    return r_t + bonus + discount_t * soft_value(q_t, temperature) - q_tm1[a_tm1]


def advantage_learning(q_tm1, a_tm1, r_t, discount_t, q_t, q_tm1_target, action_gap_scale):
    bellman = r_t + discount_t * greedy_value(q_t)
    return bellman - action_gap_scale * (greedy_value(q_tm1_target) - q_tm1_target[a_tm1]) - q_tm1[a_tm1]


def persistent_q_learning(q_tm1, a_tm1, r_t, discount_t, q_t, action_gap_scale):
    bellman = r_t + discount_t * greedy_value(q_t)
    return bellman - action_gap_scale * discount_t * (greedy_value(q_t) - q_t[a_tm1]) - q_tm1[a_tm1]


def persistent_advantage_learning(q_tm1, a_tm1, r_t, discount_t, q_t, q_tm1_target, action_gap_scale):
    gap = action_gap_scale * (greedy_value(q_tm1_target) - q_tm1_target[a_tm1])
    next_gap = discount_t * (greedy_value(q_t) - q_t[a_tm1])
    return r_t + discount_t * greedy_value(q_t) - min(gap, next_gap) - q_tm1[a_tm1]


def averaged_q_learning(q_tm1, a_tm1, r_t, discount_t, q_t):
    return q_learning(q_tm1, a_tm1, r_t, discount_t, averaged(q_t))


def maxmin_q_learning(q_tm1, a_tm1, r_t, discount_t, q_t):
    return q_learning(q_tm1, a_tm1, r_t, discount_t, maxmin(q_t))


# Categorical distributions


def softmax(logits):
    return np.array(boltzmann(logits, 1.0))


def categorical_values(q_atoms, q_logits):
    return np.array([expected_value(q_atoms, softmax(row)) for row in q_logits])


def project_uniform(z_p, probs, z_q):
    """Bellemare et al., algorithm 1; where an atom is hit exactly, it gets all (the print of the paper loses it)."""
    gap, mass = (z_q[-1] - z_q[0]) / (len(z_q) - 1), np.zeros(len(z_q))
    for z, p in zip(z_p, probs, strict=True):
        b = (min(max(z, z_q[0]), z_q[-1]) - z_q[0]) / gap
        lower, upper = math.floor(b), math.ceil(b)
        if lower == upper:
            mass[lower] += p
        else:
            mass[lower] += p * (upper - b)
            mass[upper] += p * (b - lower)
    return mass


def categorical_l2_project(z_p, probs, z_q):
    """For each atom its two neighbours, found by looking."""
    mass = np.zeros(len(z_q))
    for z, p in zip(z_p, probs, strict=True):
        if z <= z_q[0] or z >= z_q[-1]:
            mass[0 if z <= z_q[0] else -1] += p
            continue
        upper = next(i for i in range(len(z_q)) if z_q[i] > z)
        share = (z - z_q[upper - 1]) / (z_q[upper] - z_q[upper - 1])
        mass[upper] += p * share
        mass[upper - 1] += p * (1 - share)
    return mass


def categorical_target(q_atoms_tm1, r_t, discount_t, q_atoms_t, q_logits_t, q_t_selector):
    probs = softmax(q_logits_t[_first_greatest(q_t_selector)])
    return categorical_l2_project([r_t + discount_t * z for z in q_atoms_t], probs, q_atoms_tm1)


def categorical_error(q_logits_tm1, a_tm1, target_tm1):
    return -sum(t * math.log(p) for t, p in zip(target_tm1, softmax(q_logits_tm1[a_tm1]), strict=True))


def categorical_double_q_learning(
    q_atoms_tm1, q_logits_tm1, a_tm1, r_t, discount_t, q_atoms_t, q_logits_t, q_t_selector
):
    target = categorical_target(q_atoms_tm1, r_t, discount_t, q_atoms_t, q_logits_t, q_t_selector)
    return categorical_error(q_logits_tm1, a_tm1, target)


def categorical_q_learning(q_atoms_tm1, q_logits_tm1, a_tm1, r_t, discount_t, q_atoms_t, q_logits_t):
    selector = categorical_values(q_atoms_t, q_logits_t)
    return categorical_double_q_learning(
        q_atoms_tm1, q_logits_tm1, a_tm1, r_t, discount_t, q_atoms_t, q_logits_t, selector
    )


# Quantiles


def quantile_values(dist_q):
    return averaged(dist_q)


def quantile_regression_loss(dist_src, tau_src, dist_target, huber_param=0.0):
    loss = 0.0
    for theta, tau in zip(dist_src, tau_src, strict=True):
        for sample in dist_target:
            u = sample - theta
            if huber_param == 0:
                huber = abs(u)
            elif abs(u) <= huber_param:
                huber = u * u / 2
            else:
                huber = huber_param * (abs(u) - huber_param / 2)
            loss += (1 - tau if u < 0 else tau) * huber / len(dist_target)
    return loss


def quantile_target(r_t, discount_t, dist_q_t_selector, dist_q_t):
    action = _first_greatest(averaged(dist_q_t_selector))
    return np.array([r_t + discount_t * quantiles[action] for quantiles in dist_q_t])


def quantile_error(dist_q_tm1, tau_q_tm1, a_tm1, target_tm1, huber_param=0.0):
    return quantile_regression_loss(dist_q_tm1[:, a_tm1], tau_q_tm1, target_tm1, huber_param)


def quantile_q_learning(
    dist_q_tm1, tau_q_tm1, a_tm1, r_t, discount_t, dist_q_t_selector, dist_q_t, huber_param=0.0
):  # fmt: skip
    target = quantile_target(r_t, discount_t, dist_q_t_selector, dist_q_t)
    return quantile_error(dist_q_tm1, tau_q_tm1, a_tm1, target, huber_param)


def implicit_quantile(
    dist_q_tm1, tau_q_tm1, a_tm1, r_t, discount_t, dist_q_t_selector, dist_q_t, huber_param=1.0
):  # fmt: skip
    arguments = (dist_q_tm1, tau_q_tm1, a_tm1, r_t, discount_t, dist_q_t_selector, dist_q_t, huber_param)
    return quantile_q_learning(*arguments) / huber_param


# Tables and target networks


def update_table(table, state, action, amount):
    table = table.copy()
    table[state, action] += amount
    return table


def _faded(trace, decay_t):
    return np.array([[decay_t * e for e in row] for row in trace])


def accumulating_trace(trace, state, action, decay_t):
    trace = _faded(trace, decay_t)
    trace[state, action] += 1
    return trace


def replacing_trace(trace, state, action, decay_t):
    trace = _faded(trace, decay_t)
    trace[state, action] = 1
    return trace


def dutch_trace(trace, state, action, decay_t, step_size):
    """Van Seijen and Sutton: e = gamma lambda e + x - alpha gamma lambda (e . x) x, with x 1 in the visited cell."""
    x = np.zeros_like(trace)
    x[state, action] = 1
    return decay_t * trace + x - step_size * decay_t * np.sum(trace * x) * x


def polyak_update(online, target, tau):
    return target + tau * (online - target)


def periodic_step(updates, period, tau=1.0):
    return tau if updates in range(0, updates + 1, period) else 0.0


def periodic_update(online, target, updates, period):
    return online if updates in range(0, updates + 1, period) else target
