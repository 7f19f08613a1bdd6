"""The books of a group: what is averaged over a segment."""

import numpy as np
import pytest

from jaxq.experiment import Log
from jaxq.programs import Program
from jaxq.rounds import Limits
from jaxq.tally import Lane, Tally
from jaxq.types import Clock, Hypers

ROUNDS = 4000


def booked(values, rounds):
    """The curves of lanes with these values in every round, after a segment of which each lane made ``rounds``."""
    width = len(rounds)
    tally = Tally(Program(None, width=width, num_envs=1), keep_max_q=False)
    for i in range(width):
        tally.enter(i, Lane(i, 0, Hypers((), (), Limits(10**6, 10**6, 0, 0))))
    counts = np.array(rounds)
    clock = Clock(env_steps=counts, episodes=np.zeros(width, int), updates=counts, live=np.ones(width))
    over = np.zeros((ROUNDS, width, 1, 1), bool)
    log = Log(over, over.astype(np.float32), values, 2 * values, np.zeros(width, np.float32))
    tally.book(np.ones(width, bool), clock, log)
    return [tally.leave(i).curve for i in range(width)]


@pytest.mark.parametrize("value", [0.1, 99.7, 1e-3])
def test_the_mean_of_equal_values_is_that_value(value):
    value = np.float32(value)
    for curve in booked(np.full((ROUNDS, 3), value), [ROUNDS, ROUNDS - 1, 1234]):  # two lanes ended on the way
        np.testing.assert_allclose(curve.max_q, [float(value)], rtol=1e-12)
        np.testing.assert_allclose(curve.loss, [2 * float(value)], rtol=1e-12)


def test_rounds_after_a_lane_ended_are_not_averaged():
    values = np.random.default_rng(0).normal(size=(ROUNDS, 2)).astype(np.float32)
    poisoned = values.copy()
    poisoned[1234:, 1] = np.nan
    for rows in (values, poisoned):
        long, short = booked(rows, [ROUNDS, 1234])
        np.testing.assert_allclose(long.max_q, [values[:, 0].mean(dtype=float)], rtol=1e-12)
        np.testing.assert_allclose(short.max_q, [values[:1234, 1].mean(dtype=float)], rtol=1e-12)


class Naive:
    """One lane's books, a step at a time."""

    def __init__(self, num_envs):
        self.length = np.zeros(num_envs, int)
        self.ticks = self.updates = 0
        self.episodes, self.curve, self.max_q = [], [], []

    def see(self, slot, log, valid, learns):
        returns = []
        for u in range(valid):
            for t in range(log.over.shape[2]):
                self.ticks += 1
                self.length += 1
                for n in np.flatnonzero(log.over[u, slot, t]):
                    returns.append(float(log.total[u, slot, t, n]))
                    self.episodes.append(
                        (self.ticks * len(self.length), self.length[n], returns[-1], log.max_q[u, slot])
                    )
                    self.length[n] = 0
            if learns:
                self.updates += 1
                self.max_q.append(log.max_q[u, slot])
        if valid:
            mean_return = np.mean(returns) if returns else np.nan
            means = [np.mean(x[:valid, slot], dtype=float) if learns else np.nan for x in (log.loss, log.max_q)]
            counts = self.ticks * len(self.length), len(self.episodes), self.updates
            self.curve.append((*counts, mean_return, *means, log.epsilon[slot], np.nan))


@pytest.mark.parametrize(("num_envs", "per_round"), [(1, 1), (3, 2)])
def test_each_lane_takes_along_what_it_did_in_its_slot(num_envs, per_round):
    """Lanes come and go; a warm-up is a log of its own, of those who have just come."""
    rng, width = np.random.default_rng(0), 4
    tally = Tally(Program(None, width=width, num_envs=num_envs), keep_max_q=True)
    naive = [None] * width
    left = 0

    def book(which, rounds, steps, learns):
        shape = rounds, width, steps, num_envs
        values = rng.normal(size=(2, rounds, width)).astype(np.float32)
        log = Log(
            rng.random(shape) < 0.2,
            rng.integers(0, 500, shape).astype(np.float32),
            *(values if learns else np.full_like(values, np.nan)),
            rng.random(width).astype(np.float32),
        )
        counts = rng.integers(0, 99, (3, width))  # of a slot that is not looked at: anything
        steps_before, updates_before = tally.env_steps.copy(), tally.updates.copy()
        for i in np.flatnonzero(which):
            valid = rounds if rng.random() < 0.5 else rng.integers(0, rounds + 1)
            naive[i].see(i, log, valid, learns)
            counts[:, i] = naive[i].ticks * num_envs, len(naive[i].episodes), naive[i].updates
        made = tally.book(which, Clock(*counts, live=np.ones(width)), log)
        after = np.where(which, counts, [steps_before, counts[1], updates_before])
        assert made == (int((after[0] - steps_before).sum()), int((after[2] - updates_before).sum()))

    for _ in range(100):
        fresh = np.array([lane is None and rng.random() < 0.6 for lane in naive])
        for i in np.flatnonzero(fresh):
            naive[i] = Naive(num_envs)
            tally.enter(i, Lane(i, 0, Hypers((), (), Limits(10**6, 10**6, 0, 0))))
        if fresh.any():
            book(fresh, 5, 1, learns=False)
        held = np.array([lane is not None for lane in naive])
        book(held, 6, per_round, learns=True)
        for i in np.flatnonzero(held & (rng.random(width) < 0.3)):
            done, mine = tally.leave(i), naive[i]
            assert (done.env_steps, done.updates) == (mine.ticks * num_envs, mine.updates)
            np.testing.assert_array_equal(np.transpose(done.episodes), np.reshape(mine.episodes, (-1, 4)))
            np.testing.assert_allclose(np.transpose(done.curve), np.reshape(mine.curve, (-1, 8)), rtol=1e-12)
            np.testing.assert_array_equal(done.max_q, np.array(mine.max_q, np.float32))
            naive[i], left = None, left + 1
    assert left > 50
