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
from jaxq.experiment import DIVERGED, FINISHED, RUNNING, SOLVED
from jaxq.machine import cores as cores
from jaxq.tally import Done, Episodes, Lane, Result, Tally
from jaxq.types import Hypers, PyTree

#: Ended lanes wait for company, so that a whole group is evaluated at once, but no longer than this.
WAIT_SECONDS = 1.0

STATUS = {SOLVED: "solved", FINISHED: "finished", DIVERGED: "diverged"}


@dataclass
class Progress:
    """What has been done so far; ``share`` counts the lanes that ended and the parts of those under way.

    ``pending_s`` are the workers' seconds while lanes were waiting for a slot, ``useful_s`` those of them in which
    slots advanced a lane that had not ended: a segment of which a slot used half counts half of that slot.
    ``queue_empty`` is the ``time.monotonic()`` at which the last lane got its slot.
    """

    lanes: int
    done: int = 0
    solved: int = 0
    diverged: int = 0
    env_steps: int = 0
    updates: int = 0
    share: float = 0.0
    pending_s: float = 0.0
    useful_s: float = 0.0
    queue_empty: float | None = None


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
    on_episodes: Callable[[Lane, Episodes], None] | None = None,
    stop: threading.Event | None = None,
) -> Generator[Result, None, None]:
    """Yields each lane's Result as it ends, in no fixed order.

    ``total`` is the number of lanes, for the progress. ``on_episodes`` is called for every lane at each of its segments
    with all episodes that it has finished. ``stop`` set: every worker finishes its segment, hands on what
    ended, and the iterator ends. An exception in a worker, or Ctrl-C, is raised here once all that ended is handed on.
    """
    stop = stop or threading.Event()
    shared = _Shared(iter(lanes), Progress(total), stop, watched=on_episodes is not None)
    root = np.asarray(jax.random.key_data(prng.key(root_seed, impl)))
    count = workers or (cores() if jax.default_backend() == "cpu" else 1)
    count = max(1, min(count, -(-total // built.program.width)))
    threads = [threading.Thread(target=_Worker(built, shared, root, keep_max_q).run, daemon=True) for _ in range(count)]
    failure: BaseException | None = None
    try:
        for thread in threads:
            thread.start()
        running = count
        if on_progress:
            on_progress(shared.progress)
        while running:
            item = None
            try:
                item = shared.results.get(timeout=0.1)
            except queue.Empty:
                pass
            except KeyboardInterrupt as error:  # raised in the end: what has ended is handed on first
                failure, shared.closed = error, True
            if isinstance(item, Result):
                yield item
            elif isinstance(item, _Ended):
                running -= 1
                if item.error is not None:
                    failure, shared.closed = failure or item.error, True
            elif item is not None and on_episodes:
                on_episodes(*item)
            if on_progress:
                on_progress(shared.progress)
    finally:  # the caller may have left early
        shared.closed = True
        for thread in threads:  # a thread that is still in XLA when the interpreter ends aborts the process
            if thread.ident is not None:
                thread.join()
    if failure is not None:
        raise failure


@dataclass(frozen=True)
class _Ended:
    """A worker's last word."""

    error: BaseException | None


class _Shared:
    """What the workers share: the queue of pending lanes, the results, the progress."""

    def __init__(self, lanes: Iterator[Lane], progress: Progress, stop: threading.Event, watched: bool):
        self.lanes, self.progress, self.stop, self.closed = lanes, progress, stop, False
        self.watched = watched
        self.next = next(lanes, None)  # known ahead, so that who takes the last lane can tell
        self.results: queue.Queue[Any] = queue.Queue()
        self.lock = threading.Lock()
        self.shares: dict[int, float] = {}

    def stopping(self) -> bool:
        return self.closed or self.stop.is_set()

    def take(self) -> Lane | None:
        with self.lock:
            if self.stopping():
                return None
            lane = self.next
            if lane is not None:
                self.next = next(self.lanes, None)
                if self.next is None:
                    self.progress.queue_empty = time.monotonic()
            return lane

    def pending(self, seconds: float, useful: float) -> None:
        """A worker's seconds of one segment with all that belongs to it; they count while lanes are waiting."""
        with self.lock:
            if self.progress.queue_empty is None:
                self.progress.pending_s += seconds
                self.progress.useful_s += useful

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
        self.built, self.shared, self.root = built, shared, root
        self.width = built.program.width
        self.tally = Tally(built.program, keep_max_q)
        self.seeds = np.zeros(self.width, np.uint32)
        self.numbers: list[Hypers | None] = [None] * self.width  # of each slot, the last lane's where it is free
        self.stack, self.stack_ended = _Stack(), _Stack()
        self.hypers: Hypers | None = None
        self.state = jax.tree.map(lambda leaf: np.zeros(leaf.shape, leaf.dtype), built.empty)
        self.waiting: list[tuple[Done, str, PyTree]] = []  # ended, not yet evaluated
        self.since = 0.0  # when the first of them ended

    def run(self) -> None:
        error: BaseException | None = None  # it belongs to the caller's thread
        for work in (self._work, self._hand_on_all):  # what has ended is handed on even after an error
            try:
                work()
            except BaseException as caught:
                error = error or caught
        self.shared.results.put(_Ended(error))

    def _work(self) -> None:
        began = time.monotonic()
        while self._refill():
            useful = self._advance()
            if len(self.waiting) >= self.width or (self.waiting and time.monotonic() - self.since > WAIT_SECONDS):
                self._hand_on()
            began, before = time.monotonic(), began
            self.shared.pending(began - before, useful)
            if self.shared.stopping():
                break

    def _hand_on_all(self) -> None:
        while self.waiting:
            self._hand_on()

    def _refill(self) -> bool:
        """Fills free slots from the queue; False when no slot holds a lane."""
        fresh = np.zeros(self.width, bool)
        for i, held in enumerate(self.tally.slots):
            if held is None and (lane := self.shared.take()) is not None:
                self.tally.enter(i, lane)
                self.seeds[i], fresh[i], self.numbers[i] = lane.seed, True, lane.hypers
        if fresh.any():
            some = next(numbers for numbers in self.numbers if numbers is not None)
            self.hypers = self.stack([some if numbers is None else numbers for numbers in self.numbers])
            self.state, log = self.built.start(self.root, self.state, fresh, self.seeds.copy(), self.hypers)
            steps, updates = self.tally.book(fresh, jax.tree.map(np.asarray, self.state.clock), log)
            self.shared.count(id(self), self.tally.share(), steps, updates, [])
        return any(lane is not None for lane in self.tally.slots)

    def _advance(self) -> float:
        """Runs a segment and books it; returns its seconds times the share of its steps that lanes made."""
        began = time.monotonic()
        self.state, log = jax.block_until_ready(self.built.advance(self.state, self.hypers))
        seconds = time.monotonic() - began
        live = np.array([lane is not None for lane in self.tally.slots])
        steps, updates = self.tally.book(live, jax.tree.map(np.asarray, self.state.clock), log)
        if self.shared.watched:
            for i in np.flatnonzero(live).tolist():
                self.shared.results.put((self.tally.slots[i], self.tally.so_far(i)))
        status = np.asarray(self.state.status)
        ended = np.flatnonzero(live & (status != RUNNING)).tolist()
        names: list[str] = []
        if ended:
            policies = jax.tree.map(np.asarray, self.built.policy(self.state, self.hypers))
            for i in ended:
                policy = jax.tree.map(partial(_row, i), policies)
                # A last update may blow up after its loss was taken.
                finite = all(np.isfinite(leaf).all() for leaf in jax.tree.leaves(policy))
                names.append(STATUS[int(status[i])] if finite else "diverged")
                if not self.waiting:
                    self.since = time.monotonic()
                self.waiting.append((self.tally.leave(i), names[-1], policy))
        self.shared.count(id(self), self.tally.share(), steps, updates, names)
        return seconds * steps / log.over.size

    def _hand_on(self) -> None:
        """Evaluates up to a group of ended lanes together, and emits their results."""
        batch, self.waiting = self.waiting[: self.width], self.waiting[self.width :]
        padded = batch + batch[:1] * (self.width - len(batch))
        policy = jax.tree.map(lambda *rows: np.stack(rows), *(entry[2] for entry in padded))
        hypers = self.stack_ended([entry[0].lane.hypers for entry in padded])
        seeds = np.array([entry[0].lane.seed for entry in padded], np.uint32)
        returns = np.asarray(self.built.evaluate(self.root, seeds, policy, hypers))
        for (done, status, weights), row in zip(batch, returns, strict=False):
            returned = None if status == "diverged" else row.copy()
            self.shared.results.put(Result(**done._asdict(), status=status, policy=weights, eval_returns=returned))


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
            self.rows, self.stacked = rows, jax.device_put(jax.tree.map(lambda *leaves: np.stack(leaves), *rows))
        return self.stacked
