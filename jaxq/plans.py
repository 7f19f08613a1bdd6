"""Plans: axes become settings, settings times seeds become lanes. Imports no jax."""

from __future__ import annotations

import hashlib
import json
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

from jaxq import axes, worlds
from jaxq.axes import METHODS, SAMPLES, Axis, Range
from jaxq.families import FAMILIES
from jaxq.presets import preset, settle
from jaxq.settings import NO_LIMIT, Settings, shown
from jaxq.suggest import nearest

MAX_SEED = 2**32 - 1
MAX_SEEDS = 10_000_000
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


@dataclass(frozen=True)
class Plan:
    """What a sweep will do. ``settings[i]`` is setting i; ``varied`` names what differs between them.

    ``seeds`` are seed indices, ``halving`` the factor of successive halving, None without, and ``rungs`` how many rungs
    it has at most.
    """

    name: str
    settings: tuple[Any, ...]
    varied: tuple[str, ...]
    seeds: tuple[int, ...]
    root_seed: int
    prng: str
    halving: int | None = None
    rungs: int | None = None
    request: Request | None = None

    @property
    def lanes(self) -> int:
        """How many trainings that makes."""
        return len(self.settings) * len(self.seeds)

    @property
    def programs(self) -> int:
        """How many programs will be compiled: one per distinct structure."""
        return len({one.structural() for one in self.settings})

    def label(self, config: int) -> str:
        """What tells a setting from the others; "" where nothing varies."""
        values = self.settings[config].flat()
        return ", ".join(f"{name} {shown(values[name])}" for name in self.varied)

    def spec(self) -> dict[str, Any]:
        """What identifies the sweep, as JSON values: what all settings share, and what varies of each."""
        rows = [_json(one.flat()) for one in self.settings]
        count = len(self.seeds)
        world = getattr(self.settings[0], "env", None)
        source = getattr(self.settings[0], "source", None) or getattr(world, "source", None)
        return {
            "preset": self.name,
            "common": {name: value for name, value in rows[0].items() if name not in self.varied},
            "varied": list(self.varied),
            "settings": [[row[name] for name in self.varied] for row in rows],
            "seeds": count if self.seeds == tuple(range(count)) else list(self.seeds),
            "root_seed": self.root_seed,
            "prng": self.prng,
            "halving": self.halving,
            "rungs": self.rungs,
            "threshold": getattr(world, "reward_threshold", None),
            "source": source,
        }

    def hash(self) -> str:
        """SHA-256 of the spec's canonical JSON."""
        return spec_hash(self.spec())

    def default_name(self) -> str:
        """The preset and the first characters of the spec's hash."""
        return f"{self.name}-{self.hash()[:8]}"


def spec_hash(spec: Mapping[str, Any]) -> str:
    """SHA-256 of a spec's canonical JSON."""
    return hashlib.sha256(json.dumps(spec, sort_keys=True, separators=(",", ":")).encode()).hexdigest()


def plan(
    name: str,
    *,
    seeds: int = 1,
    root_seed: int = 0,
    prng: str | None = None,
    method: str | None = None,
    samples: int | None = None,
    settings: Sequence[Mapping[str, Any]] | None = None,
    halving: int | None = None,
    rungs: int | None = None,
    env: str | Callable[..., Any] | None = None,
    **values: Any,
) -> Plan:
    """The settings of a preset that the axes make, times ``seeds`` seeds.

    A value that is a list or a ``Range`` is an axis, any other holds for all settings. ``method`` is "grid", the
    product of all lists; "random" or "sobol", ``samples`` points of lists and ranges; or "list", ``settings``, each a
    mapping of values. Without one it is what fits: "list" with ``settings``, "sobol" with a range, else "grid".
    ``env`` is an environment's name or a function of numbers that makes one, and ``**{"env.length": [0.25, 0.5]}`` an
    axis of it. ``halving`` and ``rungs``: see ``jaxq.halving``.

    Raises ValueError that names the field, the value and what is allowed.
    """
    base = preset(name)
    if env is not None:
        world = worlds.world(env)
        plain = type(world)()
        own = {f"env.{name}": value for name, value in world if value != getattr(plain, name)}
        values = {"env": plain, **own, **values}
    made = make(
        base.name,
        lambda **point: settle(base, **point),
        values,
        seeds=seeds,
        root_seed=root_seed,
        prng=base.prng if prng is None else prng,
        method=method,
        samples=samples,
        settings=settings,
        halving=halving,
        rungs=rungs,
    )
    if halving is not None and any(min(one.max_env_steps, one.max_episodes) >= NO_LIMIT for one in made.settings):
        raise ValueError(f"halving: {halving} is not allowed without a limit, max_env_steps or max_episodes")
    return made


def make(
    name: str,
    settled: Callable[..., Settings],
    values: Mapping[str, Any],
    *,
    seeds: int,
    root_seed: int,
    prng: str,
    method: str | None,
    samples: int | None,
    settings: Sequence[Mapping[str, Any]] | None,
    halving: int | None = None,
    rungs: int | None = None,
) -> Plan:
    """The plan of any kind of settings, which ``settled`` makes of values by name. Raises ValueError as ``plan``."""
    given = {field: value if isinstance(value, (list, Range)) else [value] for field, value in values.items()}
    if method is None:
        ranges = any(isinstance(axis, Range) for axis in given.values())
        method = "list" if settings is not None else "sobol" if ranges else "grid"
    if prng not in FAMILIES:
        raise ValueError(f"prng: {prng!r} is unknown{nearest(str(prng), FAMILIES)}")
    _whole("seeds", seeds, 1, MAX_SEEDS)
    _whole("seed", root_seed, 0, MAX_SEED)
    if halving is not None:
        _whole("halving", halving, 2, 1000)
    if rungs is not None:
        _whole("rungs", rungs, 1, 100)
        if halving is None:
            raise ValueError(f"rungs: {rungs} is not allowed without halving")
    _check_method(method, samples, settings)
    request = _request(settled, method, samples, settings, given)
    if method == "list":
        wanted = [{**request.fixed, **one} for one in request.listed]
    else:
        wanted = axes.points({**_lists(request.fixed), **request.axes}, method, samples or SAMPLES, root_seed)
    made = tuple(settled(**point) for point in wanted)
    flat = [one.flat() for one in made]
    for i, j in _twice([tuple(one.items()) for one in flat]):
        raise ValueError(f"settings: number {i} and number {j} are the same")
    if halving is not None and halving > len(made):
        raise ValueError(f"halving: {halving} is not allowed: at most as many as there are settings, {len(made)}")
    order = [*request.axes, *(name for one in request.listed for name in one)]
    differing = [name for name in flat[0] if any(row.get(name) != flat[0][name] for row in flat)]
    varied = tuple(sorted(differing, key=lambda name: order.index(name) if name in order else len(order)))
    return Plan(name, made, varied, tuple(range(seeds)), root_seed, prng, halving, rungs, request)


def _whole(name: str, value: Any, low: int, high: int) -> None:
    if isinstance(value, bool) or not isinstance(value, int) or not low <= value <= high:
        raise ValueError(f"{name}: {value!r} is not allowed: an integer from {low} to {high}")


def _check_method(method: str, samples: int | None, settings: Any) -> None:
    if method not in METHODS:
        raise ValueError(f"method: {method!r} is unknown{nearest(str(method), METHODS)}")
    if samples is not None:
        _whole("samples", samples, 1, MAX_SAMPLES)
        if method not in ("random", "sobol"):
            raise ValueError(f"samples: {samples} is not allowed with the method {method}, which draws none")
    if (method == "list") != (settings is not None):
        raise ValueError("settings: the method list needs them, and no other method takes them")
    listed = isinstance(settings, Sequence) and all(isinstance(one, Mapping) for one in settings)
    if settings is not None and not (settings and listed):
        raise ValueError(f"settings: {settings!r} is not allowed: at least one, each a mapping of values")


def _request(
    settled: Callable[..., Settings],
    method: str,
    samples: int | None,
    settings: Sequence[Mapping[str, Any]] | None,
    given: dict[str, Any],
) -> Request:
    """The request with every value as the settings have it. Raises ValueError for a value that is not allowed, too."""
    first = {}
    for name, axis in given.items():
        if not isinstance(axis, Range) and not axis:
            raise ValueError(f"{name}: [] is not allowed: at least one value")
        first[name] = _middle(axis) if isinstance(axis, Range) else axis[0]

    def checked(name: str, value: Any) -> Any:
        one = settled(**{**first, name: value})
        return getattr(one, name) if name == "env" else one.flat()[name]

    fixed: dict[str, Any] = {}
    varying: dict[str, Axis] = {}
    for name, axis in given.items():
        if isinstance(axis, Range):
            varying[name] = _in_range(name, axis, checked)
            continue
        values = [checked(name, value) for value in axis]
        for i, j in _twice(values):
            del i
            raise ValueError(f"{name}: {shown(values[j])} stands twice")
        if len(values) == 1:
            fixed[name] = values[0]
        else:
            varying[name] = values
    listed = []
    for one in settings or ():
        for name in one:
            if name == "env":
                raise ValueError("env: is the same for all settings; give it beside them")
            if name in given:
                raise ValueError(f"{name}: stands beside the settings and in one of them")
        made = settled(**{**first, **one}).flat()
        listed.append({name: made[name] for name in one})
    if method == "list" and varying:
        raise ValueError(f"{next(iter(varying))}: an axis is not allowed beside settings")
    return Request(method, fixed, varying, samples, tuple(listed))


def _middle(axis: Range) -> Any:
    return axis.at(0.5)


def _in_range(name: str, axis: Range, checked: Callable[[str, Any], Any]) -> Range:
    """The range in numbers of the kind that the field holds; both ends must be allowed."""
    kinds = set()
    for end in (axis.min, axis.max):
        value = checked(name, end)
        if isinstance(value, bool) or not isinstance(value, (int, float)):
            raise ValueError(f"{name}: a range is not allowed: give its values")
        if isinstance(value, int) and not isinstance(end, int):
            raise ValueError(f"{name}: {end} is not allowed: a whole number")
        kinds.add(type(value))
    # 0:1 of a real number is not the whole numbers 0 and 1.
    return axis if kinds == {int} else Range(float(axis.min), float(axis.max), axis.scale)


def _twice(values: Sequence[Any]) -> list[tuple[int, int]]:
    """The first pair of equal values, if any."""
    counts = Counter(map(str, values))
    if counts and counts.most_common(1)[0][1] > 1:
        text = counts.most_common(1)[0][0]
        first, second, *_ = (i for i, value in enumerate(values) if str(value) == text)
        return [(first, second)]
    return []


def _lists(fixed: Mapping[str, Any]) -> dict[str, Axis]:
    return {name: [value] for name, value in fixed.items()}


def _json(row: Mapping[str, Any]) -> dict[str, Any]:
    return {name: list(value) if isinstance(value, tuple) else value for name, value in row.items()}
