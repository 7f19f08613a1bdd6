"""A world of ours as a Gymnasium environment."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, TypeAlias

import gymnasium
import numpy as np
from gymnasium import spaces

from jaxq.interop.gymnasium.compiled import Compiled, compiled, drawn, made, numbers
from jaxq.interop.gymnasium.spaces import begun_with, observation_space
from jaxq.settings import NO_LIMIT, changed
from jaxq.suggest import nearest
from jaxq.worlds import World
from jaxq.worlds import world as world_of

RENDER_MODES = ("rgb_array",)

#: A world by name, with numbers of its own, or a function of numbers that makes a ``jaxq.types.Env``.
Chosen: TypeAlias = str | World | Callable[..., Any]


class PureEnv(gymnasium.Env):
    """A world as ``gymnasium.Env``: ``gymnasium.make("jaxq/CartPole-v1", length=0.25, render_mode="rgb_array")``.

    Keyword arguments are the world's numbers and options. ``PureEnv(make_env, length=0.25)`` has an environment of the
    user's own, a function of numbers that returns a ``jaxq.types.Env``. Without ``max_episode_steps`` the episodes of a
    world by name have no limit of their own: ``gymnasium.make`` puts its ``TimeLimit`` around. ``reset(seed=...,
    options={"low": ..., "high": ...})`` as in Gymnasium's environments. Raises ValueError for an unknown or a wrong
    number, and gymnasium.error.InvalidAction, gymnasium.error.ResetNeeded.
    """

    # Where gymnasium.make looks before there is an environment, which has more.
    metadata: dict[str, Any] = {"render_modes": list(RENDER_MODES)}  # noqa: RUF012

    def __init__(self, world: Chosen = "CartPole-v1", render_mode: str | None = None, **settings: Any) -> None:
        self.world = settled(world, settings)
        self.metadata = metadata(self.world)
        self.render_mode = checked_mode(render_mode)
        env = made(self.world)
        self.action_space = spaces.Discrete(env.num_actions)
        self.observation_space = observation_space(self.world, env)
        self._count, self._discrete = env.num_actions, env.num_states is not None
        self._numbers = numbers(self.world)
        self._pure: Compiled | None = compiled(self.world)
        self._of: Any = None
        self._episode = np.uint32(0)
        self.state: Any = None

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[Any, dict[str, Any]]:
        """Begins an episode; a seed fixes this one and all that follow."""
        begun = begun_with(self.world, options)
        super().reset(seed=seed)
        if self._of is None or seed is not None:
            self._of, self._episode = drawn(self.np_random), np.uint32(0)
        else:
            self._episode += np.uint32(1)
        given = numbers(begun) if options else self._numbers
        self.state, obs = self._functions.begin(self._of, self._episode, given)
        return self._seen(obs), {}

    def step(self, action: Any) -> tuple[Any, float, bool, bool, dict[str, Any]]:
        """Takes an action."""
        if self.state is None:
            raise gymnasium.error.ResetNeeded("Cannot call env.step() before calling env.reset()")
        if not self.action_space.contains(action):
            raise gymnasium.error.InvalidAction(f"action: {action!r} is not allowed: 0 to {self._count - 1}")
        self.state, obs, told = self._functions.step(
            self._of, self._episode, self.state, np.int32(action), self._numbers
        )
        reward, terminated, truncated = np.asarray(told).tolist()
        return self._seen(obs), reward, terminated > 0, truncated > 0, {}

    def render(self) -> np.ndarray | None:
        """The picture of the state, [H, W, 3] uint8."""
        if self.render_mode is None:
            gymnasium.logger.warn('render needs gymnasium.make(..., render_mode="rgb_array")')
            return None
        from jaxq import frames

        if self.state is None:
            raise gymnasium.error.ResetNeeded("Cannot call env.render() before calling env.reset()")
        return frames.draw(self.world, self.state)

    @property
    def _functions(self) -> Compiled:
        if self._pure is None:  # of a copy, or from another process
            self._pure = compiled(self.world)
        return self._pure

    def _seen(self, obs: Any) -> Any:
        return int(obs) if self._discrete else np.array(obs)  # a copy: JAX's array is read-only

    def __getstate__(self) -> dict[str, Any]:
        import jax

        held = {"state": self.state, "_numbers": self._numbers}
        return {**self.__dict__, "_pure": None, **jax.tree.map(np.asarray, held)}


def settled(world: Chosen, settings: dict[str, Any]) -> World:
    """The world with these numbers. One by name has no limit of its own, unless it is among them: Gymnasium's
    ``TimeLimit`` has it."""
    found = world_of(world)
    known = type(found).model_fields
    for name in settings:
        if name not in known:
            raise ValueError(f"{name}: {found} has no such setting{nearest(name, known)}")
    free = {"max_episode_steps": NO_LIMIT} if isinstance(world, str) else {}
    return changed(found, {**free, **settings})  # type: ignore[no-any-return]


def metadata(world: World) -> dict[str, Any]:
    """Gymnasium's metadata of a world."""
    return {"render_modes": list(RENDER_MODES), "render_fps": world.frame_rate}


def checked_mode(render_mode: str | None) -> str | None:
    """The mode; raises ValueError for one that there is none of."""
    if render_mode not in (None, *RENDER_MODES):
        raise ValueError(f"render_mode: {render_mode!r} is not allowed: None or rgb_array")
    return render_mode
