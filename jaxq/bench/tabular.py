"""Updates per second of ``article-q`` through the engine: act, step, discretise, update, with its log."""

from __future__ import annotations

from collections.abc import Callable

from jaxq import cpu

PACKAGES = ("jaxq", "jax", "jaxlib")

#: Updates of a lane, whole segments, at least as many as half of all trainings of ``article-q`` take until they
#: succeed; the lanes of a bout together make ``BOUT`` updates, as far as that allows.
LEAST, MOST, BOUT = 52_000, 416_000, 2**24


def prepare(case: str, family: str = "pcg4d") -> Callable[[], float]:
    """``case`` lanes, all of the same length and none solved, without the evaluation at their end. Units: updates."""
    cpu.tune()
    from jaxq.bench import equal_lanes

    count = int(case)
    each = max(LEAST, min(MOST, BOUT // count // LEAST * LEAST))
    return equal_lanes.prepare(equal_lanes.setting("article-q"), family, lanes=count, updates=each)
