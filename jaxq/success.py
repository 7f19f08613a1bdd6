"""Success rules: when a training counts as solved, judged at the end of each episode."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, NamedTuple

import jax.numpy as jnp

from jaxq.types import Array


@dataclass(frozen=True)
class Success:
    """A success rule as pure functions: ``init() -> state``;
    ``update(state, over, length, total, limits) -> state, solved``.

    ``over`` [] bool says that an episode ended at this step, ``length`` [] int32 how long it was, ``total`` [] its
    return; ``limits`` are the run's numbers. Called once per environment and step; where ``over`` is False the state
    stays.
    """

    init: Callable[[], Any]
    update: Callable[[Any, Array, Array, Array, Any], tuple[Any, Array]]


class Window(NamedTuple):
    """The last episodes' lengths or returns, in a ring."""

    values: Array  # [window], 0 where no episode has been
    position: Array


class Returns(NamedTuple):
    """The last episodes' returns, in a ring, and how many there have been, counted up to the window."""

    ring: Window
    episodes: Array


def streak() -> Success:
    """Solved once more than ``limits.success_streak`` episodes in a row each ended at 0-based step
    ``limits.success_steps`` or later, the tutorial's rule for its table.

    streak > success_streak, where an episode of length n counts when n - 1 >= success_steps.
    """

    def init() -> Array:
        return jnp.zeros((), jnp.int32)

    def update(count: Array, over: Array, length: Array, total: Array, limits: Any) -> tuple[Array, Array]:
        del total
        good = length - 1 >= limits.success_steps
        count = jnp.where(over, jnp.where(good, count + 1, 0), count)
        return count, count > limits.success_streak

    return Success(init, update)


def window_mean(window: int) -> Success:
    """Solved once the sum of the last up to ``window`` episode lengths, over ``window``, is above
    ``limits.success_steps``: the tutorial's rule for DQN (50 episodes, 450 steps).

    Raises ValueError when the window is below 1.
    """
    _at_least_one(window)

    def init() -> Window:
        return _ring(window, jnp.int32)

    def update(state: Window, over: Array, length: Array, total: Array, limits: Any) -> tuple[Window, Array]:
        del total
        state = _push(state, over, length)
        # The sum, not the mean: XLA makes a division by a constant a product with its reciprocal, by which a mean equal
        # to the threshold may be above it. Both sides are float32 and exact for a whole threshold while they are below
        # 2^24 steps; the largest window of the presets, 10,000 episodes of 500 steps, holds 5 million.
        return state, jnp.sum(state.values) > limits.success_steps * float(window)

    return Success(init, update)


def mean_return(window: int, threshold: float) -> Success:
    """Solved once ``window`` episodes have ended and the mean return of the last ``window`` is at least ``threshold``:
    Gymnasium's rule for an environment's ``reward_threshold`` (100 episodes; 475 for CartPole-v1).

    Raises ValueError when the window is below 1.
    """
    _at_least_one(window)

    def init() -> Returns:
        return Returns(_ring(window, jnp.float32), jnp.zeros((), jnp.int32))

    def update(state: Returns, over: Array, length: Array, total: Array, limits: Any) -> tuple[Returns, Array]:
        del length, limits
        ring, episodes = _push(state.ring, over, total), jnp.minimum(state.episodes + over, window)
        return Returns(ring, episodes), (episodes >= window) & (jnp.sum(ring.values) >= threshold * window)

    return Success(init, update)


def never() -> Success:
    """No training is solved before its limits."""

    def init() -> tuple[()]:
        return ()

    def update(state: tuple[()], over: Array, length: Array, total: Array, limits: Any) -> tuple[tuple[()], Array]:
        del over, length, total, limits
        return state, jnp.zeros((), bool)

    return Success(init, update)


def _at_least_one(window: int) -> None:
    if window < 1:
        raise ValueError(f"window: {window} must be at least 1")


def _ring(window: int, dtype: Any) -> Window:
    return Window(jnp.zeros((window,), dtype), jnp.zeros((), jnp.int32))


def _push(ring: Window, over: Array, value: Array) -> Window:
    """The ring with ``value`` in the oldest one's place, where ``over``."""
    window = ring.values.shape[0]
    here = over & (jnp.arange(window) == ring.position)
    return Window(jnp.where(here, value, ring.values), (ring.position + over) % window)
