"""Worlds of the user's own: a function of numbers that makes an environment. Imports jax only where one is made."""

from __future__ import annotations

import contextlib
import inspect
import sys
from collections.abc import Callable, Iterable, Mapping
from typing import Any

import numpy as np
from pydantic import ValidationError, create_model

from jaxq import sources
from jaxq.settings import number, one_line, structure
from jaxq.worlds.world import World


def own(make_env: Callable[..., Any]) -> World:
    """The world of a function, its defaults among the settings: numbers are traced, all else is structure.

    Raises ValueError for a parameter that no setting can be.
    """
    written = sources.written(make_env)
    try:
        parameters = inspect.signature(make_env).parameters.items()
    except ValueError as error:
        raise ValueError(f"env: {written.__name__} is not allowed: {error}") from None
    fields: dict[str, Any] = {}
    for name, parameter in parameters:
        default = parameter.default
        if default is parameter.empty or parameter.kind in (parameter.VAR_POSITIONAL, parameter.POSITIONAL_ONLY):
            raise ValueError(f"env: every parameter of {written.__name__} must have a name and a default, not {name!r}")
        if name.startswith("_") or hasattr(World, name):
            raise ValueError(f"env: {name!r} is not allowed as a parameter of {written.__name__}: choose another name")
        fields[name] = _field(name, default)
    kind: Any = create_model("Own", __base__=World, **fields)
    kind.id = f"{written.__module__}:{written.__qualname__}"
    for name in ("reward_threshold", "bounds", "buckets"):
        setattr(kind, name, getattr(make_env, name, None))
    kind.factory, kind.source = staticmethod(make_env), sources.digest(make_env)
    try:
        return kind()  # type: ignore[no-any-return]
    except ValidationError as error:
        raise ValueError(f"env: {one_line(error)}") from None


def _field(name: str, default: Any) -> tuple[Any, Any]:
    """The type of a setting of this default, and its field."""
    if isinstance(default, np.generic):
        default = default.item()
    if isinstance(default, bool | str | type(None)):
        return type(default), structure(default, "")
    if isinstance(default, int | float):
        return type(default), number(default, "")
    kinds = {type(part) for part in default} if isinstance(default, tuple) else {None}
    if kinds <= {int, float}:
        return (tuple[float, ...] if float in kinds else tuple[int, ...]), structure(default, "")
    raise ValueError(f"env: {name}={default!r} is not allowed as a default: a number, a word, a switch, or numbers (,)")


def made(world: World, values: Mapping[str, Any]) -> Any:
    """The environment of a world of the user's own. Raises ValueError where the function makes no ``Env``."""
    from jaxq.types import Env

    with contextlib.redirect_stdout(sys.stderr):  # what a function prints is talk
        env = world.factory(**values) if world.factory is not None else None
    if not isinstance(env, Env):
        raise ValueError(f"env: {world} made {type(env).__name__}, which is no jaxq.types.Env")
    return env


def check(some: Iterable[World]) -> None:
    """Makes every environment of the user's own once with its numbers, and each structure with traced ones, so that
    what a function refuses is known before a run begins.

    Raises ValueError for what a function raises, and where it makes no ``Env`` that takes a step and leaves resets to
    the engine.
    """
    seen: set[Any] = set()
    for one in some:
        if one.factory is None:
            continue
        values = one.flat()
        for place, tried, how in (
            ((one.identity(), *values.items()), _tried, "raised"),
            (one.structural(), _traced, "does not take traced numbers:"),
        ):
            if place in seen:
                continue
            seen.add(place)
            try:
                tried(one, values)
            except (Exception, SystemExit) as error:  # whatever the function does
                bare = how == "raised" and sources.ours(error)
                raise ValueError(str(error) if bare else f"env: {one} {how} {sources.raised(error)}") from error


def _tried(world: World, values: Mapping[str, Any]) -> None:
    if made(world, values).resets:
        raise ValueError(f"env: {world} resets by itself, which a sweep does: leave auto_reset out")


def _traced(world: World, values: Mapping[str, Any]) -> None:
    """A reset and a step with traced numbers, of which only shapes are computed."""
    import jax

    from jaxq.types import Step

    shapes = {name: value for name, value in values.items() if world.is_structure(name)}
    numbers = {name: value for name, value in values.items() if name not in shapes}

    def once(numbers: Mapping[str, Any]) -> Any:
        env = made(world, {**numbers, **shapes})
        reset_key, step_key = jax.random.split(jax.random.key(0))
        after, happened = env.step(step_key, env.reset(reset_key), np.int32(0))
        if not isinstance(happened, Step):
            raise TypeError(f"step gave {type(happened).__name__}, which is no jaxq.types.Step")
        return happened, env.observe(after)

    with contextlib.redirect_stdout(sys.stderr):
        jax.eval_shape(once, numbers)
