"""Returns and multi-step rules follow from each other, and never see beyond the end of an episode."""

from __future__ import annotations

import functools

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from jaxq import rules
from jaxq.verify import numpy_rules_multi
from jaxq.verify import rule_cases as cases

STEPS, LENGTHS = 6, {"A": 3, "T": 6}
TRAJECTORIES = [name for name in cases.NAMES if "cut_t" in dict(cases.RULES[name])]
EACH = pytest.mark.parametrize("name", TRAJECTORIES)
seeds = st.integers(0, 2**32 - 1)
close = functools.partial(np.testing.assert_allclose, rtol=1e-6, atol=1e-6)
examples = settings(max_examples=12, deadline=None, derandomize=True)


@functools.cache
def jitted(name):
    return jax.jit(lambda given: cases.rule(name)(**given))


def drawn(name, seed, **fixed):
    found = cases.arguments(name, np.random.default_rng(seed), np.float32, LENGTHS)
    return found | {key: np.asarray(value) for key, value in fixed.items() if key in found}


def cut_at(*steps):
    return np.isin(np.arange(STEPS), steps)


@EACH
@examples
@given(seed=seeds, cut=st.integers(0, STEPS - 2), junk=st.sampled_from([1.0, 1e30, -np.inf, np.nan]))
def test_nothing_after_a_cut_changes_what_lies_before_it(name, seed, cut, junk):
    one, other = drawn(name, seed, cut_t=cut_at(cut)), drawn(name, seed + 1, cut_t=cut_at(cut))
    for key, value in cases.floats(other).items():
        other[key] = np.concatenate([one[key][: cut + 1], (value + np.float32(junk))[cut + 1 :]])
    for key in ("a_tm1", "a_t", "cut_t"):
        if key in one:
            other[key] = np.concatenate([one[key][: cut + 1], other[key][cut + 1 :]])
    if "a_t" in one:  # the action after the last one of an episode is another episode's, or none
        other["a_t"][cut] = (one["a_t"][cut] + 1) % 3 if "c_t" in one or name == "retrace" else one["a_t"][cut]
    result, changed = jitted(name)(one), jitted(name)(other)
    np.testing.assert_array_equal(changed[: cut + 1], result[: cut + 1])
    assert np.all(np.isfinite(result))


@EACH
@examples
@given(seed=seeds, cut=st.integers(0, STEPS - 2))
def test_a_trajectory_split_at_its_cut_gives_the_same_numbers(name, seed, cut):
    whole = drawn(name, seed)
    whole["cut_t"] = whole["cut_t"] | cut_at(cut)
    pieces = [{k: v[part] for k, v in whole.items()} for part in (slice(cut + 1), slice(cut + 1, None))]
    split = np.concatenate([cases.rule(name)(**piece) for piece in pieces]) if cut == 2 else None
    expected = np.concatenate([cases.reference(name)(**cases.in_float64(piece)) for piece in pieces])
    result = jitted(name)(whole)
    np.testing.assert_allclose(result, expected, rtol=1e-5, atol=1e-5)
    if split is not None:
        np.testing.assert_allclose(result, split, rtol=1e-6, atol=1e-6)


@EACH
def test_a_cut_in_the_last_step_changes_nothing_and_one_everywhere_leaves_one_step(name):
    for seed in range(3):
        given = drawn(name, seed, cut_t=cut_at(1))
        ended = given | {"cut_t": cut_at(1, STEPS - 1)}
        np.testing.assert_array_equal(jitted(name)(given), jitted(name)(ended))
        without = {key: value for key, value in given.items() if key != "cut_t"}
        uncut = jitted(name)(given | {"cut_t": cut_at()})
        np.testing.assert_allclose(cases.rule(name)(**without), uncut, rtol=1e-5, atol=1e-6)
        all_cut = jitted(name)(given | {"cut_t": cut_at(*range(STEPS))})
        for k in range(STEPS):
            one = {key: value[k : k + 1] for key, value in given.items()}
            np.testing.assert_allclose(all_cut[k : k + 1], cases.reference(name)(**one), rtol=1e-5, atol=1e-5)


@functools.cache
def n_steps(n):
    return jax.jit(functools.partial(rules.n_step_bootstrapped_returns, n=n))


@examples
@given(seed=seeds, length=st.sampled_from([1, 17, 40]), n=st.sampled_from([1, 2, 16, 45]))
def test_n_step_returns_of_any_n_equal_sums_over_lengths(seed, length, n):
    given = cases.arguments("n_step_bootstrapped_returns", np.random.default_rng(seed), np.float32, {"T": length})
    expected = numpy_rules_multi.n_step_bootstrapped_returns(**cases.in_float64(given), n=n)
    np.testing.assert_allclose(n_steps(n)(**given), expected, rtol=1e-5, atol=1e-5)


@examples
@given(seed=seeds)
def test_lambda_0_and_n_1_are_one_step_and_lambda_1_and_n_from_the_length_are_the_discounted_return(seed):
    given = drawn("lambda_returns", seed)
    r_t, discount_t, v_t, cut_t = (given[key] for key in ("r_t", "discount_t", "v_t", "cut_t"))
    one_step = jax.vmap(rules.td_target)(r_t, discount_t, v_t)
    close(rules.lambda_returns(r_t, discount_t, v_t, 0.0, cut_t=cut_t), one_step)
    close(rules.n_step_bootstrapped_returns(r_t, discount_t, v_t, 1, cut_t=cut_t), one_step)
    whole = rules.lambda_returns(r_t, discount_t, v_t)
    for n in (STEPS, STEPS + 5):
        np.testing.assert_allclose(rules.n_step_bootstrapped_returns(r_t, discount_t, v_t, n), whole, rtol=1e-6)
    discounted = v_t[-1].astype(float)
    for k in reversed(range(STEPS)):
        discounted = r_t[k] + discount_t[k] * discounted
        np.testing.assert_allclose(whole[k], discounted, rtol=1e-5, atol=1e-5)


@examples
@given(seed=seeds)
def test_retrace_on_policy_with_lambda_1_is_the_discounted_return(seed):
    given = drawn("retrace", seed, lambda_=np.float32(1.0), mu_t=np.ones(STEPS, np.float32))
    given["pi_t"] = np.eye(3, dtype=np.float32)[given["a_t"]]  # certain to act as it did
    keys = ("q_tm1", "a_tm1", "r_t", "discount_t", "q_t", "a_t", "cut_t")
    sarsa = rules.sarsa_lambda(**{key: given[key] for key in keys}, lambda_=1.0)
    np.testing.assert_allclose(rules.retrace(**given, eps=0.0), sarsa, rtol=1e-5, atol=1e-5)


@examples
@given(seed=seeds)
def test_tree_backup_follows_from_the_policy_as_weight(seed):
    given = drawn("off_policy_returns", seed, cut_t=cut_at(2))
    pi, q, a = given["pi_t"].astype(float), given["q_t"], given["a_t"]
    given["c_t"] = given["pi_t"][np.arange(STEPS), a]
    result, following = jitted("off_policy_returns")(given), None
    for k in reversed(range(STEPS)):  # each action's value, the taken one's replaced by the return that followed it
        row = q[k].astype(float)
        if k not in (2, STEPS - 1):
            row[a[k]] = following
        following = given["r_t"][k] + given["discount_t"][k] * float(pi[k] @ row)
        np.testing.assert_allclose(result[k], following, rtol=1e-5, atol=1e-5)


@examples
@given(seed=seeds)
def test_q_lambda_with_the_lambda_of_watkins_ends_before_an_action_that_is_not_greedy(seed):
    given = drawn("q_lambda", seed)
    a_t = np.random.default_rng(seed).integers(3, size=STEPS)
    lambda_ = rules.watkins_lambda(given["q_t"], a_t, given["lambda_"])
    exploring = given["q_t"][np.arange(STEPS), a_t] < given["q_t"].max(axis=1)
    by_cuts = jitted("q_lambda")(given | {"cut_t": given["cut_t"] | exploring})
    np.testing.assert_allclose(jitted("q_lambda")(given | {"lambda_": lambda_}), by_cuts, rtol=1e-5, atol=1e-5)


@examples
@given(seed=seeds)
def test_multi_step_rules_of_one_step_are_the_rules_of_one_transition(seed):
    g = drawn("sarsa_lambda", seed)
    keys = ("q_tm1", "a_tm1", "r_t", "discount_t", "q_t")
    of_greedy = jax.vmap(rules.q_learning)(*(g[key] for key in keys))
    of_taken = jax.vmap(rules.sarsa)(*(g[key] for key in keys), g["a_t"])
    close(rules.q_lambda(*(g[key] for key in keys), 0.0), of_greedy)
    close(rules.sarsa_lambda(*(g[key] for key in keys), g["a_t"], 0.0), of_taken)
    best = np.argmax(g["q_t"], axis=1)
    n_step = rules.n_step_q_learning(g["q_tm1"], g["a_tm1"], g["q_t"], best, g["r_t"], g["discount_t"], 1)
    close(n_step, of_greedy)
    pi_t = np.full((STEPS, 3), 1 / 3, np.float32)
    expected = jax.vmap(rules.expected_sarsa)(*(g[key] for key in keys), pi_t)
    given = (g["q_tm1"], g["q_t"], g["a_tm1"], g["a_t"], g["r_t"], g["discount_t"], pi_t, np.ones(STEPS, np.float32))
    np.testing.assert_allclose(rules.retrace(*given, 0.0), expected, rtol=1e-5, atol=1e-6)


def test_an_infinite_value_of_another_episode_does_not_count():
    v_t, ones = jnp.array([2.0, 1.0, jnp.inf, 3.0]), jnp.ones(4)
    for returns in (rules.lambda_returns, functools.partial(rules.n_step_bootstrapped_returns, n=2, lambda_t=0.5)):
        result = returns(ones, ones, v_t, cut_t=jnp.array([False, True, True, False]))
        assert np.all(np.isfinite(result[:2]))
        np.testing.assert_array_equal(result[2:], [jnp.inf, 4.0])
