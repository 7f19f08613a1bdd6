"""Success rules: the mean of the last returns beside a loop in plain Python, and the rule that is never met."""

from functools import cache

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from jaxq import success

STEPS = 24
WINDOWS = (1, 2, 3, 7)


def mean_of_last(over, total, window, threshold):
    """Whether the rule is met at each step, with exact arithmetic."""
    returns, met = [], []
    for ended, value in zip(over, total, strict=True):
        returns += [value] if ended else []
        full = len(returns) >= window
        met.append(full and sum(returns[-window:]) >= threshold * window)
    return met


@cache
def followed(window):
    """The rule over STEPS steps, compiled once per window. Shapes: over, total [STEPS], threshold [] -> [STEPS]."""

    def run(over, total, threshold):
        rule = success.mean_return(window, threshold)
        junk = jnp.int32(10**6)  # lengths and limits play no part
        return jax.lax.scan(
            lambda state, step: rule.update(state, step[0], junk, step[1], None), rule.init(), (over, total)
        )

    return jax.jit(run)


QUARTERS = st.integers(-12, 12).map(lambda number: number / 4)  # sums of these are exact in float32


@given(
    st.lists(st.tuples(st.booleans(), QUARTERS), min_size=STEPS, max_size=STEPS),
    st.sampled_from(WINDOWS),
    QUARTERS,
)
@settings(deadline=None, max_examples=300)
def test_the_mean_of_the_last_returns_is_that_of_a_loop(steps, window, threshold):
    over, total = (np.array(column) for column in zip(*steps, strict=True))
    state, met = followed(window)(over, total.astype(np.float32), np.float32(threshold))
    assert met.tolist() == mean_of_last(over, total, window, threshold)
    assert int(state.episodes) == min(window, int(over.sum()))


def test_gymnasiums_rule_is_met_at_the_threshold_itself_and_by_no_less():
    rule = success.mean_return(100, 475.0)
    update = jax.jit(lambda state, total: rule.update(state, jnp.array(True), jnp.int32(0), total, None))
    for last, wanted in ((500.0, True), (499.0, False)):
        state = rule.init()
        for total in [450.0] * 50 + [500.0] * 49:
            state, met = update(state, total)
            assert not met
        assert bool(update(state, last)[1]) is wanted


def test_a_full_window_is_needed_even_for_a_threshold_below_zero():
    rule = success.mean_return(3, -10.0)
    state, met = rule.init(), []
    for total in (-1.0, 5.0, -2.0):
        state, now = rule.update(state, jnp.array(True), jnp.int32(1), jnp.float32(total), None)
        met.append(bool(now))
    assert met == [False, False, True]  # zeros that no episode has earned would have met it at once


def test_nothing_changes_while_an_episode_goes_on():
    rule = success.mean_return(2, 1.0)
    state, _ = rule.update(rule.init(), jnp.array(True), jnp.int32(1), jnp.float32(4.0), None)
    after, met = rule.update(state, jnp.array(False), jnp.int32(1), jnp.float32(99.0), None)
    jax.tree.map(np.testing.assert_array_equal, after, state)
    assert not met


def test_lanes_side_by_side_are_judged_each_by_itself():
    rng = np.random.default_rng(0)
    over, total = rng.random((5, STEPS)) < 0.5, rng.integers(-4, 5, (5, STEPS)).astype(np.float32)
    _, met = jax.vmap(followed(2), in_axes=(0, 0, None))(over, total, 0.5)
    for lane in range(5):
        assert met[lane].tolist() == mean_of_last(over[lane], total[lane], 2, 0.5)
    assert met.any()


@pytest.mark.parametrize("rule", [success.window_mean, lambda window: success.mean_return(window, 475.0)])
def test_a_window_of_nothing_is_refused(rule):
    with pytest.raises(ValueError, match="window: 0 must be at least 1"):
        rule(0)
    assert rule(1)


def test_never_is_never():
    rule = success.never()
    state, met = rule.update(rule.init(), jnp.array(True), jnp.int32(500), jnp.float32(1e9), None)
    assert (state, bool(met)) == ((), False)
