"""The tutorial's tabular Q-learning, one loop in NumPy over Gymnasium: updates per second, one training on one core.

The loop is the one in ``tests/reference/tutorial_tabular.py``. A bout is a training of a fixed number of episodes
without the rule that ends it early, long enough for the long episodes of a trained agent, which suits the peer.
"""

from __future__ import annotations

import itertools
import runpy
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

PACKAGES = ("numpy", "gymnasium")

LOOP = Path(__file__).parents[2] / "tests" / "reference" / "tutorial_tabular.py"
EPISODES = 300


def prepare(case: str) -> Callable[[], float]:
    """One training; ``case`` is 1. Units: updates, one per environment step."""
    if case != "1":
        raise ValueError(f"case: {case!r} must be '1', the loop is one training")
    train = runpy.run_path(str(LOOP))["train"]
    seeds = itertools.count()

    def bout() -> float:
        _, _, steps, _ = train(next(seeds), max_episodes=EPISODES, success_streak=EPISODES)
        return float(steps)

    return bout


def solver(numbers: Mapping[str, Any], is_solved: Callable) -> Callable[[int], list]:
    """Trainings until they are solved (see ``solve``), by the loop's own rule with our numbers."""
    del is_solved
    train = runpy.run_path(str(LOOP))["train"]
    given = {name: numbers[name] for name in ("max_episodes", "success_steps", "success_streak", "gamma")}

    def one(seed: int) -> list:
        solved, _, steps, _ = train(seed, **given)
        return [(solved, steps)]

    return one
