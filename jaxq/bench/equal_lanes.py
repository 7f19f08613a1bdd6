"""Lanes of one length through the engine: what the suites of learners measure."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import cache
from typing import Any

import numpy as np

from jaxq import executables, programs
from jaxq import lanes as engine
from jaxq.executables import Executables
from jaxq.plans import plan
from jaxq.presets import DQNSettings
from jaxq.settings import Settings
from jaxq.tally import Lane

#: No episode's end ends a lane: a streak that none reaches, no window to look at.
NEVER_SOLVED: dict[str, dict[str, Any]] = {"article-q": {"success_streak": 10**6}, "article-dqn": {"stop": "none"}}


def setting(preset: str, **overrides: Any) -> Settings:
    """A preset's setting whose lanes end by their length alone."""
    return plan(preset, max_episodes=10**6, **NEVER_SOLVED[preset], **overrides).settings[0]


def prepare(one: Settings, family: str, *, lanes: int, updates: int, workers: int | None = None) -> Callable[[], float]:
    """A bout of ``lanes`` lanes that end after ``updates`` each and are not evaluated then. Units: updates.

    Results are dropped as they come. ``workers`` as in ``lanes.run``: one per core where it is None.
    """
    steps = updates
    if isinstance(one, DQNSettings):  # the warm-up stops one round short of the first update
        steps = max(0, one.learning_starts - one.steps_per_update) + updates * one.steps_per_update
    numbers = programs.hypers(one)
    numbers = numbers._replace(run=numbers.run._replace(max_env_steps=np.int32(steps)))
    built = unevaluated(one, family)

    def bout() -> float:
        queue = (Lane(0, seed, numbers) for seed in range(lanes))
        results: Any = engine.run(built, queue, root_seed=0, impl=family, total=lanes, workers=workers)
        return float(sum(result.updates for result in results))

    return bout


def slots(one: Settings, family: str, workers: int | None = None) -> int:
    """The lanes that the engine runs at once, with one worker per core where ``workers`` is None."""
    return unevaluated(one, family).program.width * (engine.default_workers() if workers is None else workers)


@cache
def unevaluated(one: Settings, family: str) -> Executables:
    """The compiled structure of a setting, without the greedy episodes at a lane's end; once for all cases."""
    built = executables.build(programs.program(one, family), programs.hypers(one), family)
    return replace(built, evaluate=lambda *_: np.zeros((built.program.width, 1)))
