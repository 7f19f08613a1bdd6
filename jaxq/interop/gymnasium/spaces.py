"""Gymnasium's spaces of our worlds, and its options at a reset as numbers of ours."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from gymnasium import spaces
from gymnasium.vector.utils import batch_space

from jaxq.settings import changed
from jaxq.suggest import nearest
from jaxq.types import Env
from jaxq.worlds import Pendulum, World


def observation_space(world: World, env: Env) -> spaces.Space:
    """The space of a world's observations: its bounds, or the integers of a finite one."""
    if env.num_states is not None:
        return spaces.Discrete(env.num_states)
    bounds = world.observed(world)
    if bounds is None:
        return spaces.Box(-np.inf, np.inf, env.obs_shape, np.float32)
    low, high = zip(*bounds, strict=True)
    return spaces.Box(np.array(low, np.float32), np.array(high, np.float32), dtype=np.float32)


def batched(space: spaces.Space, num_envs: int) -> spaces.Space:
    """The space of so many observations, or actions, at once."""
    return batch_space(space, num_envs)


def begun_with(world: World, options: Mapping[str, Any] | None) -> World:
    """The world with the bounds of a reset that its ``options`` ask for, as Gymnasium's environments take them.

    ``low`` and ``high`` where a world has ``reset_low`` and ``reset_high``; ``x_init`` and ``y_init`` for the
    pendulum's greatest angle and speed. Raises ValueError for other options.
    """
    names = {}
    if "reset_low" in type(world).model_fields:
        names = {"low": "reset_low", "high": "reset_high"}
    elif isinstance(world, Pendulum):
        names = {"x_init": "reset_angle", "y_init": "reset_speed"}
    if not options:
        return world
    for name in options:
        if name not in names:
            raise ValueError(f"options: {name!r} is unknown to {world}{nearest(name, names) if names else ''}")
        if isinstance(options[name], bool) or not isinstance(options[name], (int, float, np.number)):
            raise ValueError(f"options: {name} {options[name]!r} is not allowed: a number")
    return changed(world, {names[name]: float(value) for name, value in options.items()})  # type: ignore[no-any-return]
