"""The engine's workers: a group of slots each, kept full from a shared queue of lanes.

While XLA runs a segment of a group, its worker does the books of the segment before: who ended, what they did, whose
evaluation is due. Only what the next segment needs, which lanes ended and who takes their slots, is done in between.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any, NamedTuple

import jax
import numpy as np

from jaxq.executables import Executables
from jaxq.experiment import Log
from jaxq.rounds import RUNNING, STATUS
from jaxq.shared import Ended, Shared
from jaxq.slots import Stack, copied, row_of, with_rows
from jaxq.tally import Books, Done, Lane, Result, Saved, Tally
from jaxq.types import Clock, Hypers, PyTree

#: Ended lanes wait for company, so that a whole group is evaluated at once, but no longer than this where a segment
#: is shorter.
WAIT_SECONDS = 1.0


@dataclass
class _Segment:
    """A segment of a group, from the lanes that took a slot at its beginning to those that ended in it."""

    began: float
    entered: list[tuple[int, Lane, Books | None]]
    live: np.ndarray  # [L] slots that hold a lane
    warm_up: tuple[np.ndarray, Clock, Log] | None  # which lanes made one, their clock after it, what it logged
    log: Log
    pending: bool  # lanes were waiting for a slot
    sent: float
    running: float  # the last time that it was known to run
    clock: Any = None
    status: Any = None
    ended: list[int] = field(default_factory=list)  # or paused: their status is still RUNNING
    due: list[int] = field(default_factory=list)  # lanes that go on or pause, and are to be evaluated
    seeds: Any = None  # of all slots, and their numbers and policies, where a lane ended or is due
    hypers: Hypers | None = None
    policies: PyTree = None
    states: dict[int, PyTree] = field(default_factory=dict)  # of paused lanes

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
        self.steps = np.zeros(self.width, int)  # env steps of the lanes that are held, when they were last looked at
        self.heedful = False  # whether a lane had orders to pause or to be evaluated
        self.since_saved = np.zeros(self.width)  # when they got their slot, or were last saved
        self.states: dict[int, tuple[Lane, PyTree]] = {}  # copies to be saved once their books are done
        self.numbers: list[Hypers | None] = [None] * self.width  # of each slot, the last lane's where it is free
        self.stack, self.stack_ended = Stack(), Stack()
        self.hypers: Hypers | None = None
        self.state = jax.tree.map(lambda leaf: np.zeros(leaf.shape, leaf.dtype), built.empty)
        self.sent: _Segment | None = None  # what XLA runs
        self.open: _Segment | None = None  # the segment before it, whose books are to be done
        self.waiting: list[_Waiting] = []  # ended, not yet evaluated
        self.waited_since = 0.0  # when the first of them ended
        self.evaluated: list[tuple[list[_Waiting], jax.Array]] = []  # not yet handed on

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
        if self.shared.stop.is_set() and self.shared.checkpoint_s is not None:
            attempt(lambda: self._copy_states(seconds=0.0))
            attempt(self._save)
        while self.waiting:  # an evaluation that fails costs its own group alone
            attempt(self._evaluate)
        while self.evaluated:
            attempt(self._hand_on)
        self.shared.results.put(Ended(error))

    def _work(self) -> None:
        while not self.shared.stopping() and self._send():
            self._do_books()
            self._save()
            self._receive()

    def _send(self) -> bool:
        """Fills free slots from the queue and starts a segment; False when no slot holds a lane."""
        if self.shared.checkpoint_s is not None:
            self._copy_states(self.shared.checkpoint_s)
        began, entered, warm_up = time.monotonic(), [], None
        fresh, resumed = np.zeros(self.width, bool), {}
        for i, held in enumerate(self.held):
            if held is None and (lane := self.shared.take()) is not None:
                saved = lane.resume() if lane.resume else None
                self.held[i] = lane
                self.seeds[i], fresh[i], self.numbers[i] = lane.seed, saved is None, lane.hypers
                self.steps[i], self.since_saved[i] = saved.books.counts[0] if saved else 0, began
                self.heedful = self.heedful or bool(lane.eval_every or lane.pause_at)
                entered.append((i, lane, saved.books if saved else None))
                if saved:
                    resumed[i] = saved.state
        live = np.array([lane is not None for lane in self.held])
        if not live.any():
            return False
        if entered:
            some = next(numbers for numbers in self.numbers if numbers is not None)
            self.hypers = self.stack([some if numbers is None else numbers for numbers in self.numbers])
        if fresh.any():
            self.state, log = self.built.start(self.root, self.state, fresh, self.seeds.copy(), self.hypers)
            if len(log.over):
                warm_up = fresh, copied(self.state.clock), log
        if resumed:
            self.state = with_rows(self.state, resumed)
        self.state, log = self.built.advance(self.state, self.hypers)
        now = time.monotonic()
        self.sent = _Segment(began, entered, live, warm_up, log, self.shared.pending(), sent=now, running=now)
        return True

    def _receive(self) -> None:
        """Waits for the segment and frees the slots of the lanes that ended or pause."""
        segment, self.sent = self.sent, None
        if segment is None:
            return
        waited = not self.state.status.is_ready()
        jax.block_until_ready(self.state.status)
        if waited:
            segment.running = time.monotonic()
        segment.clock, segment.status = copied(self.state.clock), np.array(self.state.status)
        segment.ended = np.flatnonzero(segment.live & (segment.status != RUNNING)).tolist()
        if self.heedful:
            self._look_at_orders(segment)
        if segment.ended or segment.due:
            segment.policies = self.built.policy(self.state, self.hypers)
            segment.seeds, segment.hypers = self.seeds.copy(), self.hypers
            for i in segment.ended:
                self.held[i] = None
        self.open = segment

    def _look_at_orders(self, segment: _Segment) -> None:
        """Which of the lanes that go on are to pause or to be evaluated."""
        steps, episodes = segment.clock.env_steps, segment.clock.episodes
        for i, lane in enumerate(self.held):
            if lane is None or segment.status[i] != RUNNING:
                continue
            at = lane.pause_at
            if lane.eval_every and steps[i] // lane.eval_every > self.steps[i] // lane.eval_every:
                segment.due.append(i)
            if at is not None and (steps[i] >= at.env_steps or episodes[i] >= at.episodes):
                segment.ended.append(i)
                segment.states[i] = row_of(i, self.state)
        self.steps = np.array(steps)

    def _do_books(self) -> None:
        """The books of the segment before, while XLA runs the next."""
        segment, self.open = self.open, None
        if segment is None:
            return
        for i, lane, before in segment.entered:
            self.tally.enter(i, lane, before)
        warm_up_steps = 0
        if segment.warm_up:
            warm_up_steps, _ = self.tally.book(*segment.warm_up)
        steps, updates = self.tally.book(segment.live, segment.clock, segment.log)
        if segment.due:
            returns = self.built.evaluate(self.root, segment.seeds, segment.policies, segment.hypers)
            self.tally.evaluated(segment.due, np.asarray(returns).mean(axis=1, dtype=float))
        self._look()
        if self.shared.watched:
            for i in np.flatnonzero(segment.live).tolist():
                self.shared.results.put((self.tally.slots[i], self.tally.so_far(i)))
        paused = float(self.tally.shares()[list(segment.states)].sum()) if segment.states else 0.0
        names = self._leave(segment) if segment.ended else []
        share = float(self.tally.shares().sum())
        self.shared.count(id(self), share, warm_up_steps + steps, updates, names, paused)
        if segment.pending:
            seconds = (self.sent.began if self.sent else time.monotonic()) - segment.began
            self.shared.account(seconds, segment.useful_s(steps))
        self._pass_on(long=segment.running - segment.sent > WAIT_SECONDS)

    def _copy_states(self, seconds: float) -> None:
        """Copies what the lanes are that were not saved for so long."""
        now = time.monotonic()
        for i, lane in enumerate(self.held):
            if lane is not None and now - self.since_saved[i] >= seconds:
                self.states[i], self.since_saved[i] = (lane, row_of(i, self.state)), now

    def _save(self) -> None:
        """Hands on the lanes that were copied, with their books, which are done by now."""
        states, self.states = self.states, {}
        for i, (lane, state) in states.items():
            if self.tally.slots[i] is lane:
                self.shared.results.put(Saved(lane, state, self.tally.books(i)))

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
                self.waited_since = time.monotonic()
            state = segment.states.get(i) if names[-1] == "paused" else None
            self.waiting.append(_Waiting(self.tally.leave(i), names[-1], row_of(i, policies), state))
            self._look()
        return names

    def _pass_on(self, long: bool) -> None:
        """Hands on what was evaluated and has lanes evaluated; ``long``: the next time to do so is far away."""
        if self.evaluated:
            self._hand_on()
        if len(self.waiting) >= self.width or (
            self.waiting and (long or time.monotonic() - self.waited_since > WAIT_SECONDS)
        ):
            self._evaluate()
            if long:
                self._hand_on()

    def _evaluate(self) -> None:
        """Sends up to a group of ended lanes off to be evaluated together."""
        batch, self.waiting = self.waiting[: self.width], self.waiting[self.width :]
        padded = batch + batch[:1] * (self.width - len(batch))
        policy = jax.tree.map(lambda *rows: np.stack(rows), *(entry.policy for entry in padded))
        hypers = self.stack_ended([entry.done.lane.hypers for entry in padded])
        seeds = np.array([entry.done.lane.seed for entry in padded], np.uint32)
        self.evaluated.append((batch, self.built.evaluate(self.root, seeds, policy, hypers)))

    def _hand_on(self) -> None:
        """Emits the results of the group that was sent to its evaluation first."""
        batch, evaluated = self.evaluated.pop(0)
        results = []
        for (done, status, policy, state), row in zip(batch, np.array(evaluated), strict=False):
            returned = None if status == "diverged" else row
            saved = None if state is None else Saved(done.lane, state, done.books)
            named = {name: value for name, value in done._asdict().items() if name != "books"}
            results.append(Result(**named, status=status, policy=policy, eval_returns=returned, saved=saved))
        self.shared.results.put(results)  # together: whoever waits for them needs the interpreter too


class _Waiting(NamedTuple):
    """A lane that left its group, not yet evaluated."""

    done: Done
    status: str
    policy: PyTree
    state: PyTree  # of a paused lane
