"""Requests: what a sweep was asked for, every value checked, before it becomes settings. Imports no jax."""

from __future__ import annotations

import struct
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

from jaxq import axes
from jaxq.axes import METHODS, Axis, Range
from jaxq.settings import Settings, is_number, shown
from jaxq.suggest import nearest

MAX_SAMPLES = axes.MAX_SETTINGS


@dataclass(frozen=True)
class Request:
    """What was asked for, before it became settings: what a sweep file holds.

    ``fixed`` are values that all settings share, ``axes`` those that vary; ``listed`` are the settings of the method
    ``list``. All values are those of the settings, checked.
    """

    method: str
    fixed: dict[str, Any] = field(default_factory=dict)
    axes: dict[str, Axis] = field(default_factory=dict)
    samples: int | None = None
    listed: tuple[dict[str, Any], ...] = ()


def request(
    settled: Callable[..., Settings],
    values: Mapping[str, Any],
    method: str | None,
    samples: int | None,
    settings: Sequence[Mapping[str, Any]] | None,
) -> Request:
    """The request, with every value as the settings that ``settled`` makes have it.

    A list, a NumPy array of one dimension, a ``range`` and a ``Range`` are axes. Raises ValueError that names the
    field, the value and what is allowed.
    """
    given = {name: axis(value) for name, value in values.items()}
    if method is None:
        ranges = any(isinstance(axis, Range) for axis in given.values())
        method = "list" if settings is not None else "sobol" if ranges else "grid"
    _check_method(method, samples, settings)
    env = given.get("env")
    fields = settled(**({"env": env[0]} if env and not isinstance(env, Range) else {})).fields()
    first = {}
    for name, points in given.items():
        if not isinstance(points, Range) and not points:
            raise ValueError(f"{name}: [] is not allowed: at least one value")
        if isinstance(points, Range) and name in fields and not is_number(fields[name]):
            raise ValueError(f"{name}: {points.min}:{points.max} is not allowed: it takes no range, but values")
        first[name] = points.at(0.5) if isinstance(points, Range) else points[0]

    def checked(name: str, value: Any) -> Any:
        one = settled(**{**first, name: value})
        return getattr(one, name) if name == "env" else one.flat()[name]

    fixed: dict[str, Any] = {}
    varying: dict[str, Axis] = {}
    for name, points in given.items():
        if isinstance(points, Range):
            varying[name] = _in_range(name, points, checked)
            continue
        found = [checked(name, value) for value in points]
        for _, j in twice(found):
            raise ValueError(f"{name}: {shown(found[j])} stands twice")
        if len(found) == 1:
            fixed[name] = found[0]
        else:
            varying[name] = found
    listed = []
    for one in settings or ():
        for name in one:
            if name == "env":
                raise ValueError("env: is the same for all settings; give it beside them")
        made = settled(**{**first, **one}).flat()
        listed.append({name: made[name] for name in one})
    if method == "list" and varying:
        raise ValueError(f"{next(iter(varying))}: an axis is not allowed beside settings")
    return Request(method, fixed, varying, samples, tuple(listed))


def axis(value: Any) -> Axis:
    """The values of an argument: a list's, an array's, a ``range``'s, a ``Range``, or the one value that it is."""
    if isinstance(value, (list, Range)):
        return value
    if isinstance(value, range) or (hasattr(value, "tolist") and getattr(value, "ndim", None) == 1):
        return [getattr(one, "item", lambda one=one: one)() for one in value]
    return [value]


def _in_range(name: str, asked: Range, checked: Callable[[str, Any], Any]) -> Range:
    """The range in numbers of the kind that the field holds; both ends must be allowed."""
    kinds = set()
    for end in (asked.min, asked.max):
        value = checked(name, end)
        if isinstance(value, int) and not isinstance(end, int):
            raise ValueError(f"{name}: {end} is not allowed: a whole number")
        kinds.add(type(value))
    # 0:1 of a real number is not the whole numbers 0 and 1.
    return asked if kinds == {int} else Range(float(asked.min), float(asked.max), asked.scale)


def twice(values: Sequence[Any]) -> list[tuple[int, int]]:
    """The first pair of equal values, if any; numbers are float32 in the program."""
    seen: dict[str, int] = {}
    for i, value in enumerate(values):
        if (before := seen.setdefault(str(_float32(value)), i)) != i:
            return [(before, i)]
    return []


def _float32(value: Any) -> Any:
    if isinstance(value, tuple):
        return tuple(map(_float32, value))
    return struct.unpack("f", struct.pack("f", value))[0] if isinstance(value, float) else value


def _check_method(method: str, samples: int | None, settings: Any) -> None:
    if method not in METHODS:
        raise ValueError(f"method: {method!r} is unknown{nearest(str(method), METHODS)}")
    if samples is not None:
        whole("samples", samples, 1, MAX_SAMPLES)
        if method not in ("random", "sobol"):
            raise ValueError(f"samples: {samples} is not allowed with the method {method}, which draws none")
    if (method == "list") != (settings is not None):
        raise ValueError("settings: the method list needs them, and no other method takes them")
    listed = isinstance(settings, Sequence) and all(isinstance(one, Mapping) for one in settings)
    if settings is not None and not (settings and listed):
        raise ValueError(f"settings: {settings!r} is not allowed: at least one, each a mapping of values")


def whole(name: str, value: Any, low: int, high: int) -> None:
    """Raises ValueError for what is no whole number from ``low`` to ``high``."""
    if isinstance(value, bool) or not isinstance(value, int) or not low <= value <= high:
        raise ValueError(f"{name}: {value!r} is not allowed: an integer from {low} to {high}")
