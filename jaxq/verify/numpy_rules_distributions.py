"""The rules of distributions once more, as the papers print them: see ``numpy_rules``."""

from __future__ import annotations

import math

import numpy as np

from jaxq.verify.numpy_rules import Numbers, averaged, boltzmann, expected_value, first_greatest

# Categorical distributions


def softmax(logits: Numbers) -> Numbers:
    return np.array(boltzmann(logits, 1.0))


def categorical_values(q_atoms: Numbers, q_logits: Numbers) -> Numbers:
    return np.array([expected_value(q_atoms, softmax(row)) for row in q_logits])


def project_uniform(z_p: Numbers, probs: Numbers, z_q: Numbers) -> Numbers:
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


def categorical_l2_project(z_p: Numbers, probs: Numbers, z_q: Numbers) -> Numbers:
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


def categorical_target(
    q_atoms_tm1: Numbers,
    r_t: Numbers,
    discount_t: Numbers,
    q_atoms_t: Numbers,
    q_logits_t: Numbers,
    q_t_selector: Numbers,
) -> Numbers:
    probs = softmax(q_logits_t[first_greatest(q_t_selector)])
    return categorical_l2_project([r_t + discount_t * z for z in q_atoms_t], probs, q_atoms_tm1)


def categorical_error(q_logits_tm1: Numbers, a_tm1: Numbers, target_tm1: Numbers) -> Numbers:
    return -sum(t * math.log(p) for t, p in zip(target_tm1, softmax(q_logits_tm1[a_tm1]), strict=True))


def categorical_double_q_learning(
    q_atoms_tm1: Numbers,
    q_logits_tm1: Numbers,
    a_tm1: Numbers,
    r_t: Numbers,
    discount_t: Numbers,
    q_atoms_t: Numbers,
    q_logits_t: Numbers,
    q_t_selector: Numbers,
) -> Numbers:
    target = categorical_target(q_atoms_tm1, r_t, discount_t, q_atoms_t, q_logits_t, q_t_selector)
    return categorical_error(q_logits_tm1, a_tm1, target)


def categorical_q_learning(
    q_atoms_tm1: Numbers,
    q_logits_tm1: Numbers,
    a_tm1: Numbers,
    r_t: Numbers,
    discount_t: Numbers,
    q_atoms_t: Numbers,
    q_logits_t: Numbers,
) -> Numbers:
    selector = categorical_values(q_atoms_t, q_logits_t)
    return categorical_double_q_learning(
        q_atoms_tm1, q_logits_tm1, a_tm1, r_t, discount_t, q_atoms_t, q_logits_t, selector
    )


# Quantiles


def quantile_values(dist_q: Numbers) -> Numbers:
    return averaged(dist_q)


def quantile_regression_loss(
    dist_src: Numbers, tau_src: Numbers, dist_target: Numbers, huber_param: Numbers = 0.0
) -> Numbers:
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


def quantile_target(r_t: Numbers, discount_t: Numbers, dist_q_t_selector: Numbers, dist_q_t: Numbers) -> Numbers:
    action = first_greatest(averaged(dist_q_t_selector))
    return np.array([r_t + discount_t * quantiles[action] for quantiles in dist_q_t])


def quantile_error(
    dist_q_tm1: Numbers, tau_q_tm1: Numbers, a_tm1: Numbers, target_tm1: Numbers, huber_param: Numbers = 0.0
) -> Numbers:
    return quantile_regression_loss(dist_q_tm1[:, a_tm1], tau_q_tm1, target_tm1, huber_param)


def quantile_q_learning(
    dist_q_tm1: Numbers,
    tau_q_tm1: Numbers,
    a_tm1: Numbers,
    r_t: Numbers,
    discount_t: Numbers,
    dist_q_t_selector: Numbers,
    dist_q_t: Numbers,
    huber_param: Numbers = 0.0,
) -> Numbers:
    target = quantile_target(r_t, discount_t, dist_q_t_selector, dist_q_t)
    return quantile_error(dist_q_tm1, tau_q_tm1, a_tm1, target, huber_param)


def implicit_quantile(
    dist_q_tm1: Numbers,
    tau_q_tm1: Numbers,
    a_tm1: Numbers,
    r_t: Numbers,
    discount_t: Numbers,
    dist_q_t_selector: Numbers,
    dist_q_t: Numbers,
    huber_param: Numbers = 1.0,
) -> Numbers:
    arguments = (dist_q_tm1, tau_q_tm1, a_tm1, r_t, discount_t, dist_q_t_selector, dist_q_t, huber_param)
    return quantile_q_learning(*arguments) / huber_param
