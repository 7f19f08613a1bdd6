"""The numbers of environments: every default, its unit, its range and its help, in one place. Imports no jax.

A *world* says which environment a lane lives in; ``envs`` makes the environment of it.
"""

from __future__ import annotations

import inspect
from collections.abc import Callable, Iterable, Mapping
from typing import Any

from pydantic import create_model

from jaxq import sources
from jaxq.settings import number, structure
from jaxq.suggest import nearest
from jaxq.worlds.classic import Acrobot, CartPole, MountainCar, Pendulum
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
        return _own(chosen)
    if not isinstance(chosen, str) or chosen not in WORLDS:
        raise ValueError(f"env: {chosen!r} is unknown{nearest(str(chosen), WORLDS)}")
    return WORLDS[chosen]()


def made(world: World, values: Mapping[str, Any]) -> Any:
    """The environment of a world of the user's own. Raises ValueError where the function makes no ``Env``."""
    from jaxq.types import Env

    env = world.factory(**values) if world.factory is not None else None
    if not isinstance(env, Env):
        raise ValueError(f"env: {world} made {type(env).__name__}, which is no jaxq.types.Env")
    return env


def check(some: Iterable[World]) -> None:
    """Makes every environment of the user's own once, so that what a function refuses is known before a run begins.

    Raises ValueError for what a function raises, and where it makes no ``Env``.
    """
    seen = set()
    for one in some:
        values = one.flat()
        if one.factory is None or (place := tuple(values.items())) in seen:
            continue
        seen.add(place)
        try:
            made(one, values)
        except Exception as error:  # whatever the function does
            known = isinstance(error, ValueError)
            raise ValueError(str(error) if known else f"env: {one} raised {sources.raised(error)}") from error


def listed() -> str:
    """A line per world: its name and what it is."""
    width = max(map(len, WORLDS)) + 2
    return "\n".join(f"  {name:{width}}{kind.summary}" for name, kind in WORLDS.items())


def _own(make_env: Callable[..., Any]) -> World:
    written = sources.written(make_env)
    fields: dict[str, Any] = {}
    for name, parameter in inspect.signature(make_env).parameters.items():
        default = parameter.default
        if default is parameter.empty or parameter.kind in (parameter.VAR_POSITIONAL, parameter.POSITIONAL_ONLY):
            raise ValueError(f"env: every parameter of {written.__name__} must have a name and a default, not {name!r}")
        if name.startswith("_") or hasattr(World, name):
            raise ValueError(f"env: {name!r} is not allowed as a parameter of {written.__name__}: choose another name")
        traced = isinstance(default, (int, float)) and not isinstance(default, bool)
        fields[name] = (type(default), number(default, "") if traced else structure(default, ""))
    kind: Any = create_model("Own", __base__=World, **fields)
    kind.id = f"{written.__module__}:{written.__qualname__}"
    for name in ("reward_threshold", "bounds", "buckets"):
        setattr(kind, name, getattr(make_env, name, None))
    kind.factory, kind.source = staticmethod(make_env), sources.digest(make_env)
    return kind()
