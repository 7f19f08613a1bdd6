"""The engine: many lanes through one compiled program, a small group of lanes per core.

A *group* is ``width`` slots that are vmapped together. Each core has a worker thread with a group of its own, and runs
one compiled program over it, a segment at a time; XLA lets go of the interpreter lock meanwhile, so groups run side by
side and none waits for another. Between segments the worker hands on lanes that ended and refills their slots from the
queue. Memory is that of the slots, whatever the number of lanes.

Invariant: what a lane computes depends on its hypers, its seed, the key family and the width, never on its slot, its
neighbours or its worker. All groups run the same executable, lanes meet no reduction across the group, and a lane's
keys derive from the root seed and its seed index alone.
"""

from __future__ import annotations

import queue
import threading
import time
from collections.abc import Callable, Generator, Iterable, Iterator
from dataclasses import dataclass
from functools import partial
from typing import Any

import jax
import numpy as np

from jaxq import prng
from jaxq.executables import Executables
from jaxq.experiment import DIVERGED, FINISHED, RUNNING, SOLVED, Log
from jaxq.machine import cores as cores
from jaxq.tally import Lane, Result, Slot, absorb
from jaxq.types import Hypers, PyTree

#: Ended lanes wait for company, so that a whole group is evaluated at once, but no longer than this.
WAIT_SECONDS = 1.0

STATUS = {SOLVED: "solved", FINISHED: "finished", DIVERGED: "diverged"}


@dataclass
class Progress:
    """What has been done so far; ``share`` counts the lanes that ended and the parts of those under way."""

    lanes: int
    done: int = 0
    solved: int = 0
    diverged: int = 0
    env_steps: int = 0
    updates: int = 0
    share: float = 0.0


def run(
    built: Executables,
    lanes: Iterable[Lane],
    *,
    root_seed: int,
    impl: str,
    total: int,
    workers: int | None = None,
    keep_max_q: bool = False,
    on_progress: Callable[[Progress], None] | None = None,
    stop: threading.Event | None = None,
) -> Generator[Result, None, None]:
    """Yields each lane's Result as it ends, in no fixed order.

    ``total`` is the number of lanes, for the progress. ``stop`` set: every worker finishes its segment, hands on what
    ended, and the iterator ends. An exception in a worker is raised here.
    """
    stop = stop or threading.Event()
    shared = _Shared(iter(lanes), Progress(total), stop)
    root = np.asarray(jax.random.key_data(prng.key(root_seed, impl)))
    count = workers or (cores() if jax.default_backend() == "cpu" else 1)
    count = max(1, min(count, -(-total // built.program.width)))
    threads = [threading.Thread(target=_Worker(built, shared, root, keep_max_q).run, daemon=True) for _ in range(count)]
    for thread in threads:
        thread.start()
    running = count
    if on_progress:
        on_progress(shared.progress)
    try:
        while running:
            try:
                item = shared.results.get(timeout=0.1)
            except queue.Empty:
                item = None
            if isinstance(item, BaseException):
                raise item
            if isinstance(item, Result):
                yield item
            elif item is _DONE:
                running -= 1
            if on_progress:
                on_progress(shared.progress)
    finally:  # the caller may have left early
        shared.closed = True
        for thread in threads:  # a thread that is still in XLA when the interpreter ends aborts the process
            thread.join()


_DONE = object()


class _Shared:
    """What the workers share: the queue of pending lanes, the results, the progress."""

    def __init__(self, lanes: Iterator[Lane], progress: Progress, stop: threading.Event):
        self.lanes, self.progress, self.stop, self.closed = lanes, progress, stop, False
        self.results: queue.Queue[Any] = queue.Queue()
        self.lock = threading.Lock()
        self.shares: dict[int, float] = {}

    def stopping(self) -> bool:
        return self.closed or self.stop.is_set()

    def take(self) -> Lane | None:
        with self.lock:
            return None if self.stopping() else next(self.lanes, None)

    def count(self, worker: int, share: float, env_steps: int, updates: int, ended: list[str]) -> None:
        with self.lock:
            self.shares[worker] = share
            p = self.progress
            p.env_steps += env_steps
            p.updates += updates
            p.done += len(ended)
            p.solved += ended.count("solved")
            p.diverged += ended.count("diverged")
            p.share = p.done + sum(self.shares.values())


class _Worker:
    """One group of slots, and the loop that keeps it full."""

    def __init__(self, built: Executables, shared: _Shared, root: np.ndarray, keep_max_q: bool):
        self.built, self.shared, self.root, self.keep_max_q = built, shared, root, keep_max_q
        self.width = built.program.width
        self.slots: list[Slot | None] = [None] * self.width
        self.seeds = np.zeros(self.width, np.uint32)
        self.numbers: list[Hypers | None] = [None] * self.width  # of each slot, the last lane's where it is free
        self.stack, self.stack_ended = _Stack(), _Stack()
        self.hypers: Hypers | None = None
        self.state = jax.tree.map(lambda leaf: np.zeros(leaf.shape, leaf.dtype), built.empty)
        self.waiting: list[tuple[Slot, str, PyTree]] = []  # ended, not yet evaluated
        self.since = 0.0  # when the first of them ended

    def run(self) -> None:
        try:
            while self._refill():
                self._advance()
                if len(self.waiting) >= self.width or (self.waiting and time.monotonic() - self.since > WAIT_SECONDS):
                    self._hand_on()
                if self.shared.stopping():
                    break
            while self.waiting:
                self._hand_on()
            self.shared.results.put(_DONE)
        except BaseException as error:  # it belongs to the caller's thread
            self.shared.results.put(error)

    def _refill(self) -> bool:
        """Fills free slots from the queue; False when no slot holds a lane."""
        fresh = np.zeros(self.width, bool)
        for i, slot in enumerate(self.slots):
            if slot is None and (lane := self.shared.take()) is not None:
                self.slots[i], self.seeds[i], fresh[i], self.numbers[i] = Slot(lane), lane.seed, True, lane.hypers
        if fresh.any():
            some = next(numbers for numbers in self.numbers if numbers is not None)
            self.hypers = self.stack([some if numbers is None else numbers for numbers in self.numbers])
            self.state, log = self.built.start(self.root, self.state, fresh, self.seeds.copy(), self.hypers)
            self._absorb(log, fresh)
        return any(slot is not None for slot in self.slots)

    def _advance(self) -> None:
        self.state, log = self.built.advance(self.state, self.hypers)
        steps, updates = self._absorb(log, np.array([slot is not None for slot in self.slots]))
        status = np.asarray(self.state.status)
        ended = [i for i, slot in enumerate(self.slots) if slot is not None and status[i] != RUNNING]
        names: list[str] = []
        if ended:
            policies = jax.tree.map(np.asarray, self.built.policy(self.state, self.hypers))
            for i in ended:
                slot = self.slots[i]
                assert slot is not None
                policy = jax.tree.map(partial(_row, i), policies)
                # A last update may blow up after its loss was taken.
                finite = all(np.isfinite(leaf).all() for leaf in jax.tree.leaves(policy))
                names.append(STATUS[int(status[i])] if finite else "diverged")
                if not self.waiting:
                    self.since = time.monotonic()
                self.waiting.append((slot, names[-1], policy))
                self.slots[i] = None
        share = sum(slot.share() for slot in self.slots if slot is not None)
        self.shared.count(id(self), share, steps, updates, names)

    def _absorb(self, log: Log, which: np.ndarray) -> tuple[int, int]:
        clock = jax.tree.map(np.asarray, self.state.clock)
        return absorb(self.slots, which, clock, log, self.built.program, self.keep_max_q)

    def _hand_on(self) -> None:
        """Evaluates up to a group of ended lanes together, and emits their results."""
        batch, self.waiting = self.waiting[: self.width], self.waiting[self.width :]
        padded = batch + batch[:1] * (self.width - len(batch))
        policy = jax.tree.map(lambda *rows: np.stack(rows), *(entry[2] for entry in padded))
        hypers = self.stack_ended([entry[0].lane.hypers for entry in padded])
        seeds = np.array([entry[0].lane.seed for entry in padded], np.uint32)
        returns = np.asarray(self.built.evaluate(self.root, seeds, policy, hypers))
        for (slot, status, weights), row in zip(batch, returns, strict=False):
            self.shared.results.put(
                Result(
                    lane=slot.lane,
                    status=status,
                    env_steps=slot.env_steps,
                    updates=slot.updates,
                    episodes=slot.episodes(self.built.program.num_envs),
                    curve=slot.curve,
                    policy=weights,
                    eval_returns=None if status == "diverged" else row.copy(),
                    max_q=np.concatenate(slot.max_q) if slot.max_q else None,
                )
            )


def _row(i: int, rows: np.ndarray) -> np.ndarray:
    return rows[i].copy()


class _Stack:
    """The numbers of a group's lanes as one tree; new arrays when a lane's are other ones, since a program may still
    read the old, and the last tree again when all are the same objects, as in a sweep over seeds."""

    def __init__(self) -> None:
        self.rows: list[Hypers] = []
        self.stacked: Any = None

    def __call__(self, rows: list[Hypers]) -> Hypers:
        if len(rows) != len(self.rows) or any(new is not old for new, old in zip(rows, self.rows, strict=True)):
            self.rows, self.stacked = rows, jax.tree.map(lambda *leaves: np.stack(leaves), *rows)
        return self.stacked
