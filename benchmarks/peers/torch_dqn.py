"""The tutorial's DQN, PyTorch over Gymnasium: updates per second of one training.

The loop is the one in ``tests/reference/tutorial_dqn.py``, an update per environment step. PyTorch uses
as many threads as it is told; a second gains it up to a tenth.
"""

from __future__ import annotations

import itertools
import runpy
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

PACKAGES = ("torch", "gymnasium", "numpy")

LOOP = Path(__file__).parents[2] / "tests" / "reference" / "tutorial_dqn.py"
STEPS = 1500


def prepare(case: str, threads: str = "1") -> Callable[[], float]:
    """One training; ``case`` is 1. Units: updates."""
    import torch

    if case != "1":
        raise ValueError(f"case: {case!r} must be '1', the loop is one training")
    torch.set_num_threads(int(threads))
    train = runpy.run_path(str(LOOP))["train"]
    seeds = itertools.count()

    def bout() -> float:
        _, _, updates = train(next(seeds), max_env_steps=STEPS)
        return float(updates)

    return bout


def solver(numbers: Mapping[str, Any], is_solved: Callable) -> Callable[[int], list]:
    """Trainings until they are solved (see ``solve``), by the loop's own rule and numbers, on one thread."""
    import torch

    del is_solved
    torch.set_num_threads(1)
    train = runpy.run_path(str(LOOP))["train"]

    def one(seed: int) -> list:
        solved, lengths, _ = train(seed, max_episodes=numbers["max_episodes"])
        return [(solved, sum(lengths))]

    return one
