"""A peer's agent trained until it is solved, seed after seed: wall-clock seconds and environment steps.

A bout is one call of the peer's own loop: one seed, or a few where it trains them together. The seed under way when the
time is over is finished, so that short trainings are not preferred: the number of bouts is then a stopping time, and
their seconds over their number have a bias of the order of one over that number (Wald's identity is about their sum).

A peer's file offers ``solver(numbers, is_solved, *more)``, which prepares and compiles, and returns
``train(first seed)``, which returns (solved, environment steps) of each seed that it trained; ``numbers`` are the
settings of our agent in the same case, ``is_solved`` judges the lengths of the training episodes so far. ``DIFFERS``,
where it is there, says how the agent is another.
"""

from __future__ import annotations

import functools
import itertools
import json
import runpy
import time
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

PACKAGES = (
    "stable-baselines3",
    "sbx-rl",
    "rejax",
    "gymnax",
    "torch",
    "jax",
    "jaxlib",
    "flax",
    "optax",
    "gymnasium",
    "numpy",
)
#: A bout is whole trainings.
WARM_UP = False

_kept: dict[str, dict[str, Any]] = {}


def is_solved(numbers: Mapping[str, Any], lengths: Sequence[int]) -> bool:
    """Whether the last ``success_window`` episodes, together, are longer than ``success_steps`` each on average."""
    window = numbers["success_window"]
    return sum(lengths[-window:]) > numbers["success_steps"] * window


def prepare(case: str, agent: str, settings: str, *more: str) -> Callable[[], float]:
    """``agent`` is the name of a file beside this one, ``settings`` is ours as JSON. Units: seeds, solved or not."""
    made = runpy.run_path(str(Path(__file__).with_name(f"{agent}.py")))
    numbers = json.loads(settings)
    train = made["solver"](numbers, functools.partial(is_solved, numbers), *more)
    kept: dict[str, Any] = {"together": 1, "seconds": [], "env_steps": [], "solved": []}
    _kept[case] = {"trainings": kept, "differs": made.get("DIFFERS")}
    seeds = itertools.count()

    def bout() -> float:
        began = time.perf_counter()
        trained = train(next(seeds) * kept["together"])
        kept["seconds"].append(time.perf_counter() - began)
        kept["together"] = len(trained)
        for solved, env_steps in trained:
            kept["solved"].append(bool(solved))
            kept["env_steps"].append(int(env_steps))
        return float(len(trained))

    return bout


def notes(case: str) -> dict[str, Any]:
    """Every training of this case so far."""
    return _kept[case]
