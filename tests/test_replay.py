"""Replay: the ring against a deque, and the draws against counting and against Floyd's algorithm in Python."""

import collections
import functools
import itertools

import hypothesis
import hypothesis.strategies as st
import jax
import jax.numpy as jnp
import numpy as np
import pytest
import scipy.stats

from jaxq import replay
from jaxq.types import Transition

EXAMPLE = Transition(
    obs_tm1=jnp.zeros(2),
    a_tm1=jnp.int32(0),
    r_t=jnp.float32(0),
    continues_t=jnp.float32(0),
    obs_t=jnp.zeros(2),
    cut_t=jnp.bool_(False),
)


def transitions(numbers):
    """Transitions that carry their number (1, 2, ...) in every field, so that a row mixed from two would show."""
    x = np.asarray(numbers)
    pair = np.stack([x, -x], axis=-1).astype(np.float32)
    row = (pair, x.astype(np.int32), x.astype(np.float32), (x % 2).astype(np.float32), pair + np.float32(0.5))
    return Transition(*row, x % 3 == 0)


def assert_rows_are_whole(batch):
    expected = transitions(batch.a_tm1)
    jax.tree.map(np.testing.assert_array_equal, batch, expected)


@functools.cache
def compiled(capacity, batch_size, replacement=False):
    """A replay whose functions are compiled, once for each number of transitions."""
    buffer = replay.uniform(capacity, batch_size, replacement=replacement)
    return replay.ReplayBuffer(buffer.init, jax.jit(buffer.add), jax.jit(buffer.sample))


def filled(capacity, batch_size, count, replacement=False):
    buffer = compiled(capacity, batch_size, replacement)
    state = buffer.init(EXAMPLE)
    for start in range(0, count, capacity):
        state = buffer.add(state, transitions(np.arange(start, min(start + capacity, count)) + 1))
    return buffer, state


@hypothesis.settings(max_examples=30, deadline=None)
@hypothesis.given(
    capacity=st.sampled_from([1, 5, 6]), counts=st.lists(st.sampled_from([1, 4, 5]), min_size=1, max_size=8)
)
def test_ring_equals_a_deque(capacity, counts):
    counts = [min(count, capacity) for count in counts]
    buffer = compiled(capacity, 1)
    state, reference, number = buffer.init(EXAMPLE), collections.deque(maxlen=capacity), 1
    for count in counts:
        rows = np.arange(number, number + count)
        state, number = buffer.add(state, transitions(rows)), number + count
        reference.extend(rows)
        assert int(state.size) == len(reference)
    oldest = (int(state.position) - len(reference)) % capacity
    order = (oldest + np.arange(len(reference))) % capacity
    stored = jax.tree.map(lambda x: np.asarray(x)[order], state.storage)
    np.testing.assert_array_equal(stored.a_tm1, reference)
    assert_rows_are_whole(stored)


@pytest.mark.parametrize("replacement", [False, True])
@pytest.mark.parametrize("count", [8, 9, 20, 31])
def test_batches_hold_whole_stored_rows_only(count, replacement):
    buffer, state = filled(20, 8, count, replacement)
    keys = jax.random.split(jax.random.key(0), 50)
    batches = jax.jit(jax.vmap(buffer.sample, (0, None)))(keys, state)
    numbers = np.asarray(batches.a_tm1)
    assert numbers.shape == (50, 8)
    assert set(numbers.ravel()) == set(range(max(0, count - 20) + 1, count + 1))
    assert_rows_are_whole(jax.tree.map(lambda x: x.reshape(-1, *x.shape[2:]), batches))
    if not replacement:
        assert all(len(set(row)) == 8 for row in numbers)


def test_too_few_rows_repeat_but_are_written_ones():
    buffer, state = filled(20, 8, 3)
    numbers = jax.jit(jax.vmap(buffer.sample, (0, None)))(jax.random.split(jax.random.key(0), 50), state).a_tm1
    assert set(np.asarray(numbers).ravel()) <= {1, 2, 3}


def indexes(seed, draws, batch_size, size, pick=replay.floyd):
    words = np.random.default_rng(seed).integers(0, 2**32, (draws, batch_size), dtype=np.uint32)
    return words, np.asarray(jax.jit(jax.vmap(pick, (0, None)))(words, jnp.int32(size)))


@pytest.mark.parametrize(("size", "batch_size"), [(5, 2), (5, 3), (6, 5), (4, 4), (3, 1)])
def test_every_subset_is_equally_likely(size, batch_size):
    _, drawn = indexes(1, 60_000, batch_size, size)
    counts = collections.Counter(map(tuple, np.sort(drawn, axis=1).tolist()))
    subsets = list(itertools.combinations(range(size), batch_size))
    assert set(counts) <= set(subsets)
    if len(subsets) > 1:
        assert scipy.stats.chisquare([counts[subset] for subset in subsets]).pvalue > 1e-3


@pytest.mark.parametrize("size", [32, 33, 500])
def test_every_row_is_equally_likely_to_be_in_the_batch(size):
    draws, batch_size = 20_000, 32
    _, drawn = indexes(2, draws, batch_size, size)
    assert drawn.min() >= 0
    assert (np.diff(np.sort(drawn, axis=1), axis=1) > 0).all()
    share = np.bincount(drawn.ravel(), minlength=size) / draws
    p = batch_size / size
    assert share.shape == (size,)
    assert np.abs(share - p).max() <= 5 * np.sqrt(p * (1 - p) / draws)


@pytest.mark.parametrize("size", [16, 17, 40, 10_000])
def test_equals_floyd_in_python(size):
    words, drawn = indexes(3, 200, 16, size)
    for row, actual in zip(words, drawn, strict=True):
        chosen = []
        for word, j in zip(row.tolist(), range(size - 16, size), strict=True):
            t = word * (j + 1) >> 32
            chosen.append(j if t in chosen else t)
        np.testing.assert_array_equal(actual, chosen)


def test_draws_with_replacement_are_independent():
    buffer, state = filled(4, 2, 4, replacement=True)
    pairs = jax.jit(jax.vmap(buffer.sample, (0, None)))(jax.random.split(jax.random.key(5), 40_000), state).a_tm1
    counts = np.bincount((np.asarray(pairs) - 1) @ np.array([4, 1]), minlength=16)
    assert scipy.stats.chisquare(counts).pvalue > 1e-3


@hypothesis.settings(deadline=None)
@hypothesis.given(word=st.integers(0, 2**32 - 1), bound=st.integers(1, 2**31 - 1))
def test_bounded_is_the_high_word_of_the_product(word, bound):
    assert int(replay.bounded(jnp.uint32(word), jnp.int32(bound))) == word * bound >> 32


def test_lanes_equal_single_rings():
    buffer = replay.uniform(7, 3)
    many = transitions(np.arange(40).reshape(4, 2, 5) + 1)

    def one(seed, given, offset):
        state = buffer.init(EXAMPLE)._replace(position=offset)
        for row in range(2):
            state = buffer.add(state, jax.tree.map(lambda x, row=row: x[row], given))
        return state, buffer.sample(jax.random.key(seed), state)

    lanes, alone = jax.jit(jax.vmap(one))(np.arange(4), many, np.arange(4, dtype=np.int32)), jax.jit(one)
    for lane in range(4):
        single = alone(lane, jax.tree.map(lambda x, lane=lane: x[lane], many), np.int32(lane))
        jax.tree.map(np.testing.assert_array_equal, jax.tree.map(lambda x, lane=lane: x[lane], lanes), single)


def test_wrong_sizes_are_refused():
    with pytest.raises(ValueError, match="batch_size must be between 1 and the capacity 4, got 5"):
        replay.uniform(4, 5)
    with pytest.raises(ValueError, match="batch_size must be between 1 and the capacity 4, got 0"):
        replay.uniform(4, 0)
    buffer = replay.uniform(4, 2)
    with pytest.raises(ValueError, match=r"at most 4 transitions .* got 5"):
        buffer.add(buffer.init(EXAMPLE), transitions(np.arange(5)))
