"""EnvPool's CartPole-v1 in C++ under random actions: environment steps per second, on all cores.

The pool is synchronous, every call steps every environment. In the peer's favour the number of threads is the fastest
of those that are tried before the clock runs, all actions are drawn beforehand, and a call in which an environment only
resets is a step.
"""

from __future__ import annotations

import os
import time
from collections.abc import Callable
from typing import Any

PACKAGES = ("envpool", "numpy", "gymnasium")

#: Environment steps of a bout, about; and its calls of ``step``.
BOUT = 2**19
CALLS = range(8, 8192)


def prepare(case: str) -> Callable[[], float]:
    """``case`` environments. Units: environment steps."""
    import envpool
    import numpy as np

    count = int(case)
    calls = min(max(BOUT // count, CALLS.start), CALLS.stop)
    actions = np.random.default_rng(0).integers(0, 2, (calls, count)).astype(np.int32)

    def bout_of(threads: int) -> Callable[[], float]:
        pool = envpool.make("CartPole-v1", env_type="gymnasium", num_envs=count, num_threads=threads, seed=0)
        pool.reset()

        def bout() -> float:
            for chosen in actions:
                pool.step(chosen)
            return float(calls * count)

        return bout

    return fastest([bout_of(threads) for threads in range(1, 1 + min(count, cores()))])


def cores() -> int:
    """The cores that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def fastest(bouts: list[Callable[[], Any]]) -> Callable[[], Any]:
    """The bout that takes the least time, of two tries each."""
    times = {}
    for bout in bouts * 2:
        began = time.perf_counter()
        bout()
        times[bout] = min(times.get(bout, float("inf")), time.perf_counter() - began)
    return min(times, key=times.__getitem__)
