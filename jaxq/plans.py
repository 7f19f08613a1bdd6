"""Plans: axes become settings, settings times seeds become lanes. Imports no jax."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from jaxq import axes, requests, worlds
from jaxq.axes import SAMPLES, Axis
from jaxq.families import FAMILIES
from jaxq.presets import preset, settle
from jaxq.requests import Request, twice, whole
from jaxq.settings import NO_LIMIT, Settings, shown
from jaxq.suggest import nearest

MAX_SEED = 2**32 - 1
MAX_SEEDS = 10_000_000


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
    seed: int = 0,
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

    A value that is a list, an array or a ``Range`` is an axis, any other holds for all settings; ``seed`` is the root
    of all randomness. ``method`` is "grid", the product of all lists; "random" or "sobol", ``samples`` points of lists
    and ranges; or "list", ``settings``, each a mapping of values, which go before those that hold for all. Without one
    it is what fits: "list" with ``settings``, "sobol" with a range, else "grid". ``env`` is an environment's name or a
    function of numbers that makes one, and ``**{"env.length": [0.25, 0.5]}`` an axis of it. ``halving`` and ``rungs``:
    see ``jaxq.halving``.

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
        seed=seed,
        prng=base.prng if prng is None else prng,
        method=method,
        samples=samples,
        settings=settings,
        halving=halving,
        rungs=rungs,
    )
    worlds.check(one.env for one in made.settings)
    if halving is not None and any(min(one.max_env_steps, one.max_episodes) >= NO_LIMIT for one in made.settings):
        raise ValueError(f"halving: {halving} is not allowed without a limit, max_env_steps or max_episodes")
    return made


def make(
    name: str,
    settled: Callable[..., Settings],
    values: Mapping[str, Any],
    *,
    seeds: int,
    seed: int,
    prng: str,
    method: str | None,
    samples: int | None,
    settings: Sequence[Mapping[str, Any]] | None,
    halving: int | None = None,
    rungs: int | None = None,
) -> Plan:
    """The plan of any kind of settings, which ``settled`` makes of values by name. Raises ValueError as ``plan``."""
    if prng not in FAMILIES:
        raise ValueError(f"prng: {prng!r} is unknown{nearest(str(prng), FAMILIES)}")
    whole("seeds", seeds, 1, MAX_SEEDS)
    whole("seed", seed, 0, MAX_SEED)
    if halving is not None:
        whole("halving", halving, 2, 1000)
    if rungs is not None:
        whole("rungs", rungs, 1, 100)
        if halving is None:
            raise ValueError(f"rungs: {rungs} is not allowed without halving")
    request = requests.request(settled, values, method, samples, settings)
    if request.method == "list":
        wanted = [{**request.fixed, **one} for one in request.listed]
    else:
        wanted = axes.points({**_lists(request.fixed), **request.axes}, request.method, samples or SAMPLES, seed)
    made = tuple(settled(**point) for point in wanted)
    flat = [one.flat() for one in made]
    for i, j in twice([tuple(one.items()) for one in flat]):
        raise ValueError(f"settings: number {i} and number {j} are the same")
    if halving is not None and halving > len(made):
        raise ValueError(f"halving: {halving} is not allowed: at most as many as there are settings, {len(made)}")
    order = [*request.axes, *(name for one in request.listed for name in one)]
    differing = [name for name in flat[0] if any(row.get(name) != flat[0][name] for row in flat)]
    varied = tuple(sorted(differing, key=lambda name: order.index(name) if name in order else len(order)))
    return Plan(name, made, varied, tuple(range(seeds)), seed, prng, halving, rungs, request)


def _lists(fixed: Mapping[str, Any]) -> dict[str, Axis]:
    return {name: [value] for name, value in fixed.items()}


def _json(row: Mapping[str, Any]) -> dict[str, Any]:
    return {name: list(value) if isinstance(value, tuple) else value for name, value in row.items()}
