"""What a sweep came to: its tables, its summary, its pictures, from memory or from a run directory."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa

from jaxq import manifest, parts, run_files, saved_policy, sources, summaries, tables, worlds
from jaxq.manifest import RunError
from jaxq.presets import preset, presets, settle
from jaxq.saved_policy import SavedPolicy
from jaxq.settings import shown
from jaxq.shared import Progress
from jaxq.store import Readable
from jaxq.summaries import Row
from jaxq.worlds import WORLDS, World


@dataclass
class Timing:
    """Where the time went, and how much was done."""

    compile_s: float = 0.0
    run_s: float = 0.0
    env_steps: int = 0
    updates: int = 0
    programs: int = 0
    cached: int = 0  # of these programs, how many were not compiled because a cache held all of them
    pending_s: float = 0.0  # workers' seconds while lanes were waiting for a slot
    useful_s: float = 0.0  # those of them in which slots advanced their lanes
    tail_s: float = 0.0  # from the last lane's start to the end

    def book(self, progress: Progress) -> None:
        """Adds what one program's engine says at its end."""
        self.pending_s += progress.pending_s
        self.useful_s += progress.useful_s
        if progress.queue_empty is not None:
            self.tail_s += time.monotonic() - progress.queue_empty

    def rows(self) -> Row:
        """The ``timing`` of the JSON output."""
        seconds = max(self.run_s, 1e-9)
        return {
            "compile_s": round(self.compile_s, 3),
            "run_s": round(self.run_s, 3),
            "env_steps_per_s": round(self.env_steps / seconds),
            "updates_per_s": round(self.updates / seconds),
            "programs": self.programs,
            "cached": self.cached,
            "useful_share": round(self.useful_s / self.pending_s, 3) if self.pending_s else None,
            "tail_s": round(self.tail_s, 3),
        }


@dataclass
class Outcome:
    """The results of a sweep; ``spec`` is what identifies it (``Plan.spec``), and ``world`` its environment where that
    is one of the user's own and at hand.
    """

    spec: dict[str, Any]
    store: Readable
    timing: Timing = field(default_factory=Timing)
    world: World | None = None

    @property
    def varied(self) -> list[str]:
        """The hyperparameters that differ between settings."""
        return list(self.spec["varied"])

    @property
    def threshold(self) -> float | None:
        """The mean return at which the environment counts as solved."""
        return self.spec.get("threshold")

    def table(self, kind: str, columns: Sequence[str] | None = None) -> pa.Table:
        """``lanes``, ``curves`` or ``episodes``, or some of its columns, sorted by setting, seed and time."""
        found = self.store.table(kind, columns)
        schemas = {"lanes": pa.schema(tables.KEY), "curves": tables.CURVES, "episodes": tables.EPISODES}
        return schemas[kind].empty_table() if found is None else found

    @cached_property
    def lanes(self) -> pa.Table:
        """A row per training that ended, sorted by setting and seed."""
        return self.table("lanes")

    @property
    def curves(self) -> pa.Table:
        """A row per training and segment."""
        return self.table("curves")

    @property
    def episodes(self) -> pa.Table:
        """A row per training episode, where they were kept."""
        return self.table("episodes")

    @property
    def complete(self) -> bool:
        """Whether every training has a row."""
        lanes = self.table("lanes", ["config", "seed"])
        return len(lanes) >= len(self.spec["settings"]) * len(manifest.seeds_of(self.spec))

    @cached_property
    def _summary(self) -> list[Row]:
        return summaries.summary(self.lanes, self.varied, self.threshold)

    def summary(self) -> list[Row]:
        """One row per setting: see ``summaries.summary``."""
        return list(self._summary)

    def best(self, metric: str | None = None) -> Row:
        """The summary's row of the setting with the greatest ``metric``: see ``summaries.best``. Raises ValueError with
        one seed.
        """
        return summaries.best(self._summary, metric)

    def label(self, config: int) -> str:
        """What tells a setting from the others, or the preset's name where nothing varies."""
        values = self.spec["settings"][config]
        pairs = zip(self.spec["varied"], values, strict=True)
        named = ", ".join(f"{name} {shown(tuple(v) if isinstance(v, list) else v)}" for name, v in pairs)
        return named or str(self.spec["preset"])

    def settings(self, config: int) -> Any:
        """The settings of one setting's index.

        Raises ValueError for an index that there is none of, for a sweep of a function of the user's own, and for an
        environment of the user's own that is not at hand: see ``load``.
        """
        count = len(self.spec["settings"])
        if not 0 <= config < count:
            raise ValueError(f"config: {config} is not allowed: from 0 to {count - 1}")
        values = self.spec["common"] | dict(zip(self.spec["varied"], self.spec["settings"][config], strict=True))
        given = {name: tuple(value) if isinstance(value, list) else value for name, value in values.items()}
        held = "a function of your own, which no directory holds"
        if "env" not in given or self.spec["preset"] not in [known.name for known in presets()]:
            raise ValueError(f"preset: this run was made with {self.spec['preset']!r}, {held}")
        if given["env"] not in WORLDS:
            if self.world is None:
                where = "give it, as --env MODULE:FUNCTION or jaxq.load(DIR, env=...)"
                raise ValueError(f"env: this run was made with {given['env']!r}, {held}: {where}")
            given["env"] = self.world
        return settle(preset(self.spec["preset"]), **given)

    def policy(self, config: int, seed: int = 0) -> SavedPolicy:
        """A training's final policy, played with NumPy. Raises ValueError where none was kept."""
        weights, about = self.store.policy(config, seed)
        return saved_policy.load(weights, about, config, seed)

    def plot(self, kind: str | None = None, **options: Any) -> Any:
        """A picture as a matplotlib Figure: see ``drawing.draw`` for the kinds and their options."""
        from jaxq import drawing

        return drawing.draw(self, kind, **options)

    def record(self, path: str | Path, config: int = 0, seed: int = 0, **options: Any) -> list[float]:
        """Writes a film of greedy episodes, ``FILE.gif`` or ``FILE.mp4``, and returns what they returned: see
        ``recording.record`` for the options, ``episodes``, ``max_steps`` and ``fps``.
        """
        from jaxq import recording

        return recording.record(self, Path(path), config, seed, **options)

    def __str__(self) -> str:
        from jaxq import report

        return report.settings_table(self._summary, self.varied)


class StoredRun:
    """A run directory that is only read."""

    def __init__(self, path: Path):
        self.path = path
        if not (path / run_files.MANIFEST).exists():
            raise RunError(f"{path}: holds no run")
        self.manifest = manifest.read(path / run_files.MANIFEST)
        for name, digest in self.manifest["files"].items():
            file = path / name
            if not file.is_file() or run_files.sha256(file.read_bytes()) != digest:
                raise RunError(f"{file}: is damaged; the sweep's command with --resume runs its lanes again")

    def table(self, kind: str, columns: Sequence[str] | None = None) -> pa.Table | None:
        """The committed rows of one table, ``lanes``, ``curves`` or ``episodes``, or some of its columns; None without
        any.
        """
        return parts.read(self.path, kind, columns)

    def policy(self, config: int, seed: int) -> tuple[dict[str, np.ndarray], dict[str, str]]:
        """A lane's final weights by name, and what describes them; both empty where it has none."""
        return parts.read_policy(self.path, config, seed)

    def policies(self) -> set[tuple[int, int]]:
        """The setting and seed of every lane whose policy was kept."""
        return parts.kept_policies(self.path)


def load(path: str | Path, env: Callable[..., Any] | None = None) -> Outcome:
    """The outcome of a run directory; ``env`` is the function that made its environment, where that was one of the
    user's own, so that its policies can be played again.

    Raises RunError for what is no run, or is damaged, and ValueError for another function than the run was made with.
    """
    stored = StoredRun(Path(path))
    spec = stored.manifest["spec"]
    return Outcome(spec, stored, world=None if env is None else _own_world(spec, env))


def _own_world(spec: dict[str, Any], env: Callable[..., Any]) -> World:
    made_with = spec["common"].get("env")
    if made_with is None or made_with in WORLDS:
        raise ValueError(f"env: is not allowed: this run has no environment of your own, but {made_with or 'none'}")
    if not callable(env):
        raise ValueError(f"env: {env!r} is not allowed: the function that made {made_with!r}")
    if spec.get("source") not in (None, sources.digest(env)):
        raise ValueError(f"env: is not the {made_with!r} of this run: its source, or what is bound to it, is another")
    world = worlds.world(env)
    worlds.check([world])
    return world
