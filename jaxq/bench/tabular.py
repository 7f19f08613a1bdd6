"""Updates per second of ``article-q`` through the engine: act, step, discretise, update, with its log."""

from __future__ import annotations

from collections.abc import Callable

from jaxq import cpu

PACKAGES = ("jaxq", "jax", "jaxlib")

#: Updates of a lane, whole segments; the lanes of a bout together make ``BOUT`` updates, as far as that allows.
LEAST, MOST, BOUT = 20_000, 400_000, 2**24


def prepare(case: str, family: str = "pcg4d") -> Callable[[], float]:
    """``case`` lanes, all of the same length and none solved, without the evaluation at their end. Units: updates."""
    cpu.tune()
    from jaxq.bench import equal_lanes
    from jaxq.plans import plan

    count = int(case)
    each = max(LEAST, min(MOST, BOUT // count // LEAST * LEAST))
    one = plan("article-q", max_episodes=10**6, success_streak=10**6).settings[0]
    return equal_lanes.prepare(one, family, lanes=count, env_steps=each)
