"""What a check is, what it finds, and how one that fails is told."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple


class Found(NamedTuple):
    """What a check found: how many cases it looked at, the largest error, the largest that is allowed, where the first
    case that is off differs, or what else there is to say, and how many cases rounding decided."""

    cases: int
    error: float
    allowed: float
    detail: str = ""
    decided: int = 0


@dataclass(frozen=True)
class Job:
    """A check that has not run yet. ``against`` names what it compares with, and its version; ``cost`` is about how
    many seconds it takes, of which the time left is told."""

    group: str
    name: str
    against: str
    work: Callable[[], Found]
    cost: float = 0.3


class Check(NamedTuple):
    """A line of the table. ``error`` and ``allowed`` are None where the check itself could not run."""

    group: str
    name: str
    against: str
    cases: int
    error: float | None
    allowed: float | None
    ok: bool
    detail: str
    decided: int = 0


def run(job: Job) -> Check:
    """Runs a check. An exception in it is a line that is off and says so; Ctrl-C goes on.

    >>> run(Job("rules", "sum", "numpy", lambda: Found(3, 0.5, 0.1))).ok
    False
    >>> run(Job("rules", "sum", "numpy", lambda: Found(1 // 0, 0, 0))).detail
    'ZeroDivisionError: integer division or modulo by zero'
    """
    try:
        found = job.work()
    except Exception as error:
        said = f"{type(error).__name__}: {' '.join(str(error).split())}"
        return Check(job.group, job.name, job.against, 0, None, None, False, said)
    # Not a number is no error that is small enough, and JSON has no name for it.
    error_found = float(found.error) if math.isfinite(found.error) else None
    ok = error_found is not None and error_found <= found.allowed and found.cases > 0
    told = found.detail, found.decided
    return Check(job.group, job.name, job.against, found.cases, error_found, float(found.allowed), ok, *told)
