"""Updates per second through the engine as one thing grows: lanes, cores, or the width of the network.

Along an axis every lane has the same length, so what differs from case to case is what grows and nothing else.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from contextlib import AbstractContextManager, nullcontext
from typing import Any

from jaxq import cpu, machine
from jaxq.bench import affinity, memory

PACKAGES = ("jaxq", "jax", "jaxlib", "flax", "optax")
#: ``prepare`` has a shorter one: the largest cases take seconds.
WARM_UP = False

#: Updates of a lane. Where all cases have few lanes these are longer, so that a bout is not over at once.
UPDATES = {
    ("lanes", "article-q"): 64_000,
    ("lanes", "article-dqn"): 512,
    ("cores", "article-q"): 200_000,
    ("cores", "article-dqn"): 512,
    ("width", "article-dqn"): 1024,
}
#: The lanes of a network of any width.
NETWORK_LANES = 8

_notes: dict[str, dict[str, Any]] = {}


def prepare(case: str, axis: str, preset: str, family: str = "pcg4d") -> Callable[[], float]:
    """A bout of lanes of ``preset``, without the evaluation at their end. Units: updates.

    ``case`` is the number of "lanes", or of "cores" that share the same lanes, or the "width" of two hidden layers.
    """
    cpu.tune()
    import jax

    from jaxq import lanes as engine
    from jaxq.bench import equal_lanes

    count = int(case)
    hidden = {"hidden": (count, count)} if axis == "width" else {}
    one = equal_lanes.setting(preset, **hidden)
    width = equal_lanes.unevaluated(one, family).program.width
    workers = count if axis == "cores" else engine.default_workers()
    # As many groups as every number of cores can share out evenly.
    shared = width * math.lcm(*machine.core_counts())
    lanes = {"lanes": count, "cores": shared, "width": NETWORK_LANES}[axis]
    equal_lanes.prepare(one, family, lanes=width * workers, updates=1, workers=workers)()
    run = equal_lanes.prepare(one, family, lanes=lanes, updates=UPDATES[axis, preset], workers=workers)

    def bout() -> float:
        known = memory.reset_peak()
        with held(axis, workers):
            units = run()
        if axis == "cores" and (why := affinity.not_held(jax.default_backend())):
            _notes[case] = {"differs": why}
        # The first bout's: what a larger case took and gave back may later count in the memory of a smaller one.
        if axis == "lanes" and case not in _notes:
            _notes[case] = {
                "slots": equal_lanes.slots(one, family, workers),
                "first_peak_mib": memory.peak_mib() if known else None,
            }
        return units

    return bout


def held(axis: str, cores: int) -> AbstractContextManager[None]:
    """Along the cores, so many for the whole process: for the books, and XLA's own threads, as well."""
    return affinity.on(cores) if axis == "cores" else nullcontext()


def notes(case: str) -> dict[str, Any]:
    """Along the lanes: the engine's slots, and the peak of resident memory in the first bout of the case. Along the
    cores: how what is measured is another thing where they cannot be held."""
    return _notes.get(case, {})
