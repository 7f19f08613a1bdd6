"""Where episodes begin: within Gymnasium's bounds and all over them, or as often in each state as its table says."""

from __future__ import annotations

import contextlib
import math
from typing import Any

import jax
import numpy as np

from jaxq.interop.gymnasium import reference
from jaxq.interop.gymnasium.compiled import made
from jaxq.verify.checks import Found
from jaxq.worlds import World

#: Resets, whatever a run asks for: fewer would say little.
RESETS = 1000
#: Largest distance of a coordinate's distribution from the uniform one, by Kolmogorov and Smirnov, of two coordinates'
#: correlation from 0 and of a state's share from its probability, in standard errors. One sound coordinate in 50,000
#: would be as far off by chance; the keys are fixed, so a run gives what it gave before.
ALLOWED = 6.0
#: A bound is float32 here and float64 there; and how far, relative to the range, the outermost reset may stay away from
#: it: all 1,000 would do so once in 500 million times.
ROUNDED, GAP = 1e-6, 0.02
SEED = 0


class _Bounds:
    """In the place of Gymnasium's generator: notes between which bounds numbers are drawn."""

    def uniform(self, low: Any, high: Any, size: Any = None) -> Any:
        self.low, self.high = low, high
        shape = size if size is not None else np.shape(low)
        return np.broadcast_to(np.asarray(low, float), shape).copy() if shape else float(low)


def compared(world: World) -> Found:
    """The most standard errors by which 1,000 resets miss the distribution of Gymnasium's; infinite where one is
    outside of its bounds, or where the outermost ones stay away from them."""
    env = made(world)
    keys = jax.random.split(jax.random.key(SEED), RESETS)
    states = jax.jit(jax.vmap(env.reset))(keys)
    with contextlib.closing(reference.make(world)) as theirs:
        if env.num_states is not None:
            expected = np.asarray(theirs.unwrapped.initial_state_distrib)  # type: ignore[attr-defined]
            return _shares(np.asarray(states.s), expected)
        low, high = _bounds(theirs, world)
    return _spread(np.stack([np.asarray(leaf, float) for leaf in states[:-1]], -1), low, high)


def _bounds(env: Any, world: Any) -> tuple[np.ndarray, np.ndarray]:
    """Between what Gymnasium draws each coordinate: its own bounds, or the ones of a world whose bounds are others."""
    default = type(world)()
    options: dict[str, float] | None = None
    if world.id == "Pendulum-v1":
        if (world.reset_angle, world.reset_speed) != (default.reset_angle, default.reset_speed):
            options = {"x_init": world.reset_angle, "y_init": world.reset_speed}
    elif (world.reset_low, world.reset_high) != (default.reset_low, default.reset_high):
        options = {"low": world.reset_low, "high": world.reset_high}
    bare, seen = env.unwrapped, _Bounds()
    bare.np_random = seen
    bare.reset(options=options)
    size = len(bare.state)
    low, high = np.broadcast_to(seen.low, size).copy(), np.broadcast_to(seen.high, size).copy()
    if world.id == "MountainCar-v0":
        low[1] = high[1] = 0.0  # it begins at rest
    return low, high


def _spread(states: np.ndarray, low: np.ndarray, high: np.ndarray) -> Found:
    """Shapes: states [n, D], low and high [D]."""
    count, worst, detail = len(states), 0.0, ""
    moving = np.flatnonzero(high > low)
    share = (states[:, moving] - low[moving]) / (high - low)[moving]
    still = np.abs(states - low)[:, high <= low]
    least, most = share.min(0), share.max(0)
    if np.any(still) or least.min() < -ROUNDED or most.max() > 1 + ROUNDED or max(least.max(), 1 - most.min()) > GAP:
        told = f"from {states.min(0).tolist()} to {states.max(0).tolist()}"
        return Found(count, math.inf, ALLOWED, f"{told}, theirs from {low.tolist()} to {high.tolist()}")
    ranks = (np.arange(count) + 0.5) / count
    for i in range(len(moving)):
        apart = (
            2 * math.sqrt(count) * np.abs(np.sort(share[:, i]) - ranks).max()
        )  # the spread of a share is at most 1/2
        worst, detail = max((worst, detail), (apart, f"coordinate {moving[i]} is not spread evenly"))
        for j in range(i):
            together = math.sqrt(count) * abs(np.corrcoef(share[:, i], share[:, j])[0, 1])
            worst, detail = max((worst, detail), (together, f"coordinates {moving[j]} and {moving[i]} go together"))
    return Found(count, worst, ALLOWED, detail if worst > ALLOWED else "")


def _shares(states: np.ndarray, expected: np.ndarray) -> Found:
    """Shapes: states [n], expected [S]."""
    count = len(states)
    share = np.bincount(states, minlength=len(expected)) / count
    spread = np.sqrt(expected * (1 - expected) / count)
    with np.errstate(divide="ignore", invalid="ignore"):
        error = np.where(np.isclose(share, expected), 0, np.abs(share - expected) / spread)
    s = int(np.argmax(error))
    told = f"state {s} comes first with {share[s]:g}, theirs {expected[s]:g}"
    return Found(count, error[s], ALLOWED, told if error[s] > ALLOWED else "")
