"""What is not one transition is an error of one line: the argument, its shape or dtype, and what is allowed."""

from __future__ import annotations

import functools

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxq import rules
from jaxq.verify import rule_cases as cases

#: Elementwise, or any trees of arrays.
ANY_SHAPE = ("signed_hyperbolic", "signed_parabolic", "polyak_update", "periodic_update")
ARGUMENTS = [(name, argument) for name in cases.NAMES for argument, _ in cases.RULES[name] if name not in ANY_SHAPE]
INDICES = [(name, argument) for name, argument in ARGUMENTS if argument in ("a_tm1", "a_t", "state", "action")]


def given(name):
    return cases.arguments(name, np.random.default_rng(0), np.float32, cases.LENGTHS[0])


@pytest.mark.parametrize(("name", "argument"), ARGUMENTS)
def test_a_batch_without_vmap_is_an_error_that_names_the_argument(name, argument):
    arguments = given(name)
    per_step = argument in ("lambda_", "lambda_t", "c_t")
    arguments[argument] = np.stack([arguments[argument]] * 2)
    with pytest.raises(ValueError, match=rf"^{argument}: shape \(2,.*\) is not allowed: \[.*\]; .* jax.vmap") as error:
        cases.rule(name)(**arguments)
    assert "\n" not in str(error.value)
    if per_step:  # one number for all steps is allowed
        arguments[argument] = np.float32(0.5)
        assert cases.rule(name)(**arguments).shape == (6,)


@pytest.mark.parametrize(("name", "argument"), ARGUMENTS)
def test_a_length_unlike_that_of_the_other_arguments_is_an_error(name, argument):
    letters = dict(cases.RULES[name])[argument]
    for axis, letter in enumerate(letters):
        if sum(letter in other for other in dict(cases.RULES[name]).values()) == 1:
            continue
        arguments = given(name)
        arguments[argument] = np.concatenate([arguments[argument]] * 2, axis)
        message = rf"^({'|'.join(arguments)}): shape \(.*\) is not allowed: .*, [A-Z] = \d+ as in "
        with pytest.raises(ValueError, match=message) as error:
            cases.rule(name)(**arguments)
        assert argument in str(error.value)


@pytest.mark.parametrize(("name", "argument"), INDICES)
def test_an_action_or_state_that_is_no_integer_is_a_type_error(name, argument):
    for wrong in (np.float32, bool):
        arguments = given(name)
        arguments[argument] = arguments[argument].astype(wrong)
        with pytest.raises(TypeError, match=f"^{argument}: dtype {np.dtype(wrong)} is not allowed: an integer$"):
            cases.rule(name)(**arguments)


@pytest.mark.parametrize("dtype", [np.int8, np.uint8, np.int16, np.uint32])
def test_any_integer_dtype_is_an_action(dtype):
    assert rules.action_value(jnp.array([1.0, 5.0]), np.asarray(1, dtype)) == 5.0
    assert rules.update_table(jnp.zeros((2, 2)), np.asarray(1, dtype), np.asarray(0, dtype), 1.0)[1, 0] == 1.0
    assert rules.replacing_trace(jnp.zeros((2, 2)), np.asarray(1, dtype), np.asarray(0, dtype), 1.0)[1, 0] == 1.0


@pytest.mark.parametrize("n", [0, -1, 1.0, 2.5, True, "2", None])
def test_n_that_is_no_whole_number_from_1_is_an_error(n):
    one = jnp.ones(1)
    for transformed in (False, True):
        returns = functools.partial(rules.transformed_n_step_returns, rules.IDENTITY_PAIR)
        returns = returns if transformed else rules.n_step_bootstrapped_returns
        with pytest.raises(ValueError, match=f"^n: {n!r} is not allowed: a whole number from 1$"):
            returns(one, one, one, n)
    row, action = jnp.ones((1, 2)), jnp.zeros(1, int)
    with pytest.raises(ValueError, match=r"^n: "):
        rules.n_step_q_learning(row, action, row, action, one, one, n)


def test_n_may_be_a_numpy_integer_and_longer_than_the_trajectory():
    steps = jnp.arange(3.0)
    for n in (np.int64(3), 10**9):
        np.testing.assert_array_equal(
            rules.n_step_bootstrapped_returns(steps, steps, steps, n),
            rules.n_step_bootstrapped_returns(steps, steps, steps, 3),
        )


@pytest.mark.parametrize("size", [0, -1, 4])
def test_a_subset_of_no_members_or_of_more_than_there_are_is_an_error(size):
    with pytest.raises(ValueError, match=f"^size: {size} is not allowed: a whole number from 1 to 3$"):
        rules.random_subset(jax.random.key(0), jnp.ones((3, 2)), size)
    with pytest.raises(ValueError, match=r"^q_t: shape \(3,\) is not allowed: \[K, A\]"):
        rules.random_subset(jax.random.key(1), jnp.ones(3), 1)


@pytest.mark.parametrize("count", [0, -3])
def test_no_quantiles_are_an_error(count):
    with pytest.raises(ValueError, match=f"^count: {count} is not allowed: a whole number from 1$"):
        rules.quantile_midpoints(count)


def test_a_whole_number_that_is_traced_is_an_error_that_names_static_argnames():
    ones = jnp.ones(3)
    with pytest.raises(ValueError, match=r"^n: a traced value .* static_argnames"):
        jax.jit(rules.n_step_bootstrapped_returns)(ones, ones, ones, 2)
    with pytest.raises(ValueError, match=r"^count: a traced value .* static_argnames"):
        jax.jit(rules.quantile_midpoints)(3)
    with pytest.raises(ValueError, match=r"^size: a traced value .* static_argnames"):
        jax.jit(rules.random_subset)(jax.random.key(0), jnp.ones((3, 2)), 2)
    compiled = jax.jit(rules.n_step_bootstrapped_returns, static_argnames="n")
    np.testing.assert_array_equal(compiled(ones, ones, ones, n=2), [3, 3, 2])


def test_leaves_of_other_shapes_are_an_error_that_names_the_leaf():
    online, target = {"w": jnp.ones(3)}, {"w": jnp.ones(1)}
    for update in (
        lambda: rules.polyak_update(online, target, 0.5),
        lambda: rules.periodic_update(online, target, 0, 1),
    ):
        with pytest.raises(ValueError, match=r"^target\['w'\]: shape \(1,\) is not allowed: \(3,\) as in online$"):
            update()


def test_trees_that_differ_are_an_error():
    online, target = {"w": jnp.ones(2)}, {"b": jnp.ones(2)}
    for update in (
        lambda: rules.polyak_update(online, target, 0.5),
        lambda: rules.periodic_update(online, target, 0, 1),
    ):
        with pytest.raises(ValueError, match=r"'b'"):
            update()
    with pytest.raises(ValueError, match=r"^tau: shape \(2,\) is not allowed"):
        rules.polyak_update(online, online, jnp.ones(2))


@pytest.mark.parametrize("given", ["x", None, [[1.0], [2.0, 3.0]], {"q": 1.0}])
def test_what_is_no_array_is_named(given):
    with pytest.raises(TypeError, match=r"^q_tm1: .* is not allowed: numbers, \[A\]$"):
        rules.q_learning(given, 0, 1.0, 0.9, [1.0, 2.0])
    with pytest.raises(TypeError, match=r"^lambda_: .* is not allowed: numbers, \[T?\]$"):
        rules.lambda_returns([1.0], [0.9], [1.0], given)


@pytest.mark.parametrize("action", [-1, 2, 1000])
def test_an_action_out_of_range_is_no_action_where_rlax_would_take_the_nearest(action):
    action, row = jnp.array(action), jnp.array([3.0, 5.0])
    assert rules.action_value(row, action) == 0.0
    assert rules.td_error(row, action, 7.0) == 7.0
    np.testing.assert_array_equal(jax.grad(rules.td_error)(row, action, 7.0), [0.0, 0.0])
    logits = jnp.array([[3.0, 5.0], [1.0, 0.0]])  # the distribution of logits 0: each atom as likely as another
    np.testing.assert_allclose(rules.categorical_error(logits, action, jnp.array([1.0, 0.0])), np.log(2), rtol=1e-6)
    loss = rules.quantile_error(logits, jnp.full(2, 0.5), action, jnp.array([4.0]))
    assert loss == rules.quantile_regression_loss(jnp.zeros(2), jnp.full(2, 0.5), jnp.array([4.0]))


@pytest.mark.parametrize("cells", [(3, 2), (600, 2)], ids=["dense", "scattered"])
@pytest.mark.parametrize(("state", "action"), [(-1, 0), (-1, 1), (1, -1), (1, 2), (0, 3), (10**6, 0), (2**31 - 1, 1)])
def test_a_cell_outside_a_table_changes_nothing(cells, state, action):
    table = jnp.arange(1.0, 1 + np.prod(cells)).reshape(cells)
    np.testing.assert_array_equal(rules.update_table(table, state, action, 9.0), table)
    for trace in (rules.accumulating_trace, rules.replacing_trace):
        np.testing.assert_array_equal(trace(table, state, action, 0.5), 0.5 * table)


@pytest.mark.parametrize("x64", [False, True])
@pytest.mark.parametrize("rows", [3, 600], ids=["dense", "scattered"])
@pytest.mark.parametrize("dtype", ["int8", "uint8", "int32", "bfloat16", "float16", "float32"])
def test_a_table_keeps_its_dtype_and_a_scan_can_carry_it(dtype, rows, x64):
    with jax.enable_x64(x64):
        table, one = jnp.zeros((rows, 2), dtype), jnp.ones((), dtype)

        def visit(table, state):
            return rules.update_table(table, state, 1, one), None

        counted = jax.lax.scan(visit, table, jnp.array([2, 0, 2]))[0]
        assert counted.dtype == dtype
        assert (counted[0, 1], counted[2, 1], jnp.sum(counted)) == (1, 2, 3)
        if jnp.issubdtype(dtype, jnp.floating):
            decay, alpha = jnp.array(0.5), jnp.array(0.25)
            for made in (
                rules.update_table(table, 1, 1, decay),
                rules.accumulating_trace(table, 1, 1, decay),
                rules.replacing_trace(table, 1, 1, decay),
                rules.dutch_trace(table, 1, 1, decay, alpha),
            ):
                assert made.dtype == dtype


def test_a_table_of_whole_numbers_takes_no_fractions_and_is_no_trace():
    counts = jnp.zeros((2, 2), int)
    with pytest.raises(TypeError, match="amount: dtype float32 is not allowed: an integer, as the table's"):
        rules.update_table(counts, 0, 0, 0.5)
    with pytest.raises(TypeError, match="trace: dtype int32 is not allowed: a floating-point one"):
        rules.accumulating_trace(counts, 0, 0, 0.5)


@pytest.mark.parametrize("dtype", ["int8", "uint8", "int16", "uint16", "int32", "uint32"])
def test_indices_of_few_bits_reach_every_cell(dtype):
    row, table = jnp.arange(1.0, 301.0), jnp.zeros((300, 300))
    for index in (5, 100, 127, 200, 255, 299):
        if index <= jnp.iinfo(dtype).max:
            at = jnp.array(index, dtype)
            assert rules.action_value(row, at) == index + 1
            assert jax.vmap(rules.action_value)(row[None], at[None]) == index + 1
            for made in (rules.update_table(table, at, at, 1.0), rules.accumulating_trace(table, at, at, 0.5)):
                assert made[index, index] == jnp.sum(made) == 1
            narrow = rules.replacing_trace(table[:1], 0, at, 0.5)
            assert narrow[0, index] == jnp.sum(narrow) == 1
