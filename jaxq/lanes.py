"""The engine: many lanes through one compiled program, a small group of lanes per core.

A *group* is ``width`` slots that are vmapped together. Each core has a worker thread (``workers``) with a group of its
own, and runs one compiled program over it, a segment at a time; XLA lets go of the interpreter lock meanwhile, so
groups run side by side and none waits for another. Memory is that of the slots, whatever the number of lanes.

Invariant: what a lane computes depends on its hypers, its seed, the key family and the width, never on its slot, its
neighbours or its worker. All groups run the same executable, lanes meet no reduction across the group, and a lane's
keys derive from the root seed and its seed index alone.
"""

from __future__ import annotations

import queue
import threading
from collections.abc import Callable, Generator, Iterable
from typing import Any

import jax
import numpy as np

from jaxq import prng
from jaxq.executables import Executables
from jaxq.machine import cores
from jaxq.shared import Ended, Shared
from jaxq.shared import Progress as Progress
from jaxq.tally import Episodes, Lane, Result, Saved
from jaxq.workers import Worker


def default_workers() -> int:
    """A worker per core; one alone for an accelerator."""
    return cores() if jax.default_backend() == "cpu" else 1


def run(
    built: Executables,
    lanes: Iterable[Lane],
    *,
    root_seed: int,
    impl: str,
    total: int,
    workers: int | None = None,
    keep_max_q: bool = False,
    on_progress: Callable[[Progress], None] | None = None,
    on_episodes: Callable[[Lane, Episodes], None] | None = None,
    on_saved: Callable[[Saved], None] | None = None,
    checkpoint_s: float = 60.0,
    stop: threading.Event | None = None,
) -> Generator[Result, None, None]:
    """Yields each lane's Result as it ends, in no fixed order.

    ``total`` is the number of lanes, for the progress. ``on_episodes`` is called for every lane at each of its segments
    with all episodes that it has finished, ``on_saved`` with each lane that has been under way for another
    ``checkpoint_s`` seconds, and with those under way when the run is stopped. ``stop`` set: every worker finishes its
    segment, hands on what ended, and the iterator ends. An exception in a worker or of a listener, or Ctrl-C, is raised
    here once all that ended is handed on.
    """
    stop = stop or threading.Event()
    shared = Shared(
        iter(lanes),
        Progress(total),
        stop,
        watched=on_episodes is not None,
        checkpoint_s=None if on_saved is None else checkpoint_s,
    )
    root = np.asarray(jax.random.key_data(prng.key(root_seed, impl)))
    count = max(1, min(workers or default_workers(), -(-total // built.program.width)))
    threads = [threading.Thread(target=Worker(built, shared, root, keep_max_q).run, daemon=True) for _ in range(count)]
    failure: BaseException | None = None

    def fail(error: BaseException) -> None:
        """Raised in the end: what has ended is handed on first."""
        nonlocal failure
        failure, shared.closed = failure or error, True

    def tell(listener: Callable[..., None] | None, *words: Any) -> None:
        if listener is not None:
            try:
                listener(*words)
            except BaseException as error:
                fail(error)

    try:
        for thread in threads:
            thread.start()
        running = count
        tell(on_progress, shared.progress)
        while running:
            alive, item = any(thread.is_alive() for thread in threads), None
            try:
                item = shared.results.get(timeout=0.1)
            except queue.Empty:
                if not alive:  # Ctrl-C came between a last word and its being heard
                    break
            except KeyboardInterrupt as error:
                fail(error)
            if isinstance(item, list):
                yield from item
            elif isinstance(item, Ended):
                running -= 1
                if item.error is not None:
                    fail(item.error)
            elif isinstance(item, Saved):
                tell(on_saved, item)
            elif item is not None:
                tell(on_episodes, *item)
            tell(on_progress, shared.progress)
    finally:  # the caller may have left early
        shared.closed = True
        for thread in threads:  # a thread that is still in XLA when the interpreter ends aborts the process
            if thread.ident is not None:
                thread.join()
    if failure is not None:
        raise failure
