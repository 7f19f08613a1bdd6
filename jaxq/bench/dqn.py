"""Gradient updates per second of a DQN through the engine, with its acting, replay and log."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from jaxq import cpu

PACKAGES = ("jaxq", "jax", "jaxlib", "flax", "optax")

#: The settings that are measured: the tutorial's; a smaller network; the larger one of CleanRL, an update per 10 steps.
SETTINGS: dict[str, dict[str, Any]] = {
    "article": {},
    "64-64": {"hidden": (64, 64), "batch_size": 64},
    "cleanrl": {"hidden": (120, 84), "steps_per_update": 10, "tau": 1.0, "target_period": 50, "clip": "none"},
}

#: Updates of a lane, so that the lanes of a bout together make ``BOUT``, as far as that allows.
LEAST, MOST, BOUT = 512, 4096, 2**14

_slots: dict[str, int] = {}


def prepare(case: str, setting: str = "article", family: str = "pcg4d") -> Callable[[], float]:
    """``case`` lanes of ``setting``, all of the same length, without the evaluation at their end. Units: updates."""
    cpu.tune()
    from jaxq.bench import equal_lanes

    count = int(case)
    each = max(LEAST, min(MOST, BOUT // count // LEAST * LEAST))
    one = equal_lanes.setting("article-dqn", **SETTINGS[setting])
    _slots[case] = equal_lanes.slots(one, family)
    return equal_lanes.prepare(one, family, lanes=count, updates=each)


def notes(case: str) -> dict[str, Any]:
    """The engine's slots: fewer lanes leave cores idle."""
    return {"slots": _slots[case]}
