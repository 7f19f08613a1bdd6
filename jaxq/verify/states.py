"""Random states of the worlds that are no tables, a share of them a step before a threshold."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any, NamedTuple

import gymnasium
import numpy as np

from jaxq.verify import stepped
from jaxq.worlds import World

Between = tuple[tuple[float, float], ...]


class Edge(NamedTuple):
    """Where something turns in a step. A state is brought there by moving one ``coordinate``."""

    coordinate: int
    margin: Callable[[np.ndarray], np.ndarray]  # successors [n, D] -> [n], how far they are past it
    scale: float  # of the margin
    between: Between  # what the states are before they are moved


#: Between what the coordinates of a world's random states lie: past CartPole's thresholds, to the greatest speeds, over
#: the whole track, and over several turns of the pendulum.
BETWEEN: dict[str, Callable[[Any], Between]] = {
    "CartPole-v1": lambda w: (
        *((-1.7 * w.x_threshold, 1.7 * w.x_threshold), (-4, 4)),
        *((-1.7 * w.theta_threshold_radians, 1.7 * w.theta_threshold_radians), (-4, 4)),
    ),
    "Acrobot-v1": lambda w: (
        *((-math.pi, math.pi), (-math.pi, math.pi)),
        *((-w.max_vel_1, w.max_vel_1), (-w.max_vel_2, w.max_vel_2)),
    ),
    "MountainCar-v0": lambda w: ((w.min_position, w.max_position), (-w.max_speed, w.max_speed)),
    "Pendulum-v1": lambda w: ((-12, 12), (-w.max_speed, w.max_speed)),
}
#: How far from an edge the successors are at most, relative to its scale; which share of the states belongs to each
#: edge, and at least how many.
NEAR, SHARE, LEAST = 1e-3, 0.05, 24
#: Steps of the secant's method that bring a state to an edge, and the first of them.
STEPS, FIRST = 4, 1e-3


def edges(world: Any) -> list[Edge]:
    """The thresholds and goals of a world."""
    if world.id == "CartPole-v1":
        inside: Between = ((-world.x_threshold, world.x_threshold), (-1, 1))
        inside += ((-world.theta_threshold_radians, world.theta_threshold_radians), (-1, 1))
        return [
            Edge(0, lambda s: np.abs(s[:, 0]) - world.x_threshold, world.x_threshold, inside),
            Edge(2, lambda s: np.abs(s[:, 2]) - world.theta_threshold_radians, world.theta_threshold_radians, inside),
        ]
    if world.id == "Acrobot-v1":
        # With the first link's angle like this, some second one puts the feet at the line.
        slow = ((math.pi / 2, math.pi), (-math.pi, math.pi), (-1.0, 1.0), (-1.0, 1.0))
        return [Edge(1, lambda s: -np.cos(s[:, 0]) - np.cos(s[:, 0] + s[:, 1]) - 1, 1.0, slow)]
    if world.id == "MountainCar-v0":
        track = (world.goal_position - world.max_speed / 2, world.max_position)
        beyond = ((world.goal_position + world.max_speed / 4, world.max_position), (-world.max_speed, world.max_speed))
        return [
            Edge(0, lambda s: s[:, 0] - world.goal_position, abs(world.goal_position), (track, beyond[1])),
            Edge(1, lambda s: s[:, 1] - world.goal_velocity, world.max_speed, beyond),
        ]
    return []


def drawn(
    env: gymnasium.Env, world: World, dtype: str, cases: int, count: int, rng: np.random.Generator
) -> tuple[np.ndarray, np.ndarray]:
    """States with each of ``count`` actions, and those close to each edge with one; rounded to the dtype.

    ``env`` is Gymnasium's environment, whose steps find where the edges are. Shapes: -> [n, D], [n].
    """
    low, high = np.array(BETWEEN[world.id](world)).T
    anywhere = rng.uniform(low, high, (cases, len(low)))
    states, actions = [np.repeat(anywhere, count, 0)], [np.tile(np.arange(count), cases)]
    for edge in edges(world):
        some = rng.integers(count, size=max(LEAST, round(SHARE * cases)))
        states.append(_close(env, world, edge, some, rng))
        actions.append(some)
    return np.concatenate(states).astype(dtype).astype(float), np.concatenate(actions)


def _close(env: gymnasium.Env, world: World, edge: Edge, actions: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """States from which these actions lead within ``NEAR`` of an edge, most of them."""
    low, high = np.array(edge.between).T
    states = rng.uniform(low, high, (len(actions), len(low)))
    wanted = rng.uniform(-NEAR, NEAR, len(actions)) * edge.scale

    def missed(at: np.ndarray) -> np.ndarray:
        states[:, edge.coordinate] = at
        found: np.ndarray = edge.margin(stepped.theirs(env, world, states, actions).after) - wanted
        return found

    before, at = states[:, edge.coordinate].copy(), states[:, edge.coordinate] + FIRST * edge.scale
    miss = missed(before)
    for _ in range(STEPS):
        now = missed(at)
        slope = (now - miss) / np.where(at == before, 1, at - before)
        moved = at - now / np.where(np.abs(slope) < 1e-3, np.inf, slope)
        before, miss = at, now
        at = np.clip(moved, low[edge.coordinate] - 1, high[edge.coordinate] + 1)
    states[:, edge.coordinate] = at
    return states
