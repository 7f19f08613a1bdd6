"""Fewer cores than there are, for a whole process."""

from __future__ import annotations

import os
import sys
from collections.abc import Iterable, Iterator
from contextlib import contextmanager, suppress


@contextmanager
def on(cores: int) -> Iterator[None]:
    """All threads of this process on the first ``cores`` that it may use; but for Linux, wherever the system likes."""
    if sys.platform != "linux":
        yield
        return
    allowed = os.sched_getaffinity(0)
    _hold(sorted(allowed)[:cores])
    try:
        yield
    finally:
        _hold(allowed)


def not_held(backend: str) -> str | None:
    """Why the cores of a process on that backend of JAX are not all that it runs on; None where they are."""
    if backend != "cpu":
        return "workers, not cores: lanes run on the accelerator"
    return None if sys.platform == "linux" else "workers, not cores: this system cannot hold a process to some"


def _hold(cores: Iterable[int]) -> None:
    if sys.platform == "linux":
        for thread in os.listdir("/proc/self/task"):
            with suppress(ProcessLookupError):  # one that has just ended
                os.sched_setaffinity(int(thread), cores)
