"""Pictures of the states of worlds, drawn without a display."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from jaxq.frames import classic, grids
from jaxq.worlds import World

__all__ = ["draw", "drawn", "size_of"]

_DRAWN: dict[str, tuple[Callable[[Any, Any, tuple[int, int]], np.ndarray], tuple[int, int]]] = {
    "CartPole-v1": (classic.cartpole, (600, 400)),
    "Acrobot-v1": (classic.acrobot, (500, 500)),
    "MountainCar-v0": (classic.mountain_car, (600, 400)),
    "Pendulum-v1": (classic.pendulum, (500, 500)),
    "FrozenLake-v1": (grids.frozen_lake, (400, 400)),
    "FrozenLake8x8-v1": (grids.frozen_lake, (400, 400)),
    "CliffWalking-v1": (grids.cliff_walking, (720, 240)),
    "Taxi-v4": (grids.taxi, (400, 400)),
}


def drawn(world: World) -> bool:
    """Whether there are pictures of this world."""
    return world.factory is None and world.id in _DRAWN


def size_of(world: World) -> tuple[int, int] | None:
    """The width and height of a world's picture unless told otherwise; None where there is none."""
    return _DRAWN[world.id][1] if drawn(world) else None


def draw(world: World, state: Any, *, size: tuple[int, int] | None = None) -> np.ndarray:
    """The picture of one state of a world, ``size`` (width, height) pixels.

    Shapes: -> [height, width, 3] uint8. The world's own numbers show: lengths, thresholds, goals. Raises ValueError for
    a world that has no pictures, as the user's own.
    """
    if not drawn(world):
        raise ValueError(f"env: {world} is not allowed: it has no pictures; {', '.join(_DRAWN)} have")
    if size is not None and not all(isinstance(side, int) and 16 <= side <= 4096 for side in size):
        raise ValueError(f"size: {size} is not allowed: width and height from 16 to 4096")
    picture, usual = _DRAWN[world.id]
    return picture(world, state, size or usual)
