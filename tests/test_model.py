"""The learned model is a dictionary of the last outcomes of each cell, and what it imagines is drawn evenly."""

from __future__ import annotations

from collections import deque

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy import stats

from jaxq.agents import model

STATES, ACTIONS = 4, 2
CELLS = STATES * ACTIONS


def recorded(seed, count, outcomes, cells=CELLS):
    """A model of so many outcomes, and the dictionary of the same, its keys in the order of first visits."""
    rng = np.random.default_rng(seed)
    given = (
        jnp.asarray(rng.integers(cells, size=count), jnp.int32),
        jnp.asarray(rng.normal(size=count), jnp.float32),
        jnp.asarray(rng.random(count) < 0.7, jnp.float32),
        jnp.asarray(rng.integers(STATES, size=count), jnp.int32),
    )
    learn = jax.jit(lambda known, given: jax.lax.scan(lambda m, one: (model.record(m, *one), None), known, given)[0])
    book = {}
    for cell, *outcome in zip(*(leaf.tolist() for leaf in given), strict=True):
        book.setdefault(cell, deque(maxlen=outcomes)).append(tuple(outcome))
    return learn(model.empty(STATES, ACTIONS, outcomes), given), book


def after(outcomes, given):
    """The model after these cells and rewards."""
    known, record = model.empty(STATES, ACTIONS, outcomes), jax.jit(model.record)
    for cell, reward in given:
        known = record(known, jnp.array(cell), reward, 1.0, jnp.array(0))
    return known


def imagined(known, count=20_000, seed=0):
    draw = jax.jit(jax.vmap(lambda key: model.imagine(key, known, ACTIONS)))
    return jax.device_get(draw(jax.random.split(jax.random.key(seed), count)))


@pytest.mark.parametrize("outcomes", [1, 3])
@pytest.mark.parametrize("count", [0, 1, 5, 200])
def test_a_model_is_a_dictionary_of_the_last_outcomes(outcomes, count):
    known, book = recorded(1, count, outcomes)
    assert known.known[: known.num_known].tolist() == list(book)
    tried = np.asarray(known.tried)
    assert sum(tried) == count
    for cell in range(CELLS):
        rows = zip(known.r_t[cell].tolist(), known.continues_t[cell].tolist(), known.s_t[cell].tolist(), strict=True)
        assert sorted(list(rows)[: tried[cell]]) == sorted(book.get(cell, []))
    assert (len(book) == CELLS) == (count == 200)


def test_an_outcome_takes_the_place_of_the_oldest_one():
    known = after(2, [(5, 1.0), (5, 2.0), (5, 3.0)])
    assert sorted(known.r_t[5].tolist()) == [2.0, 3.0]
    assert (known.known[:1].tolist(), int(known.num_known), int(known.tried[5])) == ([5], 1, 3)


@pytest.mark.parametrize("count", [6, 200], ids=["some cells", "all cells"])
def test_what_is_imagined_has_been_seen_and_every_tried_cell_and_outcome_is_equally_likely(count):
    known, book = recorded(2, count, 3)
    made = imagined(known)
    cells = made.s_tm1 * ACTIONS + made.a_tm1
    assert set(cells.tolist()) == set(book)
    assert stats.chisquare([np.sum(cells == cell) for cell in book]).pvalue > 1e-4
    for cell, outcomes in book.items():
        rows = zip(made.r_t.tolist(), made.continues_t.tolist(), made.s_t.tolist(), strict=True)
        drawn = [row for row, at in zip(rows, cells == cell, strict=True) if at]
        assert set(drawn) == set(outcomes)
        if len(outcomes) > 1:
            assert stats.chisquare([drawn.count(outcome) for outcome in outcomes]).pvalue > 1e-5
    assert (len(book) == CELLS) == (count == 200)
    assert any(len(outcomes) > 1 for outcomes in book.values())


def test_an_outcome_that_came_twice_is_twice_as_likely():
    known = after(3, [(3, 1.0), (3, 2.0), (3, 2.0)])
    seen = imagined(known).r_t
    assert stats.binomtest(int(np.sum(seen == 2.0)), len(seen), 2 / 3).pvalue > 1e-4


def test_the_cell_and_its_outcome_are_independent():
    known = after(2, [(cell, reward) for cell in (1, 6) for reward in (0.0, 1.0)])
    made = imagined(known)
    table = [[np.sum((made.s_tm1 == s) & (made.r_t == r)) for r in (0.0, 1.0)] for s in (0, 3)]
    assert stats.chi2_contingency(table).pvalue > 1e-4


def test_a_model_keeps_the_bits_that_JAX_has():
    for x64 in (False, True):
        with jax.enable_x64(x64):
            known = jax.eval_shape(model.record, model.empty(1, 1, 1), jnp.array(0), 0.1, 1.0, jnp.array(0))
            assert known.r_t.dtype == (np.float64 if x64 else np.float32)
            assert (known.tried.dtype, known.known.dtype, known.num_known.dtype) == (np.int32,) * 3
