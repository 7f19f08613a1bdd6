"""Pictures of an outcome by their kind."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any, Protocol

import pyarrow as pa

from jaxq import pictures, replayed
from jaxq.replayed import Trained
from jaxq.suggest import nearest
from jaxq.worlds import CartPole


class Swept(Trained, Protocol):
    """The tables of a sweep."""

    @property
    def spec(self) -> dict[str, Any]:
        """What identifies the sweep."""

    @property
    def varied(self) -> list[str]:
        """The hyperparameters that differ between settings."""

    @property
    def lanes(self) -> pa.Table:
        """A row per training that ended."""

    def table(self, kind: str, columns: Sequence[str] | None = None) -> pa.Table:
        """``lanes``, ``curves`` or ``episodes``, or some of its columns."""

    def label(self, config: int) -> str:
        """What tells a setting from the others."""


def draw(outcome: Swept, kind: str, **options: Any) -> Any:
    """A matplotlib Figure of one kind.

    ``curves``, ``survival`` and ``spread`` show every setting; ``sensitivity`` one ``axis`` and ``heat_map`` two, ``x``
    and ``y``; ``action_values``, ``greedy_map`` and ``overestimation`` the policy of one lane, by ``config`` and
    ``seed``. Raises ValueError for an unknown kind, an unknown axis, and a lane without a policy.
    """
    if kind not in KINDS:
        raise ValueError(f"kind: {kind!r} is unknown{nearest(kind, KINDS)}")
    for name in ("axis", "x", "y"):
        if name in options and options[name] not in outcome.lanes.column_names:
            raise ValueError(f"{name}: {options[name]!r} is no column{nearest(str(options[name]), outcome.varied)}")
    return KINDS[kind](outcome, **options)


def labels(outcome: Swept) -> dict[int, str]:
    """What the settings are called in a legend."""
    return {config: outcome.label(config) for config in range(len(outcome.spec["settings"]))}


def _curves(outcome: Swept) -> Any:
    curves = outcome.table("curves", ["train_return", "eval_return"])
    return pictures.learning_curves(outcome.lanes, curves, labels(outcome))


def _survival(outcome: Swept, clock: str = "env_steps") -> Any:
    return pictures.survival(outcome.lanes, labels(outcome), clock=clock)


def _spread(outcome: Swept, metric: str = "eval_return") -> Any:
    return pictures.spread(outcome.lanes, labels(outcome), metric=metric)


def _sensitivity(outcome: Swept, axis: str, metric: str = "eval_return") -> Any:
    return pictures.sensitivity(outcome.lanes, axis, outcome.varied, metric=metric)


def _heat_map(outcome: Swept, x: str, y: str, metric: str = "eval_return") -> Any:
    return pictures.heat_map(outcome.lanes, x, y, metric=metric)


def _action_values(outcome: Swept, config: int = 0, seed: int = 0) -> Any:
    return pictures.action_values(outcome.policy(config, seed).q_values, **_bounds(outcome, config))


def _greedy_map(outcome: Swept, config: int = 0, seed: int = 0) -> Any:
    return pictures.greedy_map(outcome.policy(config, seed).q_values, **_bounds(outcome, config))


def _overestimation(outcome: Swept, config: int = 0, seed: int = 0) -> Any:
    return pictures.overestimation(*replayed.follow(outcome, config, seed))


def _bounds(outcome: Swept, config: int) -> dict[str, float]:
    """The plane of the pole: the angle at which an episode ends, and the speeds that a policy meets.

    Raises ValueError for another environment.
    """
    world = outcome.settings(config).env
    if not isinstance(world, CartPole):
        raise ValueError(f"env: {world} has no pole to draw")
    return {"angle": world.theta_threshold_radians, "angular_velocity": 2.0}


KINDS: dict[str, Callable[..., Any]] = {
    "curves": _curves,
    "survival": _survival,
    "spread": _spread,
    "sensitivity": _sensitivity,
    "heat_map": _heat_map,
    "action_values": _action_values,
    "greedy_map": _greedy_map,
    "overestimation": _overestimation,
}
