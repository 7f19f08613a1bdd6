"""The tutorial's tabular Q-learning written in Numba, physics and all: updates per second.

Lanes are shared out among the cores by ``prange``, each with a table and random numbers of its own; a bout is trainings
of a fixed number of steps without the rule that ends them early. In the peer's favour mathematics may be reordered,
coordinates with a single bucket are not looked at, random numbers come from a short generator, and nothing is logged.
"""

from __future__ import annotations

import math
from collections.abc import Callable

PACKAGES = ("numba", "llvmlite", "numpy")


def prepare(case: str, updates: str) -> Callable[[], float]:
    """``case`` lanes of so many ``updates``. Units: updates, one per environment step."""
    count = int(case)
    many, _ = build()
    first = 0

    def bout() -> float:
        nonlocal first
        _, steps = many(count, first, int(updates), 2**30)
        first += count
        return float(steps.sum())

    return bout


def build() -> tuple[Callable, Callable]:
    """The compiled trainings: ``many(lanes, first seed, steps, streak)`` and ``one(seed, steps, streak)``.

    Each gives the episode in which a training was solved (-1: not) and its steps, ``many`` as arrays over lanes. A
    streak of more than ``streak`` successful episodes solves; a training ends then or after ``steps``.
    """
    import numba
    import numpy as np

    gravity, cart, pole, half_length, push, tau = 9.8, 1.0, 0.1, 0.5, 10.0, 0.02
    total, moment = cart + pole, pole * half_length
    x_limit, angle_limit, time_limit = 2.4, 12 * 2 * math.pi / 360, 500
    angle_bound, rate_bound = float(np.float32(2 * angle_limit)), math.radians(50)
    angles, rates, actions = 6, 3, 2
    gamma, success_steps = 0.99, 450
    jit = numba.njit(fastmath=True, cache=False)

    @jit
    def bucket(value, bound, count):
        if value <= -bound:
            return 0
        if value >= bound:
            return count - 1
        return int(np.rint((count - 1) / (2 * bound) * value + (count - 1) / 2))

    @jit
    def decay(episode, low, high):
        return max(low, min(high, 1.0 - math.log10((episode + 1) / 25)))

    @jit
    def draw(state):
        """The next state of SplitMix64, and a number in [0, 1)."""
        state += np.uint64(0x9E3779B97F4A7C15)
        word = (state ^ (state >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
        word = (word ^ (word >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
        return state, ((word ^ (word >> np.uint64(31))) >> np.uint64(11)) * 2.0**-53

    @jit
    def one(seed, steps, streak):
        state, _ = draw(np.uint64(seed) * np.uint64(0xD1B54A32D192ED03))
        table = np.zeros((angles, rates, actions))
        done_steps, in_a_row, episode = 0, 0, 0
        while done_steps < steps:
            epsilon, alpha = decay(episode, 0.01, 1.0), decay(episode, 0.1, 0.5)
            state, a = draw(state)
            state, b = draw(state)
            state, c = draw(state)
            state, d = draw(state)
            x, x_dot, angle, rate = 0.1 * a - 0.05, 0.1 * b - 0.05, 0.1 * c - 0.05, 0.1 * d - 0.05
            i, j = bucket(angle, angle_bound, angles), bucket(rate, rate_bound, rates)
            length, over = 0, False
            while not over:
                action = 1 if table[i, j, 1] > table[i, j, 0] else 0
                state, chance = draw(state)
                if chance < epsilon:
                    state, chance = draw(state)
                    action = int(actions * chance)
                cos, sin = math.cos(angle), math.sin(angle)
                shared = ((push if action == 1 else -push) + moment * rate * rate * sin) / total
                turn = (gravity * sin - cos * shared) / (half_length * (4.0 / 3.0 - pole * cos * cos / total))
                x += tau * x_dot
                x_dot += tau * (shared - moment * turn * cos / total)
                angle += tau * rate
                rate += tau * turn
                length += 1
                over = abs(x) > x_limit or abs(angle) > angle_limit or length >= time_limit
                next_i, next_j = bucket(angle, angle_bound, angles), bucket(rate, rate_bound, rates)
                best = max(table[next_i, next_j, 0], table[next_i, next_j, 1])
                # as the tutorial does, it bootstraps through the end of an episode
                table[i, j, action] += alpha * (1.0 + gamma * best - table[i, j, action])
                i, j = next_i, next_j
            done_steps += length
            episode += 1
            in_a_row = in_a_row + 1 if length > success_steps else 0
            if in_a_row > streak:
                return episode, done_steps
        return -1, done_steps

    @numba.njit(parallel=True, fastmath=True, cache=False)
    def many(lanes, first, steps, streak):
        solved, done_steps = np.zeros(lanes, np.int64), np.zeros(lanes, np.int64)
        for lane in numba.prange(lanes):
            solved[lane], done_steps[lane] = one(first + lane, steps, streak)
        return solved, done_steps

    return many, one
