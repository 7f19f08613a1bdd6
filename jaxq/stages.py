"""A sweep under way: program by program and, with halving, rung by rung, until every lane has its row."""

from __future__ import annotations

import contextlib
import threading
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from typing import Any

import jax
import numpy as np

from jaxq import executables, halving, tally
from jaxq import lanes as engine
from jaxq.batches import Batches
from jaxq.checkpoints import AtRung
from jaxq.compile_cache import CompileCache
from jaxq.executables import Executables
from jaxq.halving import Rung
from jaxq.outcome import Outcome, Timing
from jaxq.plans import Plan
from jaxq.programs import hypers, program
from jaxq.run_files import WriteError
from jaxq.saved_policy import flatten
from jaxq.shared import Progress
from jaxq.store import Store
from jaxq.tally import Episodes, Lane, Result, Saved


@dataclass
class Listeners:
    """Who is told what while a sweep runs.

    ``compiling(i, n)`` before program i of n is built, ``result`` of each lane that ended, ``episodes`` at each segment
    of a lane with all episodes that it has finished, ``progress`` a few times a second, ``rung`` of what halving
    decided.
    """

    compiling: Callable[[int, int], None] | None = None
    progress: Callable[[Progress], None] | None = None
    result: Callable[[Result], None] | None = None
    episodes: Callable[[Lane, Episodes], None] | None = None
    rung: Callable[[dict[str, Any]], None] | None = None


@dataclass
class Sweep:
    """A sweep under way. ``have`` [settings, seeds] marks the lanes that have a row."""

    planned: Plan
    store: Store
    on_disk: bool
    keep_episodes: bool
    keep_max_q: bool
    keep: int | None
    workers: int | None
    cache: CompileCache | None
    checkpoint_s: float
    tell: Listeners
    stop: threading.Event
    timing: Timing = field(default_factory=Timing)
    built: dict[Any, Executables] = field(default_factory=dict)

    def run(self) -> Outcome:
        planned = self.planned
        self.place = {seed: i for i, seed in enumerate(planned.seeds)}
        self.structures: dict[Any, list[int]] = {}
        for config, settings in enumerate(planned.settings):
            self.structures.setdefault(settings.structural(), []).append(config)
        self.have = np.zeros((len(planned.settings), len(planned.seeds)), bool)
        self.overall = Progress(planned.lanes)
        self.store.agree("episodes", "all" if self.keep_episodes else "none")
        self.store.agree("keep", "all" if self.keep is None else self.keep)
        self._count_what_is_there()
        self.batches = Batches(self.store, planned.settings, self.keep_episodes, self.keep, self._committed)
        factor = planned.halving
        rungs = halving.rungs(len(planned.settings), factor, planned.rungs) if factor else []
        try:
            for rung in [*rungs, None]:
                alive = np.ones(len(planned.settings), bool) if not rungs else self._alive(rung)
                if not self._advance(alive, rung):
                    break
                if rung is not None:
                    self._judge(alive, rung)
        finally:
            self.batches.flush()
        self.timing.env_steps, self.timing.updates = self.overall.env_steps, self.overall.updates
        return Outcome(planned.spec(), self.store, self.timing, getattr(planned.settings[0], "env", None))

    def _count_what_is_there(self) -> None:
        lanes = self.store.table("lanes", ["status"])
        if lanes is not None:
            configs, seeds = (lanes[name].to_numpy().tolist() for name in ("config", "seed"))
            for config, seed in zip(configs, seeds, strict=True):
                self.have[config, self.place[seed]] = True
                self.store.checkpoints.drop(config, seed)  # a kill came between its commit and this
            status = lanes["status"].to_pylist()
            self.overall.solved, self.overall.diverged = status.count("solved"), status.count("diverged")
        self.overall.done = int(self.have.sum())
        self.overall.share = float(self.overall.done)

    def _committed(self, lanes: list[tuple[int, int]]) -> None:
        """These lanes have their rows: what they were on the way is not needed any more."""
        for config, seed in lanes:
            self.have[config, self.place[seed]] = True
            self.store.checkpoints.drop(config, seed)

    def _alive(self, rung: Rung | None) -> np.ndarray:
        """[settings] those that go to this rung: who was not stopped before it, nor is past it."""
        alive = np.ones(len(self.planned.settings), bool)
        for decided in self.store.manifest["rungs"]:
            if rung is None or decided["rung"] < rung.number:
                alive[decided["stopped"]] = False
            elif decided["rung"] == rung.number:
                alive[decided["kept"]] = False  # they would stop on the way, where nothing is to be decided any more
        return alive

    def _advance(self, alive: np.ndarray, rung: Rung | None) -> bool:
        """Brings every lane of the settings ``alive`` to its end, or to the rung; False when it was stopped."""
        waiting = self._waiting(rung)
        pending = alive[:, None] & ~self.have
        for config, seed in waiting:
            pending[config, self.place[seed]] = False
        groups = [(key, configs) for key, configs in self.structures.items() if pending[configs].any()]
        for i, (key, configs) in enumerate(groups):
            if self.stop.is_set():
                return False
            if self.tell.compiling and key not in self.built:
                self.tell.compiling(i + 1, len(groups))
            self._group(configs, pending, rung)
        return not self.stop.is_set()

    def _waiting(self, rung: Rung | None) -> list[tuple[int, int]]:
        """The lanes that wait at this rung."""
        if rung is None:
            return []
        checkpoints, found = self.store.checkpoints, []
        for config, seed in checkpoints.lanes():
            at = checkpoints.at_rung(config, seed)
            if at is not None and at.rung >= rung.number:
                found.append((config, seed))
        return found

    def _group(self, configs: list[int], pending: np.ndarray, rung: Rung | None) -> None:
        """Runs the pending lanes of one structure."""
        planned, first = self.planned, configs[0]
        key = planned.settings[first].structural()
        if key not in self.built:
            example = planned.settings[first]
            built = executables.build(program(example, planned.prng), hypers(example), planned.prng, self.cache)
            self.timing.compile_s += built.seconds
            self.timing.programs += 1
            self.timing.cached += built.cached
            self.store.agree(f"width of setting {first}", built.program.width)
            self.built[key] = built
        built = self.built[key]
        began = time.perf_counter()
        base, seen = Progress(**vars(self.overall)), Progress(0)

        def report(progress: Progress) -> None:
            nonlocal seen
            seen = progress
            for name in ("done", "solved", "diverged", "env_steps", "updates"):
                setattr(self.overall, name, getattr(base, name) + getattr(progress, name))
            self.overall.share = base.done + progress.share
            self.batches.flush_if_due()
            if self.tell.progress:
                self.tell.progress(self.overall)

        results = engine.run(
            built,
            self._lanes(configs, pending, rung, built),
            root_seed=planned.root_seed,
            impl=planned.prng,
            total=int(pending[configs].sum()),
            workers=self.workers,
            keep_max_q=self.keep_max_q,
            on_progress=report,
            on_episodes=self.tell.episodes,
            on_saved=self.store.checkpoints.save if self.on_disk else None,
            checkpoint_s=self.checkpoint_s,
            stop=self.stop,
        )
        with contextlib.closing(results):  # its workers stop even when a write fails here
            try:
                for result in results:
                    self._take(result, rung)
                    if self.tell.result and result.status != "paused":
                        self.tell.result(result)
            except KeyboardInterrupt:  # of who calls this from Python: what has ended is kept
                self.stop.set()
                for result in results:
                    self._take(result, rung)
                raise
        self.timing.run_s += time.perf_counter() - began
        self.timing.book(seen)

    def _lanes(self, configs: list[int], pending: np.ndarray, rung: Rung | None, built: Executables) -> Iterator[Lane]:
        shapes = jax.tree.map(lambda leaf: jax.ShapeDtypeStruct(leaf.shape[1:], leaf.dtype), built.empty)
        under_way = set(self.store.checkpoints.lanes())
        for config in configs:
            settings = self.planned.settings[config]
            numbers = hypers(settings)
            at = None if rung is None else halving.pause_at(settings, rung)
            for i in np.flatnonzero(pending[config]).tolist():
                lane = Lane(config, self.planned.seeds[i], numbers, getattr(settings, "eval_every", 0), at)
                if lane[:2] in under_way:
                    lane = lane._replace(resume=self._loader(lane, shapes))
                yield lane

    def _loader(self, lane: Lane, shapes: Any) -> Callable[[], Saved | None]:
        return lambda: self.store.checkpoints.load(lane, shapes)

    def _take(self, result: Result, rung: Rung | None) -> None:
        if result.status == "paused" and rung is not None and result.saved is not None:
            self.store.checkpoints.save(result.saved, AtRung(rung.number, result.eval_returns, flatten(result.policy)))
        else:
            self.batches.add(result)

    def _judge(self, alive: np.ndarray, rung: Rung) -> None:
        """Decides at a rung, unless that was decided before, and writes the rows of the lanes that stop there."""
        self.batches.flush()
        found = [decided for decided in self.store.manifest["rungs"] if decided["rung"] == rung.number]
        decided = found[0] if found else self._decide(alive, rung)
        for config in decided["stopped"]:
            for i, seed in enumerate(self.planned.seeds):
                if not self.have[config, i]:
                    result = self._stopped(config, seed)
                    self.batches.add(result, rung.number)
                    self.overall.done += 1
                    if self.tell.result:
                        self.tell.result(result)
        self.batches.flush()
        if self.tell.rung and not found:
            self.tell.rung(decided)

    def _decide(self, alive: np.ndarray, rung: Rung) -> dict[str, Any]:
        returns: dict[int, list[float | None]] = {int(config): [] for config in np.flatnonzero(alive)}
        lanes = self.store.table("lanes", ["eval_return"])
        if lanes is not None:
            for config, value in zip(lanes["config"].to_pylist(), lanes["eval_return"].to_pylist(), strict=True):
                if config in returns:
                    returns[config].append(value)
        for config, seed in self.store.checkpoints.lanes():
            at = self.store.checkpoints.at_rung(config, seed)
            if config in returns and at is not None:
                returns[config].append(None if at.eval_returns is None else float(at.eval_returns.mean(dtype=float)))
        scores = {config: halving.score(values) for config, values in returns.items()}
        kept = halving.kept(scores, self.planned.halving or 2)
        decided = {
            "rung": rung.number,
            "fraction": rung.fraction,
            "scores": {str(config): score if np.isfinite(score) else None for config, score in scores.items()},
            "kept": kept,
            "stopped": sorted(set(scores) - set(kept)),
        }
        self.store.decide(decided)
        return decided

    def _stopped(self, config: int, seed: int) -> Result:
        """A lane that waits at a rung, as one that was stopped there."""
        settings, checkpoints = self.planned.settings[config], self.store.checkpoints
        at, books = checkpoints.at_rung(config, seed), checkpoints.books(config, seed)
        if at is None or books is None:  # it was sound when it was judged
            raise WriteError(f"setting {config}, seed {seed}: its checkpoint is gone")
        return tally.result_of(
            Lane(config, seed, hypers(settings)),
            books,
            getattr(settings, "num_envs", 1),
            status="stopped",
            policy=at.policy,
            eval_returns=at.eval_returns,
        )
