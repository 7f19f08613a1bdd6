"""The numbers of environments: every default, its unit, its range and its help, in one place. Imports no jax.

A *world* says which environment a lane lives in; ``envs`` makes the environment of it.
"""

from __future__ import annotations

import inspect
import math
from collections.abc import Callable
from typing import Any, ClassVar, Literal

from pydantic import create_model, model_validator

from jaxq import sources
from jaxq.settings import NO_LIMIT, Settings, number, structure
from jaxq.suggest import nearest

Size = {"ge": 1e-6, "le": 1e6}


class World(Settings):
    """An environment's numbers and options.

    ``reward_threshold`` is the mean return at which it counts as solved, where there is such a thing. ``factory`` is
    the user's own function of the fields, None for an environment that ``envs`` knows by its ``id``.
    """

    id: ClassVar[str] = ""
    reward_threshold: ClassVar[float | None] = None
    factory: ClassVar[Callable[..., Any] | None] = None
    source: ClassVar[str | None] = (
        None  # of the user's function, what sources.digest says: a run directory remembers it
    )

    def __str__(self) -> str:
        return self.id

    def identity(self) -> Any:
        """The environment, or the user's function itself: two may have one name."""
        return type(self).factory or self.id


class CartPole(World):
    """Gymnasium's classic CartPole-v1."""

    id: ClassVar[str] = "CartPole-v1"
    reward_threshold: ClassVar[float | None] = 475.0

    gravity: float = number(9.8, "m/s^2", **Size)
    masscart: float = number(1.0, "kg: mass of the cart", **Size)
    masspole: float = number(0.1, "kg: mass of the pole", **Size)
    length: float = number(0.5, "m: half the pole's length", **Size)
    force_mag: float = number(10.0, "N: force of a push", **Size)
    tau: float = number(0.02, "s between two steps", **Size)
    theta_threshold_radians: float = number(12 * 2 * math.pi / 360, "rad: pole angle that ends an episode", **Size)
    x_threshold: float = number(2.4, "m: cart position that ends an episode", **Size)
    max_episode_steps: int = number(500, "steps after which an episode is truncated", ge=1, le=NO_LIMIT)
    reset_low: float = number(-0.05, "least of each coordinate at a reset", ge=-1e6, le=1e6)
    reset_high: float = number(0.05, "greatest of each coordinate at a reset", ge=-1e6, le=1e6)
    integrator: Literal["euler", "semi-implicit"] = structure("euler", "how the equations of motion are stepped")
    sutton_barto_reward: bool = structure(False, "reward 0, and -1 for the step that falls")

    @model_validator(mode="after")
    def _ordered(self) -> CartPole:
        if self.reset_low > self.reset_high:
            raise ValueError(f"reset_low: {self.reset_low} must not be above reset_high ({self.reset_high})")
        return self


WORLDS: dict[str, type[World]] = {CartPole.id: CartPole}


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
    kind.reward_threshold = getattr(make_env, "reward_threshold", None)
    kind.factory, kind.source = staticmethod(make_env), sources.digest(make_env)
    return kind()
