"""The mathematics of value-based learning: one transition, or one trajectory, at a time; batches are ``jax.vmap``.

Names carry the timeline: ``q_tm1``, ``a_tm1`` belong to the state that was left (Sutton and Barto's S_t, A_t), ``r_t``,
``discount_t``, ``q_t`` to the one that was reached (R_{t+1}, S_{t+1}). ``discount_t`` is gamma times 0 after a
termination and gamma times 1 otherwise, truncation included, so that termination, gamma and n-step all pass through one
argument.

A rule is a *target* put into an *error*: ``q_learning`` is ``td_error`` of the ``td_target`` of the ``greedy_value``.
Gradients flow through what the error is taken of (``q_tm1``, ``q_logits_tm1``, ``dist_q_tm1``) and nowhere else.

``jax.vmap`` maps keyword arguments as well, so numbers that a batch shares go by position with ``in_axes`` None, or
into a ``functools.partial`` first.
"""

from jaxq.rules.categorical import (
    categorical_double_q_learning,
    categorical_error,
    categorical_l2_project,
    categorical_q_learning,
    categorical_target,
    categorical_values,
)
from jaxq.rules.multi_step import n_step_q_learning, q_lambda, retrace, retrace_weights, sarsa_lambda
from jaxq.rules.one_step import (
    advantage_learning,
    averaged_q_learning,
    double_q_learning,
    expected_sarsa,
    maxmin_q_learning,
    munchausen_q_learning,
    persistent_advantage_learning,
    persistent_q_learning,
    q_learning,
    sarsa,
    soft_q_learning,
    td_error,
    td_target,
)
from jaxq.rules.quantile import (
    implicit_quantile,
    quantile_error,
    quantile_midpoints,
    quantile_q_learning,
    quantile_regression_loss,
    quantile_target,
    quantile_values,
)
from jaxq.rules.rescaling import (
    IDENTITY_PAIR,
    SIGNED_HYPERBOLIC_PAIR,
    TxPair,
    signed_hyperbolic,
    signed_parabolic,
    transformed_lambda_returns,
    transformed_n_step_returns,
    transformed_off_policy_returns,
)
from jaxq.rules.returns import lambda_returns, n_step_bootstrapped_returns, off_policy_returns, watkins_lambda
from jaxq.rules.tables import accumulating_trace, dutch_trace, replacing_trace, update_table
from jaxq.rules.target_networks import periodic_step, periodic_update, polyak_update
from jaxq.rules.values import (
    action_value,
    averaged,
    double_value,
    expected_value,
    greedy_value,
    maxmin,
    random_subset,
    soft_value,
)

__all__ = [
    "IDENTITY_PAIR",
    "SIGNED_HYPERBOLIC_PAIR",
    "TxPair",
    "accumulating_trace",
    "action_value",
    "advantage_learning",
    "averaged",
    "averaged_q_learning",
    "categorical_double_q_learning",
    "categorical_error",
    "categorical_l2_project",
    "categorical_q_learning",
    "categorical_target",
    "categorical_values",
    "double_q_learning",
    "double_value",
    "dutch_trace",
    "expected_sarsa",
    "expected_value",
    "greedy_value",
    "implicit_quantile",
    "lambda_returns",
    "maxmin",
    "maxmin_q_learning",
    "munchausen_q_learning",
    "n_step_bootstrapped_returns",
    "n_step_q_learning",
    "off_policy_returns",
    "periodic_step",
    "periodic_update",
    "persistent_advantage_learning",
    "persistent_q_learning",
    "polyak_update",
    "q_lambda",
    "q_learning",
    "quantile_error",
    "quantile_midpoints",
    "quantile_q_learning",
    "quantile_regression_loss",
    "quantile_target",
    "quantile_values",
    "random_subset",
    "replacing_trace",
    "retrace",
    "retrace_weights",
    "sarsa",
    "sarsa_lambda",
    "signed_hyperbolic",
    "signed_parabolic",
    "soft_q_learning",
    "soft_value",
    "td_error",
    "td_target",
    "transformed_lambda_returns",
    "transformed_n_step_returns",
    "transformed_off_policy_returns",
    "update_table",
    "watkins_lambda",
]
