"""The engine's workers: a group of slots each, kept full from a shared queue of lanes.

While XLA runs a segment of a group, its worker does the books of the segment before: who ended, what they did, whose
evaluation is due. Only what the next segment needs, which lanes ended and who takes their slots, is done in between.
"""

from __future__ import annotations

import queue
import threading
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from functools import partial
from typing import Any

import jax
import numpy as np

from jaxq.executables import Executables
from jaxq.experiment import DIVERGED, FINISHED, RUNNING, SOLVED, Log
from jaxq.tally import Done, Lane, Result, Tally
from jaxq.types import Clock, Hypers, PyTree

#: Ended lanes wait for company, so that a whole group is evaluated at once, but no longer than this where a segment
#: is shorter.
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


@dataclass(frozen=True)
class Ended:
    """A worker's last word."""

    error: BaseException | None


class Shared:
    """What the workers share: the queue of pending lanes, the results, the progress."""

    def __init__(self, lanes: Iterator[Lane], progress: Progress, stop: threading.Event, watched: bool):
        self.lanes, self.progress, self.stop, self.closed = lanes, progress, stop, False
        self.watched = watched
        self.next = next(lanes, None)  # known ahead, so that who takes the last lane can tell
        self.results: queue.SimpleQueue[Any] = queue.SimpleQueue()
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

    def pending(self) -> bool:
        """Whether lanes are waiting for a slot."""
        return self.next is not None

    def account(self, seconds: float, useful: float) -> None:
        """A worker's seconds of a segment with all that belongs to it, while lanes were waiting."""
        with self.lock:
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


@dataclass
class _Segment:
    """A segment of a group, from the lanes that took a slot at its beginning to those that ended in it."""

    began: float
    entered: list[tuple[int, Lane]]
    live: np.ndarray  # [L] slots that hold a lane
    warm_up: tuple[np.ndarray, Clock, Log] | None  # which lanes made one, their clock after it, what it logged
    log: Log
    pending: bool  # lanes were waiting for a slot
    sent: float
    running: float  # the last time that it was known to run
    clock: Any = None
    status: Any = None
    ended: list[int] = field(default_factory=list)
    policies: PyTree = None  # of all slots, where a lane ended

    def useful_s(self, steps: int) -> float:
        """The seconds it ran, times the share of all its slots' steps that ``steps`` are."""
        return (self.running - self.sent) * steps / self.log.over.size


class Worker:
    """One group of slots, and the loop that keeps it full."""

    def __init__(self, built: Executables, shared: Shared, root: np.ndarray, keep_max_q: bool):
        self.built, self.shared, self.root = built, shared, root
        self.width = built.program.width
        self.tally = Tally(built.program, keep_max_q)  # its slots are those of the books, a segment behind ``held``
        self.held: list[Lane | None] = [None] * self.width
        self.seeds = np.zeros(self.width, np.uint32)
        self.numbers: list[Hypers | None] = [None] * self.width  # of each slot, the last lane's where it is free
        self.stack, self.stack_ended = _Stack(), _Stack()
        self.hypers: Hypers | None = None
        self.state = jax.tree.map(lambda leaf: np.zeros(leaf.shape, leaf.dtype), built.empty)
        self.sent: _Segment | None = None  # what XLA runs
        self.open: _Segment | None = None  # the segment before it, whose books are to be done
        self.waiting: list[tuple[Done, str, PyTree]] = []  # ended, not yet evaluated
        self.since = 0.0  # when the first of them ended
        self.evaluated: list[tuple[list[tuple[Done, str, PyTree]], jax.Array]] = []  # not yet handed on

    def run(self) -> None:
        error: BaseException | None = None  # it belongs to the caller's thread

        def attempt(work: Callable[[], None]) -> None:
            nonlocal error
            try:
                work()
            except BaseException as caught:
                error = error or caught

        for work in (self._work, self._do_books, self._receive, self._do_books):  # what ended is not lost
            attempt(work)
        while self.waiting:  # an evaluation that fails costs its own group alone
            attempt(self._evaluate)
        while self.evaluated:
            attempt(self._hand_on)
        self.shared.results.put(Ended(error))

    def _work(self) -> None:
        while not self.shared.stopping() and self._send():
            self._do_books()
            self._receive()

    def _send(self) -> bool:
        """Fills free slots from the queue and starts a segment; False when no slot holds a lane."""
        began, entered, fresh, warm_up = time.monotonic(), [], np.zeros(self.width, bool), None
        for i, held in enumerate(self.held):
            if held is None and (lane := self.shared.take()) is not None:
                self.held[i] = lane
                self.seeds[i], fresh[i], self.numbers[i] = lane.seed, True, lane.hypers
                entered.append((i, lane))
        live = np.array([lane is not None for lane in self.held])
        if not live.any():
            return False
        if entered:
            some = next(numbers for numbers in self.numbers if numbers is not None)
            self.hypers = self.stack([some if numbers is None else numbers for numbers in self.numbers])
            self.state, log = self.built.start(self.root, self.state, fresh, self.seeds.copy(), self.hypers)
            if len(log.over):
                warm_up = fresh, _copy(self.state.clock), log
        self.state, log = self.built.advance(self.state, self.hypers)
        now = time.monotonic()
        self.sent = _Segment(began, entered, live, warm_up, log, self.shared.pending(), sent=now, running=now)
        return True

    def _receive(self) -> None:
        """Waits for the segment and frees the slots of the lanes that ended."""
        segment, self.sent = self.sent, None
        if segment is None:
            return
        waited = not self.state.status.is_ready()
        jax.block_until_ready(self.state.status)
        if waited:
            segment.running = time.monotonic()
        segment.clock, segment.status = _copy(self.state.clock), np.array(self.state.status)
        segment.ended = np.flatnonzero(segment.live & (segment.status != RUNNING)).tolist()
        if segment.ended:
            segment.policies = self.built.policy(self.state, self.hypers)
            for i in segment.ended:
                self.held[i] = None
        self.open = segment

    def _do_books(self) -> None:
        """The books of the segment before, while XLA runs the next."""
        segment, self.open = self.open, None
        if segment is None:
            return
        for i, lane in segment.entered:
            self.tally.enter(i, lane)
        warm_up_steps = 0
        if segment.warm_up:
            warm_up_steps, _ = self.tally.book(*segment.warm_up)
        steps, updates = self.tally.book(segment.live, segment.clock, segment.log)
        self._look()
        if self.shared.watched:
            for i in np.flatnonzero(segment.live).tolist():
                self.shared.results.put((self.tally.slots[i], self.tally.so_far(i)))
        names = self._leave(segment) if segment.ended else []
        self.shared.count(id(self), self.tally.share(), warm_up_steps + steps, updates, names)
        if segment.pending:
            seconds = (self.sent.began if self.sent else time.monotonic()) - segment.began
            self.shared.account(seconds, segment.useful_s(steps))
        self._pass_on(long=segment.running - segment.sent > WAIT_SECONDS)

    def _look(self) -> None:
        """Notes that XLA still runs the segment, if it does: how long it ran is not known otherwise."""
        if self.sent and not self.state.status.is_ready():
            self.sent.running = time.monotonic()

    def _leave(self, segment: _Segment) -> list[str]:
        """Takes the lanes that ended out of the books; their status by name."""
        policies = jax.tree.map(np.asarray, segment.policies)
        leaves = [leaf.reshape(self.width, -1) for leaf in jax.tree.leaves(policies)]
        finite = np.all([np.isfinite(leaf).all(axis=1) for leaf in leaves], axis=0)
        names = []
        for i in segment.ended:
            # A last update may blow up after its loss was taken.
            names.append(STATUS[int(segment.status[i])] if finite[i] else "diverged")
            if not self.waiting:
                self.since = time.monotonic()
            self.waiting.append((self.tally.leave(i), names[-1], jax.tree.map(partial(_row, i), policies)))
            self._look()
        return names

    def _pass_on(self, long: bool) -> None:
        """Hands on what was evaluated and has lanes evaluated; ``long``: the next time to do so is far away."""
        if self.evaluated:
            self._hand_on()
        if len(self.waiting) >= self.width or (self.waiting and (long or time.monotonic() - self.since > WAIT_SECONDS)):
            self._evaluate()
            if long:
                self._hand_on()

    def _evaluate(self) -> None:
        """Sends up to a group of ended lanes off to be evaluated together."""
        batch, self.waiting = self.waiting[: self.width], self.waiting[self.width :]
        padded = batch + batch[:1] * (self.width - len(batch))
        policy = jax.tree.map(lambda *rows: np.stack(rows), *(entry[2] for entry in padded))
        hypers = self.stack_ended([entry[0].lane.hypers for entry in padded])
        seeds = np.array([entry[0].lane.seed for entry in padded], np.uint32)
        self.evaluated.append((batch, self.built.evaluate(self.root, seeds, policy, hypers)))

    def _hand_on(self) -> None:
        """Emits the results of the group that was sent to its evaluation first."""
        batch, evaluated = self.evaluated.pop(0)
        results = []
        for (done, status, weights), row in zip(batch, np.array(evaluated), strict=False):
            returned = None if status == "diverged" else row
            results.append(Result(**done._asdict(), status=status, policy=weights, eval_returns=returned))
        self.shared.results.put(results)  # together: whoever waits for them needs the interpreter too


def _row(i: int, rows: np.ndarray) -> np.ndarray:
    return rows[i].copy()


def _copy(clock: Clock) -> Clock:
    """The numbers of a clock, which the next segment will overwrite."""
    return jax.tree.map(np.array, clock)


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
