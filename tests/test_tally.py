"""The books of a group: what is averaged over a segment."""

import numpy as np
import pytest

from jaxq.experiment import Limits, Log
from jaxq.programs import Program
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
