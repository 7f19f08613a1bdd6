"""Pictures of an outcome by their kind."""

from __future__ import annotations

import inspect
from collections.abc import Callable, Sequence
from typing import Any, Protocol

import pyarrow as pa

from jaxq import pictures, replayed, summaries
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


def draw(outcome: Swept, kind: str | None = None, **options: Any) -> Any:
    """A matplotlib Figure of one kind, by default ``curves``, of a function's results ``spread``.

    ``curves``, ``survival`` and ``spread`` show every setting; ``sensitivity`` one ``axis`` and ``heat_map`` two, ``x``
    and ``y``; ``action_values``, ``greedy_map`` and ``overestimation`` the policy of one lane, by ``config`` and
    ``seed``. A ``metric`` is a column of numbers, by default the greedy return, of a function the first number that it
    returned. Raises ValueError for a kind, an option or an axis that is unknown or missing, and a lane without a
    policy.
    """
    own = summaries.outputs(outcome.lanes) is not None
    known = list(OF_FUNCTIONS if own else KINDS)
    kind = known[0] if kind is None else kind
    if kind not in KINDS:
        raise ValueError(f"kind: {kind!r} is unknown{nearest(str(kind), known)}")
    if kind not in known:
        raise ValueError(f"kind: {kind!r} is a picture of trainings; of a function's results: {', '.join(known)}")
    _check(outcome, kind, options)
    return KINDS[kind](outcome, **options)


def _check(outcome: Swept, kind: str, options: dict[str, Any]) -> None:
    """Raises ValueError for options that this kind does not take, or lacks, and for no hyperparameter."""
    _, *parameters = inspect.signature(KINDS[kind]).parameters.values()
    taken = [one.name for one in parameters]
    for name in options:
        if name not in taken:
            allowed = f"no option {name!r}{nearest(name, taken)}" if taken else "no options"
            raise ValueError(f"{name}: {kind!r} takes {allowed}")
    axes = outcome.varied or list(outcome.spec["common"])
    for one in parameters:
        if one.default is one.empty and one.name not in options:
            raise ValueError(f"{one.name}: a hyperparameter is needed: one of {', '.join(axes)}")
    for name in AXES:
        if name in options and options[name] not in (*outcome.spec["common"], *axes):
            raise ValueError(f"{name}: {options[name]!r} is no hyperparameter{nearest(str(options[name]), axes)}")


def _metric(outcome: Swept, metric: str | None) -> str:
    """The metric that is meant. Raises ValueError for a function that returned no number."""
    if metric is not None:
        return metric
    found = summaries.outputs(outcome.lanes)
    if found is None:
        return "eval_return"
    if not found:
        raise ValueError("metric: the function returned no number that could be drawn")
    return found[0]


def labels(outcome: Swept) -> dict[int, str]:
    """What the settings are called in a legend."""
    return {config: outcome.label(config) for config in range(len(outcome.spec["settings"]))}


def _curves(outcome: Swept) -> Any:
    curves = outcome.table("curves", ["train_return", "eval_return"])
    return pictures.learning_curves(outcome.lanes, curves, labels(outcome))


def _survival(outcome: Swept, clock: str = "env_steps") -> Any:
    return pictures.survival(outcome.lanes, labels(outcome), clock=clock)


def _spread(outcome: Swept, metric: str | None = None) -> Any:
    return pictures.spread(outcome.lanes, labels(outcome), metric=_metric(outcome, metric))


def _sensitivity(outcome: Swept, axis: str, metric: str | None = None) -> Any:
    return pictures.sensitivity(outcome.lanes, axis, outcome.varied, metric=_metric(outcome, metric))


def _heat_map(outcome: Swept, x: str, y: str, metric: str | None = None) -> Any:
    return pictures.heat_map(outcome.lanes, x, y, metric=_metric(outcome, metric))


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


#: Options that name a hyperparameter.
AXES = ("axis", "x", "y")
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
#: Those that show what a function of the user's own returned.
OF_FUNCTIONS = ("spread", "sensitivity", "heat_map")
