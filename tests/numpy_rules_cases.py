"""Every public rule with the names and shapes of its arguments, and random arguments for it."""

from __future__ import annotations

import functools
import re

import numpy as np
import numpy_rules
import numpy_rules_multi

from jaxq import rules

SIGNATURES = """
action_value q_t[A] a_t[]
greedy_value q_t[A]
double_value q_t_value[A] q_t_selector[A]
expected_value q_t[A] probs_a_t[A]
soft_value q_t[A] temperature[]
averaged q_t[KA]
maxmin q_t[KA]
td_target r_t[] discount_t[] v_t[]
td_error q_tm1[A] a_tm1[] target_tm1[]
q_learning q_tm1[A] a_tm1[] r_t[] discount_t[] q_t[A]
double_q_learning q_tm1[A] a_tm1[] r_t[] discount_t[] q_t_value[A] q_t_selector[A]
sarsa q_tm1[A] a_tm1[] r_t[] discount_t[] q_t[A] a_t[]
expected_sarsa q_tm1[A] a_tm1[] r_t[] discount_t[] q_t[A] probs_a_t[A]
soft_q_learning q_tm1[A] a_tm1[] r_t[] discount_t[] q_t[A] temperature[]
munchausen_q_learning q_tm1[A] a_tm1[] r_t[] discount_t[] q_t[A] q_tm1_target[A] temperature[] munchausen_scale[] clip_min[]
advantage_learning q_tm1[A] a_tm1[] r_t[] discount_t[] q_t[A] q_tm1_target[A] action_gap_scale[]
persistent_q_learning q_tm1[A] a_tm1[] r_t[] discount_t[] q_t[A] action_gap_scale[]
persistent_advantage_learning q_tm1[A] a_tm1[] r_t[] discount_t[] q_t[A] q_tm1_target[A] action_gap_scale[]
averaged_q_learning q_tm1[A] a_tm1[] r_t[] discount_t[] q_t[KA]
maxmin_q_learning q_tm1[A] a_tm1[] r_t[] discount_t[] q_t[KA]
lambda_returns r_t[T] discount_t[T] v_t[T] lambda_[T] cut_t[T]
n_step_bootstrapped_returns r_t[T] discount_t[T] v_t[T] lambda_t[T] cut_t[T] n
off_policy_returns q_t[TA] a_t[T] r_t[T] discount_t[T] c_t[T] pi_t[TA] cut_t[T]
watkins_lambda q_t[TA] a_t[T] lambda_[T]
retrace_weights a_t[T] pi_t[TA] mu_t[T] lambda_[T]
signed_hyperbolic x[K]
signed_parabolic x[K]
transformed_lambda_returns r_t[T] discount_t[T] v_t[T] lambda_[T] cut_t[T] tx_pair
transformed_n_step_returns r_t[T] discount_t[T] v_t[T] lambda_t[T] cut_t[T] n tx_pair
transformed_off_policy_returns q_t[TA] a_t[T] r_t[T] discount_t[T] c_t[T] pi_t[TA] cut_t[T] tx_pair
n_step_q_learning q_tm1[TA] a_tm1[T] target_q_t[TA] a_t[T] r_t[T] discount_t[T] cut_t[T] n tx_pair
sarsa_lambda q_tm1[TA] a_tm1[T] r_t[T] discount_t[T] q_t[TA] a_t[T] lambda_[T] cut_t[T] tx_pair
q_lambda q_tm1[TA] a_tm1[T] r_t[T] discount_t[T] q_t[TA] lambda_[T] cut_t[T] tx_pair
retrace q_tm1[TA] q_t[TA] a_tm1[T] a_t[T] r_t[T] discount_t[T] pi_t[TA] mu_t[T] lambda_[T] cut_t[T] tx_pair
categorical_values q_atoms[K] q_logits[AK]
categorical_l2_project z_p[K] probs[K] z_q[M]
categorical_target q_atoms_tm1[M] r_t[] discount_t[] q_atoms_t[K] q_logits_t[AK] q_t_selector[A]
categorical_error q_logits_tm1[AK] a_tm1[] target_tm1[K]
categorical_double_q_learning q_atoms_tm1[K] q_logits_tm1[AK] a_tm1[] r_t[] discount_t[] q_atoms_t[M] q_logits_t[AM] q_t_selector[A]
categorical_q_learning q_atoms_tm1[K] q_logits_tm1[AK] a_tm1[] r_t[] discount_t[] q_atoms_t[M] q_logits_t[AM]
quantile_values dist_q[NA]
quantile_regression_loss dist_src[N] tau_src[N] dist_target[M] huber_param[]
quantile_target r_t[] discount_t[] dist_q_t_selector[MA] dist_q_t[NA]
quantile_error dist_q_tm1[NA] tau_q_tm1[N] a_tm1[] target_tm1[M] huber_param[]
quantile_q_learning dist_q_tm1[NA] tau_q_tm1[N] a_tm1[] r_t[] discount_t[] dist_q_t_selector[KA] dist_q_t[MA] huber_param[]
implicit_quantile dist_q_tm1[NA] tau_q_tm1[N] a_tm1[] r_t[] discount_t[] dist_q_t_selector[KA] dist_q_t[MA] huber_param[]
update_table table[SA] state[] action[] amount[]
accumulating_trace trace[SA] state[] action[] decay_t[]
replacing_trace trace[SA] state[] action[] decay_t[]
dutch_trace trace[SA] state[] action[] decay_t[] step_size[]
polyak_update online[SA] target[SA] tau[]
periodic_step updates[] period[] tau[]
periodic_update online[SA] target[SA] updates[] period[]
"""  # noqa: E501
#: Public names that have tests of their own: a draw, a constant, records.
OTHERS = {"random_subset", "quantile_midpoints", "TxPair", "IDENTITY_PAIR", "SIGNED_HYPERBOLIC_PAIR"}

#: The argument that an error is taken of, first in its signature or after the atoms.
ERRORS = ("q_tm1", "q_logits_tm1", "dist_q_tm1")

LENGTHS = [
    {"A": 3, "T": 6, "K": 4, "M": 3, "N": 2, "S": 5},
    {"A": 1, "T": 1, "K": 1, "M": 1, "N": 1, "S": 1},
    {"A": 2, "T": 21, "K": 3, "M": 7, "N": 5, "S": 300},
]
RULES = {line.split()[0]: re.findall(r"(\w+)\[(\w*)\]", line) for line in SIGNATURES.strip().splitlines()}
NAMES = list(RULES)


def statics(name, where):
    """The arguments that are no arrays, for JAX or for NumPy."""
    line = next(line for line in SIGNATURES.splitlines() if line.split()[:1] == [name])
    found = {"n": 3} if " n" in re.sub(r"\S+\[", "", line) else {}
    if line.endswith("tx_pair"):
        found["tx_pair"] = rules.SIGNED_HYPERBOLIC_PAIR if where is rules else numpy_rules_multi.HYPERBOLIC
    return found


@functools.cache
def rule(name):
    return functools.partial(getattr(rules, name), **statics(name, rules))


@functools.cache
def reference(name):
    module = numpy_rules if hasattr(numpy_rules, name) else numpy_rules_multi
    return functools.partial(getattr(module, name), **statics(name, module))


def draw(rng, argument, letters, lengths, *, ties):
    """One random argument in float64, an integer or a bool."""
    shape = tuple(lengths[letter] for letter in letters)
    if argument in ("a_tm1", "a_t", "action"):
        return rng.integers(lengths["A"], size=shape)
    if argument == "state":
        return rng.integers(lengths["S"])
    if argument in ("updates", "period"):
        return rng.integers(1, 9) if argument == "period" else rng.integers(20)
    if argument == "cut_t":
        return rng.random(shape) < rng.choice([0, 0.2, 0.9])
    if argument in ("pi_t", "probs_a_t", "probs") or (argument == "target_tm1" and letters == "K"):
        return rng.dirichlet(np.ones(shape[-1]), size=shape[:-1])
    if argument in ("q_atoms", "q_atoms_tm1", "q_atoms_t", "z_q"):
        return -2 + np.cumsum(rng.uniform(0.1, 1.5, shape))
    if argument in ("discount_t", "lambda_", "lambda_t", "c_t", "tau", "decay_t", "step_size", "action_gap_scale"):
        edges = rng.random(shape) < 0.3
        return np.where(edges, rng.integers(2, size=shape), rng.random(shape))
    if argument in ("mu_t", "temperature", "huber_param", "munchausen_scale", "tau_q_tm1", "tau_src"):
        return rng.uniform(0.05, 0.95, shape)
    if argument == "clip_min":
        return -rng.random(shape)
    return rng.integers(-2, 3, size=shape).astype(float) if ties else 2 * rng.normal(size=shape)


def arguments(name, rng, dtype, lengths, *, ties=False):
    """Random arguments of a rule, floats in one dtype and integers in int32."""
    found = {}
    for argument, letters in RULES[name]:
        value = np.asarray(draw(rng, argument, letters, lengths, ties=ties))
        found[argument] = value.astype({"f": dtype, "i": np.int32, "b": bool}[value.dtype.kind])
    return found


def in_float64(given):
    """Arguments for a reference: the same numbers in float64."""
    return {k: v.astype(float) if v.dtype.kind == "f" else v for k, v in given.items()}


def floats(given):
    return {k: v for k, v in given.items() if v.dtype.kind == "f"}


def error_of(name):
    """The argument that a rule's error is taken of; None for a target or a value."""
    if name in ("quantile_target", "categorical_target"):
        return None
    return next((argument for argument, _ in RULES[name] if argument in ERRORS), None)
