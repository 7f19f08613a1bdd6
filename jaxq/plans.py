"""Plans: axes become settings, settings times seeds become lanes. Imports no jax."""

from __future__ import annotations

import hashlib
import itertools
import json
from collections import Counter
from dataclasses import dataclass
from typing import Any

from jaxq.families import FAMILIES
from jaxq.presets import Preset, Settings, preset, settle
from jaxq.suggest import nearest

MAX_SEED = 2**32 - 1
MAX_SEEDS = 10_000_000


@dataclass(frozen=True)
class Plan:
    """What a sweep will do. ``settings[i]`` is setting i; ``varied`` names the axes; seeds are 0 .. seeds - 1."""

    preset: Preset
    settings: tuple[Settings, ...]
    varied: tuple[str, ...]
    seeds: tuple[int, ...]
    root_seed: int
    prng: str

    @property
    def lanes(self) -> int:
        """How many trainings that makes."""
        return len(self.settings) * len(self.seeds)

    @property
    def programs(self) -> int:
        """How many programs will be compiled: one per distinct structure."""
        return len({one.structural() for one in self.settings})

    def spec(self) -> dict[str, Any]:
        """What identifies the sweep, as JSON values."""
        return {
            "preset": self.preset.name,
            "settings": [one.model_dump(mode="json") for one in self.settings],
            "varied": list(self.varied),
            "seeds": len(self.seeds),
            "root_seed": self.root_seed,
            "prng": self.prng,
        }

    def hash(self) -> str:
        """SHA-256 of the spec's canonical JSON."""
        return hashlib.sha256(json.dumps(self.spec(), sort_keys=True, separators=(",", ":")).encode()).hexdigest()

    def default_name(self) -> str:
        """The preset and the first characters of the spec's hash."""
        return f"{self.preset.name}-{self.hash()[:8]}"


def plan(name: str, *, seeds: int = 1, root_seed: int = 0, prng: str | None = None, **values: Any) -> Plan:
    """The grid over every value that is a list: its product, the last axis fastest.

    Raises ValueError that names the field, the value and what is allowed.
    """
    base = preset(name)
    family = base.prng if prng is None else prng
    if family not in FAMILIES:
        raise ValueError(f"prng: {family!r} is unknown{nearest(family, FAMILIES)}")
    if isinstance(seeds, bool) or not isinstance(seeds, int) or not 1 <= seeds <= MAX_SEEDS:
        raise ValueError(f"seeds: {seeds!r} is not allowed: an integer from 1 to {MAX_SEEDS}")
    if isinstance(root_seed, bool) or not isinstance(root_seed, int) or not 0 <= root_seed <= MAX_SEED:
        raise ValueError(f"seed: {root_seed!r} is not allowed: an integer from 0 to {MAX_SEED}")
    axes = {field: value if isinstance(value, list) else [value] for field, value in values.items()}
    for axis, points in axes.items():
        if not points:
            raise ValueError(f"{axis}: [] is not allowed: at least one value")
    settings = tuple(settle(base, **dict(zip(axes, point, strict=True))) for point in itertools.product(*axes.values()))
    for axis, points in axes.items():
        first = {name: values[0] for name, values in axes.items()}
        counts = Counter(getattr(settle(base, **first | {axis: point}), axis) for point in points)
        value, times = counts.most_common(1)[0]
        if times > 1:
            raise ValueError(f"{axis}: {value} stands twice")
    varied = tuple(axis for axis, points in axes.items() if len(points) > 1)
    return Plan(base, settings, varied, tuple(range(seeds)), root_seed, family)
