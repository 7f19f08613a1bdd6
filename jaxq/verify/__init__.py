"""Whether this installation computes what it says, on this machine: against Gymnasium, NumPy, JAX and itself.

Nothing here imports jax before a group is run.

>>> [check.ok for check in run(["keys"], cases=50)][:1]
[True]
"""

from __future__ import annotations

import importlib
import threading
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from importlib import metadata

from jaxq.suggest import nearest
from jaxq.verify import checks
from jaxq.verify.checks import Check, Found, Job

__all__ = ["CASES", "GROUPS", "PACKAGES", "Check", "jobs", "run", "versions"]

#: The groups of checks and what each compares, in the order in which they run; each is a module here.
GROUPS = {
    "environments": "every environment with Gymnasium's: steps from any state, episodes, tables of outcomes",
    "rules": "every rule with float64 NumPy",
    "keys": "key streams with JAX's and with the published hash",
    "lanes": "a lane alone with the same lane among others, bit for bit",
    "compiles": "one compiled program for all numbers of a structure",
}
#: Those that wait for XLA most of the time, half of the work: they run beside the others, in their order.
BESIDE = ("rules", "lanes", "compiles")
#: What the figures depend on.
PACKAGES = ("jax", "jaxlib", "gymnasium", "numpy")
#: Random states of each environment, and a measure of how much the other groups do.
CASES = 1000


def versions() -> dict[str, str]:
    """The versions of the packages that the figures depend on."""
    found = {}
    for name in PACKAGES:
        try:
            found[name] = metadata.version(name)
        except metadata.PackageNotFoundError:
            found[name] = "missing"
    return found


def jobs(only: Sequence[str] = (), *, cases: int = CASES, against: str | None = None) -> list[Job]:
    """The checks of these groups, of all when none is named.

    ``against`` is the id of another environment of Gymnasium's to compare with, whose last part is a name of ours
    ("phys2d/CartPole-v1"); then only that environment is checked. Raises ValueError for an unknown group or
    environment, with the nearest, and for ``cases`` below 1.
    """
    for name in only:
        if name not in GROUPS:
            raise ValueError(f"group: {name!r} is unknown{nearest(name, GROUPS)}")
    if not 1 <= cases <= 10**6:
        raise ValueError(f"cases: {cases} is not allowed: from 1 to {10**6}")
    if against is not None:
        if any(name != "environments" for name in only):
            raise ValueError(f"against: {against!r} is not allowed beside {', '.join(only)}: environments alone")
        return list(importlib.import_module("jaxq.verify.environments").jobs(cases, against))
    return [job for name in GROUPS if name in only or not only for job in _jobs_of(name, cases)]


def _jobs_of(group: str, cases: int) -> list[Job]:
    """A group that cannot be imported is one check, which is off."""
    try:
        return list(importlib.import_module(f"jaxq.verify.{group}").jobs(cases))
    except ImportError as error:
        failure = error

    def fails() -> Found:
        raise failure

    return [Job(group, "can be imported", "-", fails)]


def run(
    only: Sequence[str] = (),
    *,
    cases: int = CASES,
    against: str | None = None,
    told: Callable[[float, float, str], None] = lambda done, total, name: None,
) -> list[Check]:
    """Runs the checks of these groups and returns a line each; raises ValueError as ``jobs``.

    ``told(done, total, name)`` hears of each before it runs; done and total are costs. Two threads call it.
    """
    chosen = jobs(only, cases=cases, against=against)
    shares = [[i for i, job in enumerate(chosen) if (job.group in BESIDE) is beside] for beside in (False, True)]
    found: dict[int, Check] = {}
    stopped = threading.Event()

    def work(share: list[int]) -> None:
        for i in share:
            if stopped.is_set():
                return
            done = sum(chosen[k].cost for k in list(found))
            told(done, sum(job.cost for job in chosen), f"{chosen[i].group}: {chosen[i].name}")
            found[i] = checks.run(chosen[i])

    with ThreadPoolExecutor(1) as pool:
        beside = pool.submit(work, shares[1])
        try:
            work(shares[0])
            beside.result()
        finally:
            stopped.set()
    return [found[i] for i in range(len(chosen))]
