"""The rules that both jaxq and rlax have, and random arguments for them; ``rlax_parity`` compares."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any, NamedTuple

import numpy as np

#: A, T, N as in the rules; K and L atoms, or other numbers of quantiles. A rule is drawn in each shape, with its
#: options in turn.
SHAPES = (
    {"A": 2, "T": 1, "N": 1, "K": 1, "L": 2},
    {"A": 3, "T": 4, "N": 4, "K": 5, "L": 3},
    {"A": 5, "T": 7, "N": 8, "K": 9, "L": 9},
    {"A": 4, "T": 12, "N": 5, "K": 21, "L": 11},
)


class Rule(NamedTuple):
    """Their function, the arguments in the order of both with the letters of their axes, and what is not traced."""

    theirs: str
    arguments: str
    options: tuple[dict[str, Any], ...] = ({},)


PAIR = "SIGNED_HYPERBOLIC_PAIR"
STEP = "q_tm1:A a_tm1 r_t discount_t "
STEPS = "q_tm1:TA a_tm1:T r_t:T discount_t:T "
RETURN = "r_t:T discount_t:T v_t:T"
RETRACE = "q_tm1:TA q_t:TA a_tm1:T a_t:T r_t:T discount_t:T pi_t:TA mu_t:T lambda_"
OFF_POLICY = "q_t:TA a_t:T r_t:T discount_t:T c_t:T pi_t:TA"
N_STEP = "q_tm1:TA a_tm1:T target_q_t:TA a_t:T r_t:T discount_t:T"
ATOMS = "q_atoms_tm1:K q_logits_tm1:AK a_tm1 r_t discount_t q_atoms_t:L q_logits_t:AL"
QUANTILES = "dist_q_tm1:NA tau_q_tm1:N a_tm1 r_t discount_t dist_q_t_selector:KA dist_q_t:LA"
LENGTHS = tuple({"n": n} for n in (2, 6, 3, 12, 1, 4))  # within the trajectory, all of it, and beyond it
PAIRED = ({"tx_pair": PAIR},)
HUBER = ({"huber_param": 1.0}, {"huber_param": 0.1}, {"huber_param": 10.0})
EPS = ({}, {"eps": 1e-2})
#: By our name; what stands behind a comma tells variants apart.
RULES = {
    "q_learning": Rule("rlax.q_learning", STEP + "q_t:A"),
    "double_q_learning": Rule("rlax.double_q_learning", STEP + "q_t_value:A q_t_selector:A"),
    "sarsa": Rule("rlax.sarsa", STEP + "q_t:A a_t"),
    "expected_sarsa": Rule("rlax.expected_sarsa", STEP + "q_t:A probs_a_t:A"),
    "persistent_q_learning": Rule("rlax.persistent_q_learning", STEP + "q_t:A action_gap_scale"),
    "q_lambda, one lambda": Rule("rlax.q_lambda", STEPS + "q_t:TA lambda_"),
    "q_lambda, a lambda each step": Rule("rlax.q_lambda", STEPS + "q_t:TA lambda_:T"),
    "q_lambda, tx_pair": Rule("rlax.transformed_q_lambda", STEPS + "q_t:TA lambda_", PAIRED),
    "sarsa_lambda": Rule("rlax.sarsa_lambda", STEPS + "q_t:TA a_t:T lambda_"),
    "retrace": Rule("rlax.retrace", RETRACE, EPS),
    "retrace, tx_pair": Rule("rlax.transformed_retrace", RETRACE, PAIRED),
    "n_step_q_learning": Rule("rlax.transformed_n_step_q_learning", N_STEP, LENGTHS),
    "n_step_q_learning, tx_pair": Rule(
        "rlax.transformed_n_step_q_learning", N_STEP, tuple(PAIRED[0] | length for length in LENGTHS)
    ),
    "lambda_returns, one lambda": Rule("rlax.lambda_returns", RETURN + " lambda_"),
    "lambda_returns, a lambda each step": Rule("rlax.lambda_returns", RETURN + " lambda_:T"),
    "n_step_bootstrapped_returns": Rule("rlax.n_step_bootstrapped_returns", RETURN, LENGTHS),
    "n_step_bootstrapped_returns, lambda_t": Rule(
        "rlax.n_step_bootstrapped_returns", "r_t:T discount_t:T v_t:T n lambda_t:T", LENGTHS
    ),
    "off_policy_returns": Rule("rlax.general_off_policy_returns_from_action_values", OFF_POLICY),
    "transformed_lambda_returns": Rule("rlax.transformed_lambda_returns", f"tx_pair {RETURN} lambda_", PAIRED),
    "transformed_n_step_returns": Rule(
        "rlax.transformed_n_step_returns", f"tx_pair {RETURN} n", tuple(PAIRED[0] | length for length in LENGTHS)
    ),
    "transformed_off_policy_returns": Rule(
        "rlax.transformed_general_off_policy_returns_from_action_values", f"tx_pair {OFF_POLICY}", PAIRED
    ),
    "signed_hyperbolic": Rule("rlax.signed_hyperbolic", "x:T", EPS),
    "signed_parabolic": Rule("rlax.signed_parabolic", "x:T", EPS),
    "categorical_l2_project": Rule("rlax.categorical_l2_project", "z_p:L probs:L z_q:K"),
    "categorical_q_learning": Rule("rlax.categorical_q_learning", ATOMS),
    "categorical_double_q_learning": Rule("rlax.categorical_double_q_learning", ATOMS + " q_t_selector:A"),
    "quantile_regression_loss": Rule("rlax.quantile_regression_loss", "dist_src:N tau_src:N dist_target:K"),
    "quantile_regression_loss, Huber": Rule(
        "rlax.quantile_regression_loss", "dist_src:N tau_src:N dist_target:K", HUBER
    ),
    "quantile_q_learning": Rule("rlax.quantile_q_learning", QUANTILES),
    "quantile_q_learning, Huber": Rule("rlax.quantile_q_learning", QUANTILES, HUBER),
    "periodic_update": Rule("rlax.periodic_update", "online:A target:A updates period"),
    "polyak_update": Rule("optax.incremental_update", "online:A target:A tau"),
}


class Group(NamedTuple):
    """Draws of one rule that share shapes and options; of the inputs, [draws, ...] by name."""

    rule: Rule
    options: dict[str, Any]
    inputs: dict[str, np.ndarray]


def groups(title: str, draws: int) -> Iterator[Group]:
    """The draws of a rule: each shape and each of the options at least once."""
    rule = RULES[title]
    rng = np.random.default_rng(list(title.encode()))
    for index in range(max(len(SHAPES), len(rule.options))):
        shape, options = SHAPES[index % len(SHAPES)], rule.options[index % len(rule.options)]
        yield Group(rule, options, draw(rng, rule, options, shape, draws))


def draw(rng: np.random.Generator, rule: Rule, options: dict, shape: dict, draws: int) -> dict[str, np.ndarray]:
    """Arguments of a rule: values of sizes from 1e-3 to 1e3, one size a draw, with many ties in every second draw.

    Squashed values go to 30, which are true ones of a thousand. No value is 0: the slope of rlax's rescaling is not the
    true one there. Sums of tied values are exact, so that float32 takes the same of equal means as float64.
    """
    sizes = 10 ** rng.uniform(-3, 1.5 if "tx_pair" in options else 3, draws)
    inputs = {}
    for argument in rule.arguments.split():
        name, _, letters = argument.partition(":")
        full = (draws, *(shape[letter] for letter in letters))
        size = sizes.reshape(-1, *(1 for _ in letters))
        if name in options:
            continue
        if name.startswith("a_"):
            inputs[name] = rng.integers(0, shape["A"], full, dtype=np.int32)
        elif name in ("updates", "period"):
            inputs[name] = rng.integers(1, 5, full, dtype=np.int32)
        elif name.startswith(("probs", "pi_")):
            parts = rng.exponential(size=full) * (rng.random(full) < 0.7) + 1e-3 * (np.arange(full[-1]) == 0)
            inputs[name] = parts / parts.sum(-1, keepdims=True)
        elif "atoms" in name or name == "z_q":
            ladder = np.cumsum(rng.uniform(0.5, 1.5, full), axis=-1)
            inputs[name] = 4 * size * (ladder / ladder[:, -1:] - 0.5)
        elif name == "z_p" or moving(name):
            normal, tied = rng.normal(size=full), rng.choice([-2.0, -1.0, 1.0, 2.0], full)
            odd = (np.arange(draws) % 2).reshape(size.shape) * (name != "r_t")
            inputs[name] = np.where(odd, tied * 2 ** np.round(np.log2(size)), normal * size)
        else:  # a fraction: a discount, lambda, a quantile, a probability
            inputs[name] = np.clip(rng.uniform(-0.3, 1.3, full), 0, 1)
    if "z_p" in inputs:  # in every second draw, one that is an atom of both
        inputs["z_p"][1::2, 0] = inputs["z_q"][1::2, -1]
    return {name: value if value.dtype == np.int32 else value.astype(np.float32) for name, value in inputs.items()}


def moving(name: str) -> bool:
    """Whether gradients are taken of an argument: of values, of logits, and of what is projected."""
    words = "q_tm1 q_t q_t_value q_t_selector target_q_t r_t v_t x probs online target".split()
    return name in words or name.startswith("dist_") or "logits" in name
