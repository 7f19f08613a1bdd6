"""Sweeps: a plan's lanes go through the engine into tables, and into a run directory as they come."""

from __future__ import annotations

import contextlib
import threading
from collections.abc import Callable
from pathlib import Path
from typing import Any

from jaxq import estimate, functions
from jaxq.compile_cache import CompileCache
from jaxq.memory_run import MemoryRun
from jaxq.outcome import Outcome
from jaxq.plans import Plan, plan
from jaxq.requests import whole
from jaxq.runs import RunDirectory
from jaxq.stages import Listeners, Sweep
from jaxq.store import Store
from jaxq.tally import Result


def run(
    planned: Plan,
    *,
    directory: Store | None = None,
    keep_episodes: bool = False,
    keep_max_q: bool = False,
    keep: int | None = None,
    workers: int | None = None,
    cache: CompileCache | None = None,
    checkpoint_s: float = 60.0,
    tell: Listeners | None = None,
    stop: threading.Event | None = None,
) -> Outcome:
    """Runs all lanes that ``directory`` does not hold yet, writing results there as they come.

    Policies of the best ``keep`` lanes are kept, of all by default. What ``cache`` holds is not compiled again. Lanes
    under way are saved every ``checkpoint_s`` seconds and when ``stop`` is set; then what ended is kept and the Outcome
    is not complete.
    """
    return Sweep(
        planned=planned,
        store=MemoryRun() if directory is None else directory,
        on_disk=directory is not None,
        keep_episodes=keep_episodes,
        keep_max_q=keep_max_q,
        keep=keep,
        workers=workers,
        cache=cache,
        checkpoint_s=checkpoint_s,
        tell=tell or Listeners(),
        stop=stop or threading.Event(),
    ).run()


def sweep(
    name: str | Callable[..., Any],
    *,
    out: str | Path | None = None,
    resume: bool = False,
    overwrite: bool = False,
    allow_mismatch: bool = False,
    keep: int | None = None,
    keep_episodes: bool = False,
    workers: int | None = None,
    cache: CompileCache | None = None,
    **values: Any,
) -> Outcome:
    """Runs a preset over its axes, times ``seeds`` seeds, and returns its tables.

    ``jaxq.sweep("article-q", gamma=[0.95, 0.99], seeds=32).summary()``. ``values`` are those of ``plan``: axes, fixed
    values, ``seeds``, ``seed``, ``prng``, ``method``, ``samples``, ``settings``, ``halving``, ``env``. Instead of
    a preset ``name`` may be a pure function ``fn(key, hypers) -> pytree``: see ``functions``. With ``out`` the run is
    kept in that directory, as by the command line; ``resume``, ``overwrite``, ``allow_mismatch``, ``keep`` and
    ``keep_episodes`` are its flags. Nothing compiled is kept on disk unless a ``cache`` is given, such as
    ``jaxq.compile_cache.user_cache()``. Raises ValueError as ``plan`` does, RunError for a directory that cannot be
    used, and MemoryError, before anything runs, for a preset's lanes that would not fit.
    """
    if workers is not None:
        whole("workers", workers, 1, 2**20)
    if keep is not None:
        whole("keep", keep, 1, 2**31)
    if callable(name):
        planned = functions.plan(name, **values)
    else:
        planned = plan(name, **values)
        estimate.check(planned, workers)
    with contextlib.ExitStack() as stack:
        directory = None
        if out is not None:
            opened = RunDirectory.open(
                Path(out), planned, resume=resume, overwrite=overwrite, allow_mismatch=allow_mismatch
            )
            directory = stack.enter_context(opened)
        return run(planned, directory=directory, keep=keep, keep_episodes=keep_episodes, workers=workers, cache=cache)


def train(
    name: str, *, seed: int = 0, prng: str | None = None, cache: CompileCache | None = None, **values: Any
) -> Result:
    """Trains one lane of a preset and returns it with its episodes, its policy and the value of every update.

    ``jaxq.train("article-q").episodes.length``. ``cache`` as for ``sweep``. Raises ValueError as ``plan`` does.
    """
    kept: list[Result] = []
    planned = plan(name, seed=seed, prng=prng, **values)
    if planned.lanes != 1:
        raise ValueError(
            f"{planned.name}: {planned.lanes} lanes are not one: train takes one value of each, as sweep does not"
        )
    run(planned, keep_max_q=True, cache=cache, tell=Listeners(result=kept.append))
    return kept[0]
