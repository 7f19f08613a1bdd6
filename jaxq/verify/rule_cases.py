"""Every public rule with the names and shapes of its arguments, and random arguments for it."""

from __future__ import annotations

import functools
import inspect
import re
from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
from numpy.typing import DTypeLike

from jaxq import rules
from jaxq.verify import numpy_rules, numpy_rules_distributions, numpy_rules_multi

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
#: Where to look for a rule in NumPy, in this order.
REFERENCES = (numpy_rules, numpy_rules_distributions, numpy_rules_multi)
RULES = {line.split()[0]: re.findall(r"(\w+)\[(\w*)\]", line) for line in SIGNATURES.strip().splitlines()}
NAMES = list(RULES)


def statics(name: str, where: Any) -> dict[str, Any]:
    """The arguments that are no arrays, for JAX or for NumPy."""
    line = next(line for line in SIGNATURES.splitlines() if line.split()[:1] == [name])
    found: dict[str, Any] = {"n": 3} if " n" in re.sub(r"\S+\[", "", line) else {}
    if line.endswith("tx_pair"):
        found["tx_pair"] = rules.SIGNED_HYPERBOLIC_PAIR if where is rules else numpy_rules_multi.HYPERBOLIC
    return found


def defaults(name: str) -> set[str]:
    """The arguments of a rule that have a default, in the library and in NumPy."""
    both = (getattr(rules, name), _in_numpy(name)[1])
    kept = [{k for k, v in inspect.signature(one).parameters.items() if v.default is not v.empty} for one in both]
    return (kept[0] & kept[1]) - {"eps"}


def rule(name: str, *, given: bool = True) -> Callable[..., Any]:
    """The library's rule, which takes arrays by name; ``given``: the arguments that are no arrays, even those that have
    a default."""
    kept = {k: v for k, v in statics(name, rules).items() if given or k not in defaults(name)}
    return functools.partial(getattr(rules, name), **kept)


def reference(name: str, *, given: bool = True) -> Callable[..., Any]:
    """The same in NumPy."""
    module, function = _in_numpy(name)
    kept = {k: v for k, v in statics(name, module).items() if given or k not in defaults(name)}
    return functools.partial(function, **kept)


def _in_numpy(name: str) -> tuple[Any, Callable[..., Any]]:
    module = next(one for one in REFERENCES if hasattr(one, name))
    return module, getattr(module, name)


def draw(rng: np.random.Generator, argument: str, letters: str, lengths: Mapping[str, int], *, ties: bool) -> Any:
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


def arguments(
    name: str, rng: np.random.Generator, dtype: DTypeLike, lengths: Mapping[str, int], *, ties: bool = False
) -> dict[str, np.ndarray]:
    """Random arguments of a rule, floats in one dtype and integers in int32."""
    found = {}
    kinds: dict[str, DTypeLike] = {"f": dtype, "i": np.int32, "b": bool}
    for argument, letters in RULES[name]:
        value = np.asarray(draw(rng, argument, letters, lengths, ties=ties))
        found[argument] = value.astype(kinds[value.dtype.kind])
    return found


def in_float64(given: Mapping[str, np.ndarray]) -> dict[str, np.ndarray]:
    """Arguments for a reference: the same numbers in float64."""
    return {k: v.astype(float) if v.dtype.kind == "f" else v for k, v in given.items()}


def floats(given: Mapping[str, np.ndarray]) -> dict[str, np.ndarray]:
    """Those that are no integers and no flags."""
    return {k: v for k, v in given.items() if v.dtype.kind == "f"}


def error_of(name: str) -> str | None:
    """The argument that a rule's error is taken of; None for a target or a value."""
    if name in ("quantile_target", "categorical_target"):
        return None
    return next((argument for argument, _ in RULES[name] if argument in ERRORS), None)
