"""Sweep files: a plan as TOML, read and written. Imports no jax.

::

    preset = "dqn"
    seeds = 16
    method = "sobol"        # grid, random, sobol; or list, with [[settings]]
    samples = 64
    [parameters]
    gamma = 0.99            # the same for all
    hidden.values = [[64, 64], [128, 128]]
    [parameters.learning_rate]
    min = 1e-4
    max = 1e-2
    scale = "log"
    [parameters.env.length]
    values = [0.25, 0.5]
"""

from __future__ import annotations

import tomllib
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import tomli_w

from jaxq.axes import Range
from jaxq.plans import Plan, plan
from jaxq.presets import Training
from jaxq.suggest import nearest
from jaxq.worlds import World

#: The keys of a file, with the names that ``plan`` has for them.
_KEYS = {
    "preset": "name",
    "seeds": "seeds",
    "seed": "seed",
    "prng": "prng",
    "env": "env",
    "method": "method",
    "samples": "samples",
    "halving": "halving",
    "rungs": "rungs",
    "settings": "settings",
}


def read(path: Path) -> dict[str, Any]:
    """What a file asks for, as the arguments of ``plan``, the preset as ``name``.

    Raises ValueError, which names the file and the key, for one that cannot be read or says what no sweep has.
    """
    try:
        found = tomllib.loads(path.read_text(encoding="utf-8-sig"))
    except OSError as error:
        raise ValueError(f"{path}: {error.strerror}") from None
    except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
        raise ValueError(f"{path}: is not TOML: {error}") from None
    try:
        return _arguments(found)
    except ValueError as error:
        raise _named_after(path, error) from None


def text(planned: Plan) -> str:
    """The file of a plan, which reads as the same plan.

    Raises ValueError for a plan that no file can say: of a function of the user's own, or one lane of another sweep.
    """
    request = planned.request
    preset = isinstance(planned.settings[0], Training)
    if not preset or request is None or planned.seeds != tuple(range(len(planned.seeds))):
        raise ValueError(f"{planned.name}: is not what a file can say")
    found: dict[str, Any] = {
        "preset": planned.name,
        "seeds": len(planned.seeds),
        "seed": planned.root_seed,
        "prng": planned.prng,
        "method": request.method,
    }
    if request.samples is not None:
        found["samples"] = request.samples
    for name in ("halving", "rungs"):
        if (value := getattr(planned, name)) is not None:
            found[name] = value
    parameters: dict[str, Any] = {}
    for name, axis in request.axes.items():  # first, and in their order, which is that of the settings
        if isinstance(axis, Range):
            _put(parameters, name, {"min": axis.min, "max": axis.max, "scale": axis.scale}, in_order=True)
        else:
            _put(parameters, name, {"values": [_plain(value) for value in axis]}, in_order=True)
    for name, value in request.fixed.items():
        if isinstance(value, World):
            if value.factory is not None:
                raise ValueError(f"env: {value} is a function, which no file can hold")
            found["env"] = value.id
        else:
            _put(parameters, name, _plain(value), in_order=False)
    if request.listed:
        found["settings"] = [{name: _plain(value) for name, value in one.items()} for one in request.listed]
    return tomli_w.dumps(found | ({"parameters": parameters} if parameters else {}))


def _arguments(found: Mapping[str, Any]) -> dict[str, Any]:
    for key in found:
        if key not in (*_KEYS, "parameters"):
            raise ValueError(f"{key!r} is no key of a sweep{nearest(key, [*_KEYS, 'parameters'])}")
    if not isinstance(found.get("preset"), str):
        raise ValueError("preset: must be named, as in preset = 'dqn'")
    parameters, listed = found.get("parameters", {}), found.get("settings")
    if not isinstance(parameters, dict):
        raise ValueError("parameters: must be a table, as in [parameters]")
    asked = {_KEYS[key]: value for key, value in found.items() if key in _KEYS}
    if listed is not None:
        if not isinstance(listed, list) or not all(isinstance(one, dict) for one in listed):
            raise ValueError("settings: must be tables, as in [[settings]]")
        asked["settings"] = [{name: _tuple(value) for name, value in _named(one).items()} for one in listed]
    return asked | {name: _axis(name, value) for name, value in _named(parameters).items()}


def _named(table: Mapping[str, Any]) -> dict[str, Any]:
    """Values by name; those in a table ``env`` by their dotted names."""
    named: dict[str, Any] = {}
    for name, value in table.items():
        if name == "env" and isinstance(value, dict):
            named |= {f"env.{inner}": below for inner, below in value.items()}
        else:
            named[name] = value
    taken = [name for name in named if name in {*_KEYS.values()} - {"env"}]
    if taken:
        raise ValueError(f"{taken[0]}: is no parameter: it stands above them")
    return named


def _axis(name: str, value: Any) -> Any:
    if not isinstance(value, dict):
        return _tuple(value)
    if set(value) == {"values"} and isinstance(value["values"], list):
        return [_tuple(one) for one in value["values"]]
    if {"min", "max"} <= set(value) <= {"min", "max", "scale"}:
        try:
            return Range(**value)
        except ValueError as error:
            raise ValueError(f"{name}: {error}") from None
    raise ValueError(f"{name}: {value} is not allowed: values, or min and max with a scale")


def _tuple(value: Any) -> Any:
    return tuple(value) if isinstance(value, list) else value


def _plain(value: Any) -> Any:
    if value is None:
        return "none"  # TOML has no null
    return list(value) if isinstance(value, tuple) else value


def _put(table: dict[str, Any], name: str, value: Any, in_order: bool) -> None:
    """``env.length`` stands in a table ``env``; in quotation marks, where it would come before another axis there."""
    above, _, inner = name.partition(".")
    if not inner or (in_order and above in table and above != next(reversed(table))):
        table[name] = value
    else:
        table.setdefault(above, {})[inner] = value


def load(path: Path) -> Plan:
    """The plan of a file. Raises ValueError."""
    asked = read(path)
    try:
        return plan(**asked)
    except (ValueError, TypeError) as error:
        raise _named_after(path, error) from None


def _named_after(path: Path, error: Exception) -> ValueError:
    """The error in one line, whatever words of the file it repeats."""
    return ValueError(f"{path}: {' '.join(str(error).split())}")
