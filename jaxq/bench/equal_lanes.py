"""Lanes of one length through the engine: what the suites of learners measure."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np

from jaxq import executables, programs
from jaxq import lanes as engine
from jaxq.executables import Executables
from jaxq.presets import Settings
from jaxq.tally import Lane


def prepare(one: Settings, family: str, *, lanes: int, env_steps: int) -> Callable[[], float]:
    """A bout of ``lanes`` lanes that end after ``env_steps`` each and are not evaluated then. Units: updates."""
    numbers = programs.hypers(one)
    numbers = numbers._replace(run=numbers.run._replace(max_env_steps=np.int32(env_steps)))
    built = unevaluated(one, family)

    def bout() -> float:
        queue = (Lane(0, seed, numbers) for seed in range(lanes))
        results: Any = engine.run(built, queue, root_seed=0, impl=family, total=lanes)
        return float(sum(result.updates for result in results))

    return bout


def unevaluated(one: Settings, family: str) -> Executables:
    """The compiled structure of a setting, without the greedy episodes at a lane's end."""
    built = executables.build(programs.program(one, family), programs.hypers(one), family)
    return replace(built, evaluate=lambda *_: np.zeros((built.program.width, 1)))
