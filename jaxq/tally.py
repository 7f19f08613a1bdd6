"""What lanes have done: their episodes and curves, gathered from the logs of a group's segments.

A segment is booked for the whole group at once; what one lane did is picked out of the books when it ends.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from jaxq.experiment import Log
from jaxq.programs import Program
from jaxq.types import Clock, Hypers, PyTree


class Lane(NamedTuple):
    """One training to be done: a setting's index and numbers, and a seed index.

    It is evaluated every ``eval_every`` env steps, at the end of a segment, if that is not 0. It pauses at the end of
    the first segment after which it has made ``pause_at.env_steps`` steps or ``pause_at.episodes`` episodes. ``resume``
    loads what it was when it was saved; None, or where that gives None, it begins anew.
    """

    config: int
    seed: int
    hypers: Hypers
    eval_every: int = 0
    pause_at: PauseAt | None = None
    resume: Callable[[], Saved | None] | None = None


class PauseAt(NamedTuple):
    """Where lanes pause."""

    env_steps: float
    episodes: float


class Books(NamedTuple):
    """What a lane has done until it was saved, as arrays."""

    counts: np.ndarray  # [3] env steps, updates, episodes
    ended: np.ndarray  # [4, E] as in a segment's record
    curve: np.ndarray  # [8, S], the fields of Curve
    max_q: np.ndarray | None  # [updates], where it is kept


@dataclass(frozen=True)
class Saved:
    """A lane between two segments: all that it needs to go on, bit for bit."""

    lane: Lane
    state: PyTree  # NumPy leaves, of one lane
    books: Books


class Episodes(NamedTuple):
    """The finished episodes of a lane, in the order in which they ended; arrays of one length."""

    env_steps: np.ndarray  # of the lane, when the episode ended
    length: np.ndarray
    total: np.ndarray  # the return
    max_q: np.ndarray  # of the update at its last step; NaN in the warm-up


class Curve(NamedTuple):
    """A lane's totals at the end of each segment; means over the segment, NaN where there was nothing to average.
    Arrays of one length, float64."""

    env_steps: np.ndarray
    episodes: np.ndarray
    updates: np.ndarray
    train_return: np.ndarray
    loss: np.ndarray
    max_q: np.ndarray
    epsilon: np.ndarray
    eval_return: np.ndarray  # NaN where there was no evaluation


@dataclass(frozen=True)
class Result:
    """A lane that ended, or paused: then ``saved`` is what it was."""

    lane: Lane
    status: str
    env_steps: int
    updates: int
    episodes: Episodes
    curve: Curve
    policy: PyTree
    eval_returns: np.ndarray | None  # None for a diverged lane
    max_q: np.ndarray | None  # [updates] of every update, when asked for
    saved: Saved | None = None


class Done(NamedTuple):
    """A lane that has left its group, before its evaluation."""

    lane: Lane
    env_steps: int
    updates: int
    episodes: Episodes
    curve: Curve
    max_q: np.ndarray | None
    books: Books


class _Record(NamedTuple):
    """A segment of the group: a column per finished episode, slot after slot, and one per lane."""

    ended: np.ndarray  # [4, E]: environment, steps before the episode's last, return, max_q at its last step
    starts: np.ndarray  # [L + 1] each slot's first column of these
    valid: np.ndarray  # [L] rounds that count
    curve: np.ndarray  # [8, L], the fields of Curve
    max_q: np.ndarray | None  # [U, L], where it is kept


class Tally:
    """The books of one group. ``slots`` [L] holds the lane of each slot, None where it is free.

    ``keep_max_q``: the value of every update is kept, for ``jaxq train``.
    """

    def __init__(self, program: Program, keep_max_q: bool):
        self.program, self.keep_max_q = program, keep_max_q
        self.slots: list[Lane | None] = [None] * program.width
        self.env_steps, self.updates, self.episodes = (np.zeros(program.width, int) for _ in range(3))
        self.limits = np.ones((2, program.width))  # of env steps and episodes
        self.first = [0] * program.width  # each lane's first record, counted from the beginning
        self.records: list[_Record] = []
        self.dropped = 0
        self.before: list[Books] = [_NOTHING] * program.width  # of each lane, what it did before it was resumed

    def enter(self, slot: int, lane: Lane, before: Books | None = None) -> None:
        """A lane takes a free slot; ``before`` is what it has done already."""
        self.slots[slot], self.first[slot] = lane, self.dropped + len(self.records)
        self.before[slot] = before or _NOTHING
        self.env_steps[slot], self.updates[slot], self.episodes[slot] = self.before[slot].counts.tolist()
        self.limits[:, slot] = max(1, lane.hypers.run.max_env_steps), max(1, lane.hypers.run.max_episodes)

    def book(self, which: np.ndarray, clock: Clock, log: Log) -> tuple[int, int]:
        """Books a log of the lanes that ``which`` marks; returns the env steps and updates that they made.

        Shapes: which [L] bool; clock of [L]; log as ``Executables.advance`` returns it.
        """
        env_steps, updates, episodes = (
            np.where(which, now, before)
            for now, before in (
                (clock.env_steps, self.env_steps),
                (clock.updates, self.updates),
                (clock.episodes, self.episodes),
            )
        )
        over, total, max_q, loss, epsilon = (np.asarray(x) for x in log)
        _, width, per_round, num_envs = over.shape
        valid = (env_steps - self.env_steps) // (per_round * num_envs)
        u, lane, t, n = np.unravel_index(np.flatnonzero(over), over.shape)
        inside = np.flatnonzero(u < valid[lane])
        inside = inside[np.argsort(lane[inside], kind="stable")]  # in the order of time within a slot
        u, lane, t, n = u[inside], lane[inside], t[inside], n[inside]
        returns = total[u, lane, t, n]
        ended = np.bincount(lane, minlength=width)
        learned = updates > self.updates
        with np.errstate(invalid="ignore"):
            mean_return = np.bincount(lane, returns, width) / np.where(ended > 0, ended, np.nan)
            mean_loss, mean_q = (np.where(learned, _means(values, valid), np.nan) for values in (loss, max_q))
        tick = self.env_steps[lane] // num_envs + u * per_round + t
        self.records.append(
            _Record(
                ended=np.array([n, tick, returns, max_q[u, lane]], float),
                starts=np.concatenate([[0], np.cumsum(ended)]),
                valid=valid,
                curve=np.array(
                    [env_steps, episodes, updates, mean_return, mean_loss, mean_q, epsilon, np.full(width, np.nan)],
                    float,
                ),
                max_q=max_q if self.keep_max_q and learned.any() else None,  # a warm-up has no updates
            )
        )
        made = int((env_steps - self.env_steps).sum()), int((updates - self.updates).sum())
        self.env_steps, self.updates, self.episodes = env_steps, updates, episodes
        return made

    def evaluated(self, slots: list[int], returns: np.ndarray) -> None:
        """Notes the mean greedy return of these slots at the end of the segment that was booked last. returns [L]."""
        self.records[-1].curve[Curve._fields.index("eval_return"), slots] = returns[slots]

    def shares(self) -> np.ndarray:
        """The part of each lane that is surely done, 0 in a free slot: it may end before its limits. [L]"""
        held = [lane is not None for lane in self.slots]
        return np.where(held, np.minimum(1, np.max([self.env_steps, self.episodes] / self.limits, axis=0)), 0.0)

    def so_far(self, slot: int) -> Episodes:
        """The episodes that the lane in ``slot`` has finished."""
        return _episodes(self._ended(slot), self.program.num_envs)

    def books(self, slot: int) -> Books:
        """What the lane in ``slot`` has done."""
        before, records = self.before[slot], self._records_of(slot)
        counts = np.array([self.env_steps[slot], self.updates[slot], self.episodes[slot]])
        curves = [r.curve[:, slot, None] for r in records]
        values = [r.max_q[: r.valid[slot], slot] for r in records if r.max_q is not None]
        kept = [np.zeros(0, np.float32) if before.max_q is None else before.max_q, *values]
        return Books(
            counts=counts,
            ended=self._ended(slot),
            curve=np.concatenate([before.curve, *curves], axis=1),
            max_q=np.concatenate(kept) if self.keep_max_q else None,
        )

    def _records_of(self, slot: int) -> list[_Record]:
        return [r for r in self.records[self.first[slot] - self.dropped :] if r.valid[slot] > 0]

    def _ended(self, slot: int) -> np.ndarray:
        """The finished episodes of a slot, [4, E]."""
        parts = [r.ended[:, r.starts[slot] : r.starts[slot + 1]] for r in self._records_of(slot)]
        return np.concatenate([self.before[slot].ended, *parts], axis=1)

    def leave(self, slot: int) -> Done:
        """A lane frees its slot, and takes along what it has done. Raises ValueError for a free slot."""
        lane = self.slots[slot]
        if lane is None:
            raise ValueError(f"slot {slot} is free")
        books = self.books(slot)
        done = Done(
            lane=lane,
            env_steps=int(self.env_steps[slot]),
            updates=int(self.updates[slot]),
            episodes=_episodes(books.ended, self.program.num_envs),
            curve=Curve(*books.curve),
            max_q=books.max_q,
            books=books,
        )
        self.slots[slot] = None
        in_use = [first for first, held in zip(self.first, self.slots, strict=True) if held is not None]
        oldest = min(in_use, default=self.dropped + len(self.records))
        del self.records[: oldest - self.dropped]
        self.dropped = oldest
        return done


_NOTHING = Books(np.zeros(3, int), np.zeros((4, 0)), np.zeros((len(Curve._fields), 0)), None)


def result_of(
    lane: Lane, books: Books, num_envs: int, *, status: str, policy: PyTree, eval_returns: np.ndarray | None
) -> Result:
    """A lane that was saved, as a Result."""
    return Result(
        lane=lane,
        status=status,
        env_steps=int(books.counts[0]),
        updates=int(books.counts[1]),
        episodes=_episodes(books.ended, num_envs),
        curve=Curve(*books.curve),
        policy=policy,
        eval_returns=eval_returns,
        max_q=books.max_q,
    )


def _episodes(ended: np.ndarray, num_envs: int) -> Episodes:
    """The finished episodes of a lane. Shapes: ended [4, E]."""
    env, tick, returns, max_q = ended
    tick = tick.astype(int)
    length = np.empty_like(tick)
    for n in range(num_envs):
        own = slice(None) if num_envs == 1 else env == n
        length[own] = _steps_between(tick[own])
    return Episodes((tick + 1) * num_envs, length, returns, max_q)


def _steps_between(tick: np.ndarray) -> np.ndarray:
    """Lengths of episodes that end at these steps, counted from 0, one after the other."""
    length = tick.copy()
    length[1:] -= tick[:-1]
    length[:1] += 1
    return length


def _means(values: np.ndarray, valid: np.ndarray) -> np.ndarray:
    """Mean of each lane's valid rows, in float64. Shapes: values [U, L] float32, valid [L] -> [L].

    Each lane's sum goes down its own column, whatever its neighbours do.
    """
    summed = np.einsum("ul->l", values, dtype=float)  # twice as quick as a sum along the first axis
    for i in np.flatnonzero((valid > 0) & (valid < len(values))):
        summed[i] = values[: valid[i], i].sum(dtype=float)
    return summed / np.maximum(valid, 1)
