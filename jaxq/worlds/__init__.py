"""The numbers of environments: every default, its unit, its range and its help, in one place. Imports no jax.

A *world* says which environment a lane lives in; ``envs`` makes the environment of it.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from jaxq.suggest import nearest
from jaxq.worlds.classic import Acrobot, CartPole, MountainCar, Pendulum
from jaxq.worlds.own import check, made, own
from jaxq.worlds.toy_text import CliffWalking, FrozenLake, FrozenLake8x8, Taxi
from jaxq.worlds.world import World

__all__ = [
    "WORLDS",
    "Acrobot",
    "CartPole",
    "CliffWalking",
    "FrozenLake",
    "FrozenLake8x8",
    "MountainCar",
    "Pendulum",
    "Taxi",
    "World",
    "check",
    "listed",
    "made",
    "world",
]

_KNOWN: tuple[type[World], ...] = (
    *(CartPole, Acrobot, MountainCar, Pendulum),
    *(FrozenLake, FrozenLake8x8, CliffWalking, Taxi),
)
WORLDS: dict[str, type[World]] = {kind.id: kind for kind in _KNOWN}


def world(chosen: str | World | Callable[..., Any]) -> World:
    """The world of a name, with its defaults, or of the user's own function; a World is returned as it is.

    Raises ValueError for an unknown name, with the nearest, and for a function whose parameters lack a default.
    """
    if isinstance(chosen, World):
        return chosen
    if callable(chosen):
        return own(chosen)
    if not isinstance(chosen, str) or chosen not in WORLDS:
        raise ValueError(f"env: {chosen!r} is unknown{nearest(str(chosen), WORLDS)}")
    return WORLDS[chosen]()


def listed() -> str:
    """A line per world: its name and what it is."""
    width = max(map(len, WORLDS)) + 2
    return "\n".join(f"  {name:{width}}{kind.summary}" for name, kind in WORLDS.items())
