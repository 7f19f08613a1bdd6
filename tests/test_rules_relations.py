"""Rules are special cases of each other: of one transition, of rescaled values, of tables and target networks."""

from __future__ import annotations

import functools
from collections import Counter
from itertools import combinations

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.stats import chisquare

from jaxq import rules
from jaxq.verify import numpy_rules

seeds = st.integers(0, 2**32 - 1)
examples = settings(max_examples=12, deadline=None, derandomize=True)
close = functools.partial(np.testing.assert_allclose, rtol=1e-5, atol=1e-5)


def transition(seed, actions):
    """(q_tm1, a_tm1, r_t, discount_t), q_t and the target network's q_tm1, with ties now and then."""
    rng = np.random.default_rng(seed)
    q_tm1, q_t, q_target = rng.normal(size=(3, actions)).astype(np.float32)
    if seed % 3 == 0:
        q_t, q_target = np.round(q_t), np.round(q_target)
    r_t, discount_t = np.float32(rng.normal()), np.float32(rng.choice([0.0, 1.0, rng.random()]))
    return (q_tm1, rng.integers(actions), r_t, discount_t), q_t, q_target


@examples
@given(seed=seeds, actions=st.sampled_from([1, 4]))
def test_q_learning_is_the_special_case_of_many_rules(seed, actions):
    given, q_t, q_target = transition(seed, actions)
    plain = rules.q_learning(*given, q_t)
    greedy = int(np.argmax(q_t))
    assert plain == rules.td_error(*given[:2], rules.td_target(*given[2:], rules.greedy_value(q_t)))
    close(plain, rules.sarsa(*given, q_t, greedy))
    close(plain, rules.expected_sarsa(*given, q_t, np.eye(actions, dtype=np.float32)[greedy]))
    close(plain, rules.double_q_learning(*given, q_t, q_t))
    close(plain, rules.persistent_q_learning(*given, q_t, 0.0))
    close(plain, rules.advantage_learning(*given, q_t, q_target, 0.0))
    close(plain, rules.persistent_advantage_learning(*given, q_t, q_target, 0.0))
    close(plain, rules.maxmin_q_learning(*given, q_t[None]))
    close(plain, rules.averaged_q_learning(*given, q_t[None]))
    for temperature, distance in [(1e-2, 2e-2), (1e-6, 1e-5), (1e-30, 1e-5), (1e-37, 1e-5)]:
        soft = rules.soft_q_learning(*given, q_t, temperature)
        assert soft - plain + 1e-6 >= 0
        np.testing.assert_allclose(soft, plain, atol=distance)
    soft = rules.soft_q_learning(*given, q_t, 0.7)
    close(soft, rules.munchausen_q_learning(*given, q_t, q_target, 0.7, 0.0))
    close(soft, rules.munchausen_q_learning(*given, q_t, q_target, 0.7, 0.9, 0.0))  # clipped to nothing


@examples
@given(seed=seeds, actions=st.sampled_from([1, 4]))
def test_rules_are_ordered_as_their_operators_are(seed, actions):
    given, q_t, q_target = transition(seed, actions)
    plain = rules.q_learning(*given, q_t) + 1e-5
    both = rules.persistent_advantage_learning(*given, q_t, q_target, 0.4)
    assert rules.advantage_learning(*given, q_t, q_target, 0.4) <= both <= plain
    assert rules.persistent_q_learning(*given, q_t, 1.0) <= both + 1e-5
    assert rules.munchausen_q_learning(*given, q_t, q_target) <= rules.soft_q_learning(*given, q_t, 0.03) + 1e-5
    assert rules.double_q_learning(*given, q_t, q_target) <= plain
    ensemble = np.stack([q_t, q_target])
    assert rules.maxmin_q_learning(*given, ensemble) <= rules.averaged_q_learning(*given, ensemble) + 1e-5


@pytest.mark.parametrize("q_t", [[3e38, -3e38], [1e30, 1e30], [-1e30, -1e30], [0.0, -np.inf]])
def test_the_soft_value_overflows_at_no_temperature(q_t):
    value, gradient = jax.value_and_grad(rules.soft_value)(jnp.array(q_t), 1e-9)
    np.testing.assert_allclose(value, max(q_t), rtol=1e-6, atol=1e-8)
    np.testing.assert_allclose(gradient, np.array(q_t) == max(q_t) if q_t[0] != q_t[1] else [0.5, 0.5])


def test_every_subset_of_an_ensemble_is_drawn_equally_often():
    q_t = jnp.arange(4.0)[:, None]
    for size in (1, 2, 3):
        keys = jax.random.split(jax.random.key(size), 3000)
        drawn = jax.jit(jax.vmap(functools.partial(rules.random_subset, size=size), (0, None)))(keys, q_t)
        assert drawn.shape == (3000, size, 1)
        counts = Counter(tuple(sorted(row)) for row in np.asarray(drawn[:, :, 0], int).tolist())
        assert set(counts) == set(combinations(range(4), size))
        assert chisquare(list(counts.values())).pvalue > 1e-3
    everyone = rules.random_subset(jax.random.key(9), q_t, 4)
    np.testing.assert_array_equal(jnp.sort(everyone, axis=0), q_t)
    assert rules.maxmin(everyone) == rules.maxmin(q_t)


# Rescaling

X = np.concatenate([s * np.geomspace(1e-6, 1e6, 97) for s in (1, -1)] + [[0.0]]).astype(np.float32)


@pytest.mark.parametrize("eps", [0.0, 1e-3, 1e-2, 1.0])
def test_rescaling_inverts_itself_to_a_few_last_digits_of_float32(eps):
    there = jax.jit(rules.signed_hyperbolic)(X, eps)
    ulps = 8 * np.finfo(np.float32).eps
    np.testing.assert_allclose(rules.signed_parabolic(there, eps), X, rtol=ulps, atol=0)
    np.testing.assert_allclose(rules.signed_hyperbolic(rules.signed_parabolic(X, eps), eps), X, rtol=ulps, atol=0)
    np.testing.assert_allclose(there, exact_h(X, eps), rtol=ulps, atol=1e-13)
    assert np.all(np.diff(np.asarray(there)[np.argsort(X)]) > 0)
    slope = jax.vmap(jax.grad(rules.signed_hyperbolic), (0, None))(jnp.asarray(X), eps)
    np.testing.assert_allclose(slope, 0.5 / np.sqrt(np.abs(X) + 1.0) + eps, rtol=1e-5)


def exact_h(x, eps):
    return np.sign(x) * (np.sqrt(np.abs(x.astype(np.longdouble)) + 1) - 1) + eps * x.astype(np.longdouble)


def test_the_identity_pair_changes_nothing():
    rng = np.random.default_rng(0)
    r_t, discount_t, v_t = rng.random((3, 5)).astype(np.float32)
    q_t, pi_t, a_t = *rng.random((2, 5, 2)).astype(np.float32), rng.integers(2, size=5)
    cut = {"cut_t": np.array([0, 1, 0, 0, 0], bool)}
    pair, same = rules.IDENTITY_PAIR, np.testing.assert_array_equal
    given = (r_t, discount_t, v_t)
    same(rules.transformed_lambda_returns(pair, *given, 0.5, **cut), rules.lambda_returns(*given, 0.5, **cut))
    same(
        rules.transformed_n_step_returns(pair, *given, 2, 0.5, **cut),
        rules.n_step_bootstrapped_returns(*given, 2, 0.5, **cut),
    )
    given = (q_t, a_t, r_t, discount_t, 0.5, pi_t)
    same(rules.transformed_off_policy_returns(pair, *given, **cut), rules.off_policy_returns(*given, **cut))
    given = (q_t, a_t, r_t, discount_t, q_t, 0.5)
    same(rules.q_lambda(*given, **cut), rules.q_lambda(*given, **cut, tx_pair=pair))


# Tables and target networks


@examples
@given(seed=seeds, cells=st.sampled_from([(1, 1), (4, 3), (300, 2)]))
def test_traces_are_special_cases_of_the_dutch_trace(seed, cells):
    rng = np.random.default_rng(seed)
    trace, decay = rng.random(cells).astype(np.float32), np.float32(rng.random())
    state, action = rng.integers(cells[0]), rng.integers(cells[1])
    visited = np.zeros(cells, np.float32)
    visited[state, action] = 1
    same = np.testing.assert_array_equal
    same(rules.dutch_trace(trace, state, action, decay, 0.0), rules.accumulating_trace(trace, state, action, decay))
    same(rules.dutch_trace(trace, state, action, decay, 1.0), rules.replacing_trace(trace, state, action, decay))
    same(rules.replacing_trace(trace, state, action, 0.0), visited)
    same(rules.accumulating_trace(trace, state, action, 0.0), visited)
    same(rules.update_table(trace, state, action, 0.5) - trace > 0, visited > 0)
    loud = np.where(visited > 0, np.float32(1), np.float32(np.nan))
    assert rules.update_table(loud, state, action, 0.5)[state, action] == 1.5


def test_a_trace_over_an_episode_equals_a_loop():
    rng = np.random.default_rng(0)
    for name in ("accumulating_trace", "replacing_trace", "dutch_trace"):
        more = (0.3,) if name == "dutch_trace" else ()
        trace, expected = jnp.zeros((3, 2)), np.zeros((3, 2))
        for _ in range(20):
            visit = (rng.integers(3), rng.integers(2), rng.choice([0.0, 0.9]), *more)
            trace, expected = getattr(rules, name)(trace, *visit), getattr(numpy_rules, name)(expected, *visit)
        close(trace, expected)


def test_a_table_of_integers_stays_one():
    table = rules.update_table(jnp.zeros((2, 2), jnp.int32), 1, 1, 1)
    assert table.dtype == jnp.int32
    assert table.tolist() == [[0, 0], [0, 1]]


@pytest.mark.parametrize("dtype", [jnp.float16, jnp.bfloat16, jnp.float32])
def test_a_target_keeps_its_dtypes_and_tau_0_and_1_are_no_step_and_a_whole_one(dtype):
    rng = np.random.default_rng(0)
    online = {"w": jnp.asarray(rng.normal(size=(3, 2))), "b": [jnp.ones(2)]}
    target = jax.tree.map(lambda leaf: jnp.asarray(rng.normal(size=leaf.shape), dtype), online)
    jax.tree.map(np.testing.assert_array_equal, rules.polyak_update(online, target, 0.0), target)
    whole = rules.polyak_update(online, target, 1.0)
    jax.tree.map(lambda new, old: np.testing.assert_array_equal(new, old.astype(dtype)), whole, online)
    assert all(leaf.dtype == dtype for leaf in jax.tree.leaves(rules.polyak_update(online, target, jnp.array(0.3))))


def test_targets_under_vmap_move_each_at_its_own_period():
    periods, updates = jnp.array([1, 2, 3, 7]), jnp.arange(12)
    step = jax.vmap(jax.vmap(rules.periodic_update, (None, None, None, 0)), (0, 0, 0, None))
    moved = step(updates + 100.0, -updates.astype(float), updates, periods)
    expected = [[u + 100 if u % p == 0 else -u for p in (1, 2, 3, 7)] for u in range(12)]
    np.testing.assert_array_equal(moved, expected)
    taus = jax.vmap(rules.periodic_step, (0, None, None))(updates, 3, 0.25)
    np.testing.assert_array_equal(taus, np.where(np.arange(12) % 3 == 0, 0.25, 0.0))
