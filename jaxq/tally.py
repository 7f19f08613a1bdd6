"""What a lane has done: its episodes and curve, gathered from the logs of its segments."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
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


class Segment(NamedTuple):
    """A lane's totals at the end of a segment; means over the segment, NaN where there was nothing to average."""

    env_steps: int
    episodes: int
    updates: int
    train_return: float
    loss: float
    max_q: float
    epsilon: float


@dataclass(frozen=True)
class Result:
    """A lane that ended."""

    lane: Lane
    status: str
    env_steps: int
    updates: int
    episodes: Episodes
    curve: list[Segment]
    policy: PyTree
    eval_returns: np.ndarray | None  # None for a diverged lane
    max_q: np.ndarray | None  # of every update, when asked for


@dataclass
class Slot:
    """A lane under way, and what it has done so far."""

    lane: Lane
    env_steps: int = 0
    updates: int = 0
    chunks: list[tuple[np.ndarray, ...]] = field(default_factory=list)
    curve: list[Segment] = field(default_factory=list)
    max_q: list[np.ndarray] = field(default_factory=list)

    def share(self) -> float:
        """The part of a lane that is surely done: it may end before its limits."""
        limits = self.lane.hypers.run
        done = [self.env_steps / max(1, float(limits.max_env_steps))]
        if self.curve:
            done.append(self.curve[-1].episodes / max(1, float(limits.max_episodes)))
        return min(1.0, max(done))

    def episodes(self, num_envs: int) -> Episodes:
        """The finished episodes so far."""
        if not self.chunks:
            nothing = np.zeros(0)
            return Episodes(nothing.astype(int), nothing.astype(int), nothing, nothing)
        tick, env, returns, max_q = (np.concatenate(column) for column in zip(*self.chunks, strict=True))
        length = np.empty(tick.shape, int)
        for n in range(num_envs):
            own = env == n
            length[own] = np.diff(tick[own], prepend=-1)
        return Episodes((tick + 1) * num_envs, length, returns.astype(float), max_q.astype(float))


def absorb(
    slots: Sequence[Slot | None], which: np.ndarray, clock: Clock, log: Log, program: Program, keep_max_q: bool
) -> tuple[int, int]:
    """Sorts a group's log into its slots, those that ``which`` marks; returns the env steps and updates that were done.

    Shapes: which [L] bool; clock of [L]; log as ``Executables.advance`` returns it.
    """
    env_steps, updates, episodes = (np.asarray(x) for x in (clock.env_steps, clock.updates, clock.episodes))
    over, total, max_q, loss, epsilon = (np.asarray(x) for x in log)
    _, width, per_round, num_envs = over.shape
    before = np.array([slot.env_steps if slot else 0 for slot in slots])
    valid = np.where(which, (env_steps - before) // (per_round * num_envs), 0)
    u, lane, t, n = np.unravel_index(np.flatnonzero(over), over.shape)
    inside = u < valid[lane]
    u, lane, t, n = u[inside], lane[inside], t[inside], n[inside]
    order = np.argsort(lane, kind="stable")
    edges = np.searchsorted(lane[order], np.arange(width + 1))
    tick = before[lane] // num_envs + u * per_round + t
    returns, values = total[u, lane, t, n], max_q[u, lane]
    mean_return = np.bincount(lane, returns, width) / np.maximum(np.bincount(lane, minlength=width), 1)
    mean_loss, mean_q = _means(loss, valid), _means(max_q, valid)
    done_steps = done_updates = 0
    for i in np.flatnonzero(which).tolist():
        slot = slots[i]
        assert slot is not None
        mine = order[edges[i] : edges[i + 1]]
        if mine.size:
            slot.chunks.append((tick[mine], n[mine], returns[mine], values[mine]))
        learned = updates[i] > slot.updates
        done_steps, done_updates = done_steps + env_steps[i] - slot.env_steps, done_updates + updates[i] - slot.updates
        slot.env_steps, slot.updates = int(env_steps[i]), int(updates[i])
        if valid[i]:
            slot.curve.append(
                Segment(
                    env_steps=slot.env_steps,
                    episodes=int(episodes[i]),
                    updates=slot.updates,
                    train_return=float(mean_return[i]) if mine.size else float("nan"),
                    loss=float(mean_loss[i]) if learned else float("nan"),
                    max_q=float(mean_q[i]) if learned else float("nan"),
                    epsilon=float(epsilon[i]),
                )
            )
            if keep_max_q:
                slot.max_q.append(max_q[: valid[i], i].copy())
    return int(done_steps), int(done_updates)


def _means(values: np.ndarray, valid: np.ndarray) -> np.ndarray:
    """Mean of each lane's valid rows. Shapes: values [U, L], valid [L] -> [L].

    Each lane's sum goes down its own column, whatever its neighbours do.
    """
    summed = np.einsum("ul->l", values)  # many times quicker than a sum along the first axis
    for i in np.flatnonzero((valid > 0) & (valid < len(values))):
        summed[i] = values[: valid[i], i].sum()
    return summed / np.maximum(valid, 1)
