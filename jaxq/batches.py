"""Batches: results gather until they are worth a file, and are written together."""

from __future__ import annotations

import heapq
import time
from collections.abc import Callable, Sequence
from typing import Any

import pyarrow as pa

from jaxq import saved_policy, tables
from jaxq.presets import Training
from jaxq.store import Store
from jaxq.tally import Result

#: Results are written once this many have gathered or this many seconds have passed.
BATCH_LANES, BATCH_SECONDS = 512, 2.0


class Batches:
    """Turns results into tables and writes them in batches; ``committed`` is told which lanes a batch held.

    Policies are kept of all lanes, or of each lane that is among the best ``keep`` of those that came before it, by
    greedy return: at the end the best ``keep`` are there, with some that were among them for a while.
    """

    def __init__(
        self,
        store: Store,
        settings: Sequence[Any],
        keep_episodes: bool,
        keep: int | None,
        committed: Callable[[list[tuple[int, int]]], None],
    ):
        self.store, self.settings, self.keep_episodes, self.keep = store, settings, keep_episodes, keep
        self.committed = committed
        self.best: list[float] = []
        lanes = store.table("lanes") if keep is not None else None
        if lanes is not None:
            for value in lanes["eval_return"].drop_null().to_pylist():
                self._is_among_best(value)
        self._clear()

    def _clear(self) -> None:
        self.results: dict[int | None, list[Result]] = {}  # by the rung where they were stopped
        self.since = time.monotonic()

    def add(self, result: Result, rung: int | None = None) -> None:
        """A lane that ended; with ``rung``, that was stopped there."""
        self.results.setdefault(rung, []).append(result)
        self.flush_if_due()

    def flush_if_due(self) -> None:
        """Writes what has gathered if it is much, or old."""
        if sum(map(len, self.results.values())) >= BATCH_LANES or time.monotonic() - self.since > BATCH_SECONDS:
            self.flush()

    def flush(self) -> None:
        """Writes what has gathered."""
        held = self.results
        self._clear()  # first, so that a write that fails is not tried again under another number
        results = [result for group in held.values() for result in group]
        if not results:
            return
        made = {"lanes": pa.concat_tables([tables.lanes(group, self.settings, rung) for rung, group in held.items()])}
        made["curves"] = tables.curves(results)
        if self.keep_episodes:
            made["episodes"] = tables.episodes(results)
        policies = {result.lane[:2]: saved_policy.flatten(result.policy) for result in results if self._keeps(result)}
        self.store.write(made, policies, saved_policy.described(self.settings, policies))
        self.committed([result.lane[:2] for result in results])

    def _keeps(self, result: Result) -> bool:
        if not isinstance(self.settings[result.lane.config], Training):
            return False  # what a function returned stands in the tables
        if self.keep is None:
            return True
        returns = result.eval_returns
        return returns is not None and self._is_among_best(float(returns.mean(dtype=float)))

    def _is_among_best(self, value: float) -> bool:
        if self.keep is None or len(self.best) < self.keep:
            heapq.heappush(self.best, value)
            return True
        return heapq.heappushpop(self.best, value) < value
