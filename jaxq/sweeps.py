"""Sweeps: a plan's lanes go through the engine into tables, and into a run directory as they come."""

from __future__ import annotations

import contextlib
import threading
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from typing import Any

from jaxq import executables, tables
from jaxq import lanes as engine
from jaxq.compile_cache import CompileCache
from jaxq.lanes import Progress
from jaxq.plans import Plan, plan
from jaxq.programs import hypers, program
from jaxq.runs import RunDirectory, flatten
from jaxq.tables import Row
from jaxq.tally import Episodes, Lane, Result

#: Results are written once this many have gathered or this many seconds have passed.
BATCH_LANES, BATCH_SECONDS = 512, 2.0


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
    """The rows of a sweep. ``complete`` is False when it was stopped before its last lane."""

    plan: Plan
    lanes: list[Row] = field(default_factory=list)
    curves: list[Row] = field(default_factory=list)
    timing: Timing = field(default_factory=Timing)

    @property
    def complete(self) -> bool:
        """Whether every lane has a row."""
        return len({(row["config"], row["seed"]) for row in self.lanes}) == self.plan.lanes

    def summary(self) -> list[Row]:
        """One row per setting: see ``tables.summary``."""
        return tables.summary(self.lanes, self.plan.varied)


def run(
    planned: Plan,
    *,
    directory: RunDirectory | None = None,
    keep_episodes: bool = False,
    keep_max_q: bool = False,
    workers: int | None = None,
    cache: CompileCache | None = None,
    on_compile: Callable[[int, int], None] | None = None,
    on_progress: Callable[[Progress], None] | None = None,
    on_result: Callable[[Result], None] | None = None,
    on_episodes: Callable[[Lane, Episodes], None] | None = None,
    stop: threading.Event | None = None,
) -> Outcome:
    """Runs all lanes that ``directory`` does not hold yet, writing results there as they come.

    What ``cache`` holds is not compiled again.
    ``on_compile(i, n)`` is called before program i of n is built, ``on_result`` for each lane that ends,
    ``on_episodes`` at each segment of a lane with all episodes that it has finished, ``on_progress`` a few times a
    second. ``stop`` set: what ended is kept and the Outcome is not complete.
    """
    stop = stop or threading.Event()
    outcome = Outcome(planned)
    if directory is not None:
        outcome.lanes, outcome.curves = directory.rows("lanes"), directory.rows("curves")
    have = {(row["config"], row["seed"]) for row in outcome.lanes}
    sink = _Sink(directory, outcome, keep_episodes)
    groups = _by_structure(planned, have)
    overall = Progress(planned.lanes, done=len(have))
    overall.solved, overall.diverged = (
        sum(row["status"] == status for row in outcome.lanes) for status in ("solved", "diverged")
    )
    try:
        for i, group in enumerate(groups):
            if stop.is_set():
                break
            if on_compile:
                on_compile(i + 1, len(groups))
            example = planned.settings[group[0][0]]
            built = executables.build(program(example, planned.prng), hypers(example), planned.prng, cache)
            outcome.timing.compile_s += built.seconds
            outcome.timing.programs += 1
            outcome.timing.cached += built.cached
            if directory is not None:
                first = [one.structural() for one in planned.settings].index(example.structural())
                directory.agree_width(first, built.program.width)
            began = time.perf_counter()
            base, seen = Progress(**vars(overall)), Progress(0)

            def report(progress: Progress, base: Progress = base) -> None:
                nonlocal seen
                seen = progress
                for name in ("done", "solved", "diverged", "env_steps", "updates"):
                    setattr(overall, name, getattr(base, name) + getattr(progress, name))
                overall.share = base.done + progress.share
                sink.flush_if_due()
                if on_progress:
                    on_progress(overall)

            results = engine.run(
                built,
                _lanes(planned, group),
                root_seed=planned.root_seed,
                impl=planned.prng,
                total=len(group),
                workers=workers,
                keep_max_q=keep_max_q,
                on_progress=report,
                on_episodes=on_episodes,
                stop=stop,
            )
            with contextlib.closing(results):  # its workers stop even when a write fails here
                try:
                    for result in results:
                        sink.add(result)
                        if on_result:
                            on_result(result)
                except KeyboardInterrupt:  # of who calls this from Python: what has ended is kept
                    stop.set()
                    for result in results:
                        sink.add(result)
                    raise
            outcome.timing.run_s += time.perf_counter() - began
            outcome.timing.book(seen)
    finally:
        sink.flush()
    outcome.timing.env_steps, outcome.timing.updates = overall.env_steps, overall.updates
    for rows in (outcome.lanes, outcome.curves):
        rows.sort(key=lambda row: (row["config"], row["seed"]))
    return outcome


def sweep(
    name: str,
    *,
    seeds: int = 1,
    root_seed: int = 0,
    prng: str | None = None,
    cache: CompileCache | None = None,
    **values: Any,
) -> Outcome:
    """Runs a preset over the grid of every value that is a list, times ``seeds`` seeds, and returns its rows.

    ``jaxq.sweep("article-q", gamma=[0.95, 0.99], seeds=32).summary()``. Nothing compiled is kept on disk unless a
    ``cache`` is given, such as ``jaxq.compile_cache.user_cache()``. Raises ValueError as ``plan`` does.
    """
    return run(plan(name, seeds=seeds, root_seed=root_seed, prng=prng, **values), cache=cache)


def train(
    name: str, *, root_seed: int = 0, prng: str | None = None, cache: CompileCache | None = None, **values: Any
) -> Result:
    """Trains one lane of a preset and returns it with its episodes, its policy and the value of every update.

    ``jaxq.train("article-q").episodes.length``. ``cache`` as for ``sweep``. Raises ValueError as ``plan`` does.
    """
    kept: list[Result] = []
    planned = plan(name, root_seed=root_seed, prng=prng, **values)
    run(planned, keep_max_q=True, cache=cache, on_result=kept.append)
    return kept[0]


def _by_structure(planned: Plan, have: set[tuple[int, int]]) -> list[list[tuple[int, int]]]:
    """The pending (config, seed) pairs of each structure."""
    groups: dict[Any, list[tuple[int, int]]] = {}
    for config, settings in enumerate(planned.settings):
        pending = [(config, seed) for seed in planned.seeds if (config, seed) not in have]
        if pending:
            groups.setdefault(settings.structural(), []).extend(pending)
    return list(groups.values())


def _lanes(planned: Plan, group: list[tuple[int, int]]) -> Iterator[Lane]:
    numbers: dict[int, Any] = {}
    for config, seed in group:
        if config not in numbers:
            numbers[config] = hypers(planned.settings[config])
        yield Lane(config, seed, numbers[config])


class _Sink:
    """Turns results into rows and writes them in batches."""

    def __init__(self, directory: RunDirectory | None, outcome: Outcome, keep_episodes: bool):
        self.directory, self.outcome, self.keep_episodes = directory, outcome, keep_episodes
        self._clear()

    def _clear(self) -> None:
        self.lanes: list[Row] = []
        self.curves: list[Row] = []
        self.episodes: list[Row] = []
        self.policies: dict[tuple[int, int], dict[str, Any]] = {}
        self.since = time.monotonic()

    def add(self, result: Result) -> None:
        settings = self.outcome.plan.settings[result.lane.config]
        self.lanes.append(tables.lane_row(result, settings))
        self.curves += tables.curve_rows(result)
        if self.keep_episodes:
            self.episodes += tables.episode_rows(result)
        named = {name or "table": array for name, array in flatten(result.policy).items()}
        self.policies[result.lane.config, result.lane.seed] = named
        self.flush_if_due()

    def flush_if_due(self) -> None:
        if len(self.lanes) >= BATCH_LANES or time.monotonic() - self.since > BATCH_SECONDS:
            self.flush()

    def flush(self) -> None:
        lanes, curves, policies, episodes = self.lanes, self.curves, self.policies, self.episodes
        self._clear()  # first, so that a write that fails is not tried again under another number
        if lanes:
            if self.directory is not None:
                self.directory.write(lanes, curves, policies, episodes)
            self.outcome.lanes += lanes
            self.outcome.curves += curves
