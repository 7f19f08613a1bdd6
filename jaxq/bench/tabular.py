"""Updates per second of ``article-q`` through the engine: act, step, discretise, update, with its log."""

from __future__ import annotations

from collections.abc import Callable

from jaxq import cpu

PACKAGES = ("jaxq", "jax", "jaxlib")

#: Updates of a lane, whole segments: half of all trainings of ``article-q`` succeed within so many.
UPDATES = 52_000


def prepare(case: str, family: str = "pcg4d") -> Callable[[], float]:
    """``case`` lanes, all of the same length and none solved, without the evaluation at their end. Units: updates."""
    cpu.tune()
    from jaxq.bench import equal_lanes

    one = equal_lanes.setting("article-q")
    return equal_lanes.prepare(one, family, lanes=int(case), updates=UPDATES)
