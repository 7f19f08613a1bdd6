"""Every rule gives numbers that can be checked by hand, with and without jit."""

from __future__ import annotations

import functools
import inspect
import math

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxq import rules
from jaxq.verify import rule_cases as cases

LOG2, LOG3 = math.log(2), math.log(3)
#: h(x) = sign(x) (sqrt(|x| + 1) - 1): 3 becomes 1, 8 becomes 2, 15 becomes 3.
ROOTS = rules.TxPair(
    functools.partial(rules.signed_hyperbolic, eps=0), functools.partial(rules.signed_parabolic, eps=0)
)
ROW, NEXT = [1.0, 4.0], [2.0, 6.0]
ZEROS, ENSEMBLE = [[0.0, 0.0], [0.0, 0.0]], [[0.0, 4.0], [4.0, 8.0]]
HALVES, THREE = [0.5, 0.5, 0.5], ([1.0, 2.0, 3.0], [0.5, 0.5, 0.5], [8.0, 4.0, 6.0])
FIRST, SECOND = [True, False, False], [False, True, False]
Q_T, PI_T = [[2.0, 4.0], [6.0, 0.0]], [[0.5, 0.5], [0.25, 0.75]]
ONES, ATOMS = [1.0, 1.0], [0.0, 1.0, 2.0]
LOGITS_TM1, LOGITS_T = [[0.0, 0.0, 0.0], [LOG2, 0.0, 0.0]], [[0.0, 0.0], [0.0, LOG3]]
TABLE = [[1.0, 2.0], [3.0, 4.0]]

TABLE_OF_NUMBERS = [
    ("action_value", ([1.0, -2.0, 3.0], 1), -2.0),
    ("greedy_value", ([-5.0, -2.0],), -2.0),
    ("double_value", ([1.0, -2.0, 3.0], [0.0, 7.0, 6.0]), -2.0),
    ("double_value", ([1.0, -2.0, 3.0], [6.0, 2.0, 6.0]), 1.0),  # the first of equals
    ("expected_value", ([1.0, -2.0, 3.0], [0.5, 0.25, 0.25]), 0.75),
    ("soft_value", ([1.0, 1.0], 0.5), 1 + 0.5 * LOG2),
    ("soft_value", ([LOG2, LOG3], 1.0), math.log(5)),
    ("averaged", (ENSEMBLE,), [2.0, 6.0]),
    ("maxmin", ([[0.0, 4.0], [4.0, 2.0]],), [0.0, 2.0]),
    ("td_target", (1.0, 0.5, 8.0), 5.0),
    ("td_target", (1.0, 0.0, 8.0), 1.0),
    ("td_error", (ROW, 1, 9.5), 5.5),
    ("q_learning", (ROW, 0, 1.0, 0.5, NEXT), 3.0),
    ("q_learning", (ROW, 1, 1.0, 0.0, NEXT), -3.0),
    ("double_q_learning", (ROW, 0, 1.0, 0.5, NEXT, [3.0, 2.0]), 1.0),
    ("sarsa", (ROW, 1, 1.0, 0.5, NEXT, 0), -2.0),
    ("expected_sarsa", (ROW, 0, 1.0, 0.5, NEXT, [0.25, 0.75]), 2.5),
    ("soft_q_learning", (ROW, 0, 1.0, 0.5, [0.0, 0.0], 2.0), LOG2),
    ("munchausen_q_learning", (ROW, 0, 1.0, 0.5, [0.0, 0.0], [7.0, 7.0], 1.0, 0.5), 0.0),  # - log 2 / 2 + log 2 / 2
    ("munchausen_q_learning", (ROW, 0, 1.0, 0.0, NEXT, [7.0, 7.0], 1.0, 0.5, -0.5), -0.25),  # clipped
    ("advantage_learning", (ROW, 0, 1.0, 0.5, NEXT, [1.0, 3.0], 0.25), 2.5),  # 1 + 3 - 0.5 - 1
    ("persistent_q_learning", (ROW, 0, 1.0, 0.5, NEXT, 0.25), 2.5),  # 1 + 0.5 * 5 - 1
    ("persistent_advantage_learning", (ROW, 0, 1.0, 0.5, NEXT, [1.0, 9.0], 0.5), 1.0),  # max(-1, 1)
    ("persistent_advantage_learning", (ROW, 0, 1.0, 0.5, NEXT, [1.0, 1.0], 0.5), 3.0),  # max(3, 1)
    ("averaged_q_learning", (ROW, 0, 1.0, 0.5, ENSEMBLE), 3.0),
    ("maxmin_q_learning", (ROW, 0, 1.0, 0.5, ENSEMBLE), 2.0),
    ("lambda_returns", (*THREE, 0.5), [4.125, 4.5, 6.0]),  # 1 + 0.5 (4 + 2.25), 2 + 0.5 (2 + 3), 3 + 0.5 * 6
    ("lambda_returns", (*THREE,), [3.5, 5.0, 6.0]),
    ("lambda_returns", (*THREE, [0.0, 1.0, 1.0]), [5.0, 5.0, 6.0]),
    ("lambda_returns", (*THREE, 0.5, FIRST), [5.0, 4.5, 6.0]),
    ("lambda_returns", (*THREE, 0.5, SECOND), [4.0, 4.0, 6.0]),
    ("lambda_returns", ([1.0, 2.0, 3.0], [0.5, 0.0, 0.5], [8.0, 4.0, 6.0], 0.5), [3.5, 2.0, 6.0]),  # 1 + 0.5 (4 + 1)
    ("n_step_bootstrapped_returns", (*THREE, 2), [3.0, 5.0, 6.0]),  # 1 + 0.5 (2 + 0.5 * 4), ...
    ("n_step_bootstrapped_returns", (*THREE, 1), [5.0, 4.0, 6.0]),
    ("n_step_bootstrapped_returns", (*THREE, 3), [3.5, 5.0, 6.0]),
    ("n_step_bootstrapped_returns", (*THREE, 2, 0.5), [4.0, 4.5, 6.0]),
    ("n_step_bootstrapped_returns", (*THREE, 2, 1.0, FIRST), [5.0, 5.0, 6.0]),
    ("n_step_bootstrapped_returns", (*THREE, 3, 1.0, SECOND), [3.0, 4.0, 6.0]),
    ("off_policy_returns", (Q_T, [1, 0], ONES, HALVES[:2], 1.0, PI_T), [1.375, 1.75]),  # 1 + 0.5 (3 - 4 + 1.75)
    ("off_policy_returns", (Q_T, [1, 0], ONES, HALVES[:2], [0.5, 0.25], PI_T), [1.9375, 1.75]),  # tree backup
    ("off_policy_returns", (Q_T, [1, 0], ONES, HALVES[:2], 1.0, PI_T, [True, False]), [2.5, 1.75]),
    ("watkins_lambda", (Q_T, [0, 0], 0.5), [0.0, 0.5]),
    ("watkins_lambda", ([[3.0, 3.0]], [1], [0.5]), [0.5]),  # as good as the first of equals
    ("retrace_weights", ([0, 1], PI_T, [1.0, 0.25], [0.5, 1.0], 0.0), [0.25, 1.0]),
    ("signed_hyperbolic", ([24.0, -24.0], 0.5), [16.0, -16.0]),  # 4 + 12
    ("signed_parabolic", ([16.0, -16.0], 0.5), [24.0, -24.0]),
    ("transformed_lambda_returns", (ROOTS, [6.5, -1.0], [0.5, 0.5], [3.0, 2.0]), [2.0, 1.0]),  # true 6.5 + 1.5, 3
    ("transformed_n_step_returns", (ROOTS, [7.5, -1.0], [0.5, 0.5], [3.0, 2.0], 1), [3.0, 1.0]),  # true 15, 3
    ("transformed_off_policy_returns", (ROOTS, [[1.0, 2.0]], [0], [1.0], [0.5], 1.0, [[0.8, 0.2]]), [1.0]),  # 1 + 2
    ("n_step_q_learning", ([ROW, ROW], [0, 1], Q_T, [1, 0], ONES, HALVES[:2], 2), [2.0, 0.0]),  # 1 + 0.5 * 4 - 1, ...
    ("sarsa_lambda", ([ROW, ROW], [0, 1], ONES, HALVES[:2], Q_T, [0, 1], 0.5), [0.75, -3.0]),  # 1 + 0.5 (1 + 0.5) - 1
    ("q_lambda", ([ROW, ROW], [0, 1], ONES, HALVES[:2], Q_T, 0.5), [2.0, 0.0]),  # 1 + 0.5 (2 + 2) - 1
    ("retrace", (ZEROS, Q_T, [0, 0], [1, 0], ONES, HALVES[:2], PI_T, [1.0, 1.0], 1.0, 0.0), [1.9375, 1.75]),
    ("categorical_values", ([0.0, 2.0], LOGITS_T), [1.0, 1.5]),
    ("categorical_l2_project", ([2.0, -1.0], [0.75, 0.25], [0.0, 1.0, 4.0]), [0.25, 0.5, 0.25]),
    ("categorical_target", (ATOMS, 0.5, 0.5, [0.0, 2.0], LOGITS_T, [0.0, 1.0]), [0.125, 0.5, 0.375]),
    ("categorical_error", ([[0.0, LOG3]], 0, [0.5, 0.5]), -0.5 * math.log(3 / 16)),
    ("categorical_double_q_learning", (ATOMS, LOGITS_TM1, 1, 0.5, 0.5, [0.0, 2.0], LOGITS_T, [0.0, 1.0]), 1.875 * LOG2),
    ("categorical_q_learning", (ATOMS, LOGITS_TM1, 1, 0.5, 0.5, [0.0, 2.0], LOGITS_T), 1.875 * LOG2),
    ("quantile_midpoints", (4,), [0.125, 0.375, 0.625, 0.875]),
    ("quantile_values", ([[0.0, 1.0], [2.0, 1.0]],), [1.0, 1.0]),
    ("quantile_regression_loss", ([1.0, 0.0], [0.25, 0.5], [2.0, 0.0]), 1.0),  # (0.25 + 0.75) / 2 + (0.5 * 2 + 0) / 2
    ("quantile_regression_loss", ([0.0], [0.25], [2.0, -0.5], 1.0), 0.234375),  # (0.25 * 1.5 + 0.75 * 0.125) / 2
    ("quantile_target", (1.0, 0.5, [[0.0, 1.0]], [[9.0, 2.0], [9.0, 4.0]]), [2.0, 3.0]),
    ("quantile_error", ([[7.0, 0.0]], [0.25], 1, [2.0, -0.5], 1.0), 0.234375),
    (
        "quantile_q_learning",
        ([[7.0, 0.0]], [0.25], 1, 0.0, 1.0, [[0.0, 1.0]], [[0.0, 2.0], [0.0, -0.5]], 1.0),
        0.234375,
    ),
    ("implicit_quantile", ([[7.0, 0.0]], [0.25], 1, 0.0, 1.0, [[0.0, 1.0]], [[0.0, 2.0], [0.0, -0.5]], 0.5), 0.3125),
    ("update_table", (TABLE, 1, 0, 0.5), [[1.0, 2.0], [3.5, 4.0]]),
    ("accumulating_trace", (TABLE, 1, 0, 0.5), [[0.5, 1.0], [2.5, 2.0]]),
    ("replacing_trace", (TABLE, 1, 0, 0.5), [[0.5, 1.0], [1.0, 2.0]]),
    ("dutch_trace", (TABLE, 1, 0, 0.5, 0.5), [[0.5, 1.0], [1.75, 2.0]]),
    ("polyak_update", (jnp.array(8.0), jnp.array(4.0), 0.25), 5.0),
    ("periodic_step", (6, 3, 0.5), 0.5),
    ("periodic_step", (7, 3, 0.5), 0.0),
    ("periodic_update", (jnp.array(8.0), jnp.array(4.0), 6, 3), 8.0),
    ("periodic_update", (jnp.array(8.0), jnp.array(4.0), 7, 3), 4.0),
]
#: One row of each rule, to be compiled.
ONCE = {row[0]: row for row in TABLE_OF_NUMBERS}


@pytest.mark.parametrize(
    ("jit", "name", "arguments", "expected"),
    [(False, *row) for row in TABLE_OF_NUMBERS] + [(True, *row) for row in ONCE.values()],
)
def test_rules_give_the_numbers_worked_by_hand(jit, name, arguments, expected):
    given = dict(zip(inspect.signature(getattr(rules, name)).parameters, arguments, strict=False))
    static = {key: given.pop(key) for key in ("n", "tx_pair", "count") if key in given}
    rule = functools.partial(getattr(rules, name), **static)
    result = (jax.jit(rule) if jit else rule)(**{key: jnp.asarray(value) for key, value in given.items()})
    np.testing.assert_allclose(result, expected, rtol=1e-6, atol=1e-6)
    assert result.shape == np.shape(expected)


def test_every_rule_was_worked_by_hand():
    assert {name for name, *_ in TABLE_OF_NUMBERS} == set(cases.NAMES) | {"quantile_midpoints"}


def test_a_single_member_and_a_single_action_are_what_they_are():
    assert rules.soft_value(jnp.array([12345.678]), 0.03) == np.float32(12345.678)
    assert rules.munchausen_q_learning([2.0], 0, 1.0, 0.5, [4.0], [12345.678]) == 1.0  # its log-probability is 0


def test_the_defaults_of_munchausen_are_those_of_the_paper():
    row, q = jnp.array([0.0, 0.01]), jnp.array([0.0, 0.02])
    explicit = rules.munchausen_q_learning(row, 0, 1.0, 0.5, q, q, 0.03, 0.9, -1.0)
    assert rules.munchausen_q_learning(row, 0, 1.0, 0.5, q, q) == explicit
