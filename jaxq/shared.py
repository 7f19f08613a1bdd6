"""What the engine's workers share: the queue of pending lanes, the results, the progress, the request to stop."""

from __future__ import annotations

import queue
import threading
import time
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

from jaxq.tally import Lane


@dataclass
class Progress:
    """What has been done so far; ``share`` counts the lanes that ended and the parts of those under way or paused.

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
    """What the workers share. ``checkpoint_s``: a lane that is longer under way is saved every so many seconds, and
    when the run is stopped; None saves none.
    """

    def __init__(
        self,
        lanes: Iterator[Lane],
        progress: Progress,
        stop: threading.Event,
        *,
        watched: bool,
        checkpoint_s: float | None,
    ):
        self.lanes, self.progress, self.stop, self.closed = lanes, progress, stop, False
        self.watched, self.checkpoint_s = watched, checkpoint_s
        self.next = next(lanes, None)  # known ahead, so that who takes the last lane can tell
        self.results: queue.SimpleQueue[Any] = queue.SimpleQueue()
        self.lock = threading.Lock()
        self.shares: dict[int, float] = {}
        self.paused = 0.0

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

    def count(
        self, worker: int, share: float, env_steps: int, updates: int, ended: list[str], paused: float = 0.0
    ) -> None:
        """What a segment did: ``ended`` by status, ``paused`` the parts that the paused ones of them have done."""
        with self.lock:
            self.shares[worker] = share
            self.paused += paused
            p = self.progress
            p.env_steps += env_steps
            p.updates += updates
            p.done += len(ended) - ended.count("paused")
            p.solved += ended.count("solved")
            p.diverged += ended.count("diverged")
            p.share = p.done + self.paused + sum(self.shares.values())
