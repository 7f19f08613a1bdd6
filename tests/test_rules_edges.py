"""Numbers at the edge: masked actions, infinities, what is no number, short dtypes, whole numbers, padding."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxq import rules

MASKED = jnp.array([-jnp.inf, 1.0, 2.0])  # the first action is not allowed
NONE = jnp.full(3, -jnp.inf)  # none is, as often behind a termination
PROBS = jnp.array([0.0, 0.5, 0.5])
Q = jnp.zeros(3)

#: Rules of one transition with their arguments behind q_tm1 and a_tm1, for a row of the successor.
ONE_STEP = {
    "q_learning": lambda q_t: (q_t,),
    "double_q_learning": lambda q_t: (q_t, q_t),
    "sarsa": lambda q_t: (q_t, 2),
    "expected_sarsa": lambda q_t: (q_t, PROBS),
    "soft_q_learning": lambda q_t: (q_t, 0.5),
    "munchausen_q_learning": lambda q_t: (q_t, MASKED),
    "advantage_learning": lambda q_t: (q_t, MASKED, 0.5),
    "persistent_q_learning": lambda q_t: (q_t, 0.5),
    "persistent_advantage_learning": lambda q_t: (q_t, MASKED, 0.5),
    "averaged_q_learning": lambda q_t: (jnp.stack([q_t, q_t]),),
    "maxmin_q_learning": lambda q_t: (jnp.stack([q_t, q_t]),),
}


@pytest.mark.parametrize("name", ONE_STEP)
def test_an_action_that_is_masked_is_as_one_that_is_not_there(name):
    rule, q_tm1, arguments = getattr(rules, name), jnp.array([-jnp.inf, 0.5, 1.0]), ONE_STEP[name]

    def without(value):
        value = jnp.asarray(value)
        return value - 1 if value.dtype == jnp.int32 else value[..., 1:] if value.ndim else value

    masked = rule(q_tm1, 1, 1.0, 0.9, *arguments(MASKED))
    assert jnp.isfinite(masked)
    few = rule(q_tm1[1:], 0, 1.0, 0.9, *(without(given) for given in arguments(MASKED)))
    np.testing.assert_allclose(masked, few, rtol=1e-6)
    slopes = jax.grad(lambda q_tm1: rule(q_tm1, 1, 1.0, 0.9, *arguments(MASKED)))(q_tm1)
    np.testing.assert_array_equal(slopes, [0.0, -1.0, 0.0])


@pytest.mark.parametrize("name", ONE_STEP)
def test_behind_a_termination_nothing_is_read_be_it_all_masked(name):
    rule, arguments = getattr(rules, name), ONE_STEP[name]
    end = rule(Q, 1, 1.0, 0.0, *arguments(NONE))
    assert end == rule(Q, 1, 1.0, 0.0, *arguments(jnp.zeros(3)))
    assert not jnp.isfinite(rule(Q, 1, 1.0, 0.9, *arguments(NONE)))
    assert jnp.isnan(rule(Q, 1, 1.0, 0.0, *arguments(jnp.full(3, jnp.nan))))  # what has diverged is not hidden


@pytest.mark.parametrize("tx_pair", [rules.IDENTITY_PAIR, rules.SIGNED_HYPERBOLIC_PAIR])
def test_trajectories_take_masked_actions_as_well(tx_pair):
    q_tm1, q_t = jnp.zeros((2, 3)), jnp.stack([MASKED, NONE])
    a_tm1, a_t, r_t, discount_t = jnp.array([1, 2]), jnp.array([2, 1]), jnp.ones(2), jnp.array([0.9, 0.0])
    pi_t, mu_t = jnp.stack([PROBS, PROBS]), jnp.full(2, 0.5)
    few = jnp.stack([MASKED, jnp.zeros(3)])[:, 1:]

    def same(masked, unmasked):
        assert jnp.all(jnp.isfinite(masked))
        np.testing.assert_allclose(masked, unmasked, rtol=1e-6)

    for lambda_ in (0.0, 0.5, 1.0):
        how = {"lambda_": lambda_, "tx_pair": tx_pair}
        same(
            rules.q_lambda(q_tm1, a_tm1, r_t, discount_t, q_t, **how),
            rules.q_lambda(q_tm1[:, 1:], a_tm1 - 1, r_t, discount_t, few, **how),
        )
        same(
            rules.retrace(q_tm1, q_t, a_tm1, a_t, r_t, discount_t, pi_t, mu_t, **how),
            rules.retrace(q_tm1[:, 1:], few, a_tm1 - 1, a_t - 1, r_t, discount_t, pi_t[:, 1:], mu_t, **how),
        )
    for n in (1, 2):
        same(
            rules.n_step_q_learning(q_tm1, a_tm1, q_t, a_t, r_t, discount_t, n, tx_pair=tx_pair),
            rules.n_step_q_learning(q_tm1[:, 1:], a_tm1 - 1, few, a_t - 1, r_t, discount_t, n, tx_pair=tx_pair),
        )


def test_a_weight_of_0_reads_nothing_of_what_is_infinite():
    r_t, discount_t, v_t = jnp.ones(2), jnp.ones(2), jnp.array([1.0, jnp.inf])
    np.testing.assert_array_equal(rules.n_step_bootstrapped_returns(r_t, discount_t, v_t, 1), [2.0, jnp.inf])
    np.testing.assert_array_equal(rules.off_policy_returns(v_t[None], [0], [1.0], [0.0], 1.0, PROBS[None, 1:]), [1.0])
    np.testing.assert_array_equal(rules.lambda_returns(r_t, discount_t, v_t[::-1], 1.0), [3.0, 2.0])


def test_soft_values_of_masked_actions_have_the_temperature_s_own_gradient():
    given, without = (jax.grad(rules.soft_value, argnums=(0, 1))(q_t, 0.5) for q_t in (MASKED, MASKED[1:]))
    np.testing.assert_allclose(given[0], jnp.concatenate([jnp.zeros(1), without[0]]), rtol=1e-6)
    np.testing.assert_allclose(given[1], without[1], rtol=1e-6)
    assert rules.soft_value(NONE, 0.5) == -jnp.inf


def test_squashing_takes_infinities_and_whole_numbers():
    edges = jnp.array([-jnp.inf, jnp.inf])
    for squash in (rules.signed_hyperbolic, rules.signed_parabolic):
        np.testing.assert_array_equal(squash(edges), edges)
        assert jnp.isnan(squash(jnp.nan))
        assert jnp.all(jnp.isfinite(jax.vmap(jax.grad(squash))(edges)))
        assert squash(jnp.int8(127)) == squash(127.0)
        assert squash(jnp.bfloat16(3)).dtype == jnp.bfloat16


@pytest.mark.parametrize(
    "share", [rules.polyak_update, lambda new, old, tau: rules.periodic_update(new, old, 1 - tau, 2)]
)
def test_a_share_of_nothing_or_of_all_takes_nothing_of_the_other(share):
    new, old = jnp.array([1.0, jnp.nan, jnp.inf, 2.0]), jnp.array([jnp.nan, 3.0, 4.0, jnp.inf])
    np.testing.assert_array_equal(share(new, old, 0), old)
    np.testing.assert_array_equal(share(new, old, 1), new)


def test_counters_and_keys_are_copied():
    many, few = jnp.array([2**24 + 1, 2**31 - 1]), jnp.array([2**24 + 3, 5])
    key, other = jax.random.key(12345678901), jax.random.key(1)
    online = {"count": many, "words": jax.random.key_data(key), "key": key, "on": jnp.array(True)}
    target = {"count": few, "words": jax.random.key_data(other), "key": other, "on": jnp.array(False)}
    with jax.debug_key_reuse(False):  # which takes a copy of a key for its use
        for tau, expected in [(0.0, target), (0.01, online), (1.0, online)]:
            made = rules.polyak_update(online, target, tau)
            assert jax.tree.all(jax.tree.map(lambda a, b: a.dtype == b.dtype and jnp.all(a == b), made, expected))


@pytest.mark.parametrize("other", [{"w": {"a": 0.0}}, {"w": None}, {"w": [1.0, 2.0]}, (0.0,), {"w": 0.0, "b": 0.0}])
def test_trees_of_other_forms_are_an_error_of_one_line(other):
    for update in (
        lambda: rules.polyak_update({"w": 0.0}, other, 0.5),
        lambda: rules.periodic_update({"w": 0.0}, other, 1, 2),
    ):
        with pytest.raises(ValueError, match=r"^target: PyTreeDef.* is not allowed: PyTreeDef.* as online$"):
            update()


def test_float16_holds_the_loss_of_many_quantiles():
    dist = jnp.full(200, 400.0, jnp.float16)
    loss = rules.quantile_regression_loss(jnp.zeros(1, jnp.float16), jnp.full(1, 0.1, jnp.float16), dist)
    np.testing.assert_allclose(loss, 40.0, rtol=2e-3)


def test_a_step_of_no_probability_has_no_weight_in_float16():
    """The usual eps is 0 there."""
    pi_t, mu_t = jnp.array([[0.0, 1.0]], jnp.float16), jnp.zeros(1, jnp.float16)
    assert rules.retrace_weights(jnp.array([0]), pi_t, mu_t, 1.0) == 0
    assert rules.retrace_weights(jnp.array([1]), pi_t, mu_t, 1.0) == 1


def test_an_action_that_is_padding_is_not_greedy():
    assert rules.watkins_lambda([[-1.0, 0.0]], [-1], 0.5).tolist() == [0.0]
    assert rules.watkins_lambda([[-1.0, 0.0]], [1], 0.5).tolist() == [0.5]


def test_whole_numbers_make_floating_point_errors():
    for q_tm1, r_t, q_t in [([1, 2], 100, [100, 2]), (np.int8([1, 2]), np.int8(100), np.int8([100, 2]))]:
        error = rules.q_learning(q_tm1, 0, r_t, 1, q_t)
        assert (error, error.dtype) == (199, jnp.float32)
    narrow = rules.q_learning(jnp.ones(2, jnp.bfloat16), 0, 1, 1, jnp.ones(2, jnp.bfloat16))
    assert (narrow, narrow.dtype) == (1, jnp.bfloat16)
