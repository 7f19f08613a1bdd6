"""What lanes have done: their episodes and curves, gathered from the logs of a group's segments.

A segment is booked for the whole group at once; what one lane did is picked out of the books when it ends.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from jaxq.experiment import Log
from jaxq.programs import Program
from jaxq.types import Clock, Hypers, PyTree


class Lane(NamedTuple):
    """One training to be done: a setting's index and numbers, and a seed index."""

    config: int
    seed: int
    hypers: Hypers


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


@dataclass(frozen=True)
class Result:
    """A lane that ended."""

    lane: Lane
    status: str
    env_steps: int
    updates: int
    episodes: Episodes
    curve: Curve
    policy: PyTree
    eval_returns: np.ndarray | None  # None for a diverged lane
    max_q: np.ndarray | None  # [updates] of every update, when asked for


class Done(NamedTuple):
    """A lane that has left its group, before its evaluation."""

    lane: Lane
    env_steps: int
    updates: int
    episodes: Episodes
    curve: Curve
    max_q: np.ndarray | None


class _Record(NamedTuple):
    """A segment of the group: a column per finished episode, slot after slot, and one per lane."""

    ended: np.ndarray  # [4, E]: environment, steps before the episode's last, return, max_q at its last step
    starts: np.ndarray  # [L + 1] each slot's first column of these
    valid: np.ndarray  # [L] rounds that count
    curve: np.ndarray  # [7, L], the fields of Curve
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

    def enter(self, slot: int, lane: Lane) -> None:
        """A lane takes a free slot."""
        self.slots[slot], self.first[slot] = lane, self.dropped + len(self.records)
        self.env_steps[slot] = self.updates[slot] = self.episodes[slot] = 0
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
                curve=np.array([env_steps, episodes, updates, mean_return, mean_loss, mean_q, epsilon], float),
                max_q=max_q if self.keep_max_q and learned.any() else None,  # a warm-up has no updates
            )
        )
        made = int((env_steps - self.env_steps).sum()), int((updates - self.updates).sum())
        self.env_steps, self.updates, self.episodes = env_steps, updates, episodes
        return made

    def share(self) -> float:
        """The parts of the lanes under way that are surely done, summed: a lane may end before its limits."""
        held = [lane is not None for lane in self.slots]
        return float(np.minimum(1, np.max([self.env_steps, self.episodes] / self.limits, axis=0))[held].sum())

    def so_far(self, slot: int) -> Episodes:
        """The episodes that the lane in ``slot`` has finished."""
        return _episodes(self._records_of(slot), slot, self.program.num_envs)

    def _records_of(self, slot: int) -> list[_Record]:
        return [r for r in self.records[self.first[slot] - self.dropped :] if r.valid[slot] > 0]

    def leave(self, slot: int) -> Done:
        """A lane frees its slot, and takes along what it has done. Raises ValueError for a free slot."""
        lane = self.slots[slot]
        if lane is None:
            raise ValueError(f"slot {slot} is free")
        records = self._records_of(slot)
        values = [r.max_q[: r.valid[slot], slot] for r in records if r.max_q is not None]
        done = Done(
            lane=lane,
            env_steps=int(self.env_steps[slot]),
            updates=int(self.updates[slot]),
            episodes=_episodes(records, slot, self.program.num_envs),
            curve=Curve(*(np.stack([r.curve[:, slot] for r in records], axis=1) if records else np.zeros((7, 0)))),
            max_q=np.concatenate([np.zeros(0, np.float32), *values]) if self.keep_max_q else None,
        )
        self.slots[slot] = None
        in_use = [first for first, held in zip(self.first, self.slots, strict=True) if held is not None]
        oldest = min(in_use, default=self.dropped + len(self.records))
        del self.records[: oldest - self.dropped]
        self.dropped = oldest
        return done


def _episodes(records: list[_Record], slot: int, num_envs: int) -> Episodes:
    """The finished episodes of a slot in these records."""
    parts = [r.ended[:, r.starts[slot] : r.starts[slot + 1]] for r in records]
    env, tick, returns, max_q = np.concatenate(parts, axis=1) if parts else np.zeros((4, 0))
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
