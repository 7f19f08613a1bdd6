"""Trainings until they are solved: wall-clock seconds and environment steps, of seeds together and of one at a time."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Any

from jaxq import cpu
from jaxq.plans import Plan, plan

PACKAGES = ("jaxq", "jax", "jaxlib", "flax", "optax")
#: A bout is whole trainings; what compiles is warmed up beforehand.
WARM_UP = False


def at_least(mean: float, window: int) -> float:
    """The ``success_steps`` that the mean of ``window`` whole lengths is above just when it is at least ``mean``."""
    return mean - 0.5 / window


#: DQN with a target that is copied, which every peer has.
HARD_TARGET: dict[str, Any] = {
    "learning_rate": 1e-3,
    "learning_rate_end": 5e-5,
    "gamma": 0.99,
    "tau": 1.0,
    "target_period": 50,
    "epsilon_decay": 50_000,
    "buffer_size": 10_000,
    "eval_episodes": 10,
}
#: The presets that are trained, with what differs from them. ``dqn`` has Gymnasium's threshold for CartPole-v1.
CASES: dict[str, dict[str, Any]] = {
    "article-q": {},
    "article-dqn": {},
    "dqn": {**HARD_TARGET, "stop": "window", "success_window": 100, "success_steps": at_least(475, 100)},
}
#: How many seeds: more where they are quick, or many fail.
SEEDS = {
    "together": {"article-q": 1024, "article-dqn": 32, "dqn": 32},
    "alone": {"article-q": 64, "article-dqn": 16, "dqn": 16},
}

_last: dict[str, dict[str, Any]] = {}


def planned(case: str) -> Plan:
    """The one setting of a case, and its key family."""
    return plan(case, **CASES[case])


def prepare(case: str, how: str = "together") -> Callable[[], float]:
    """All seeds of a case at once ("together") or one after the other ("alone"). Units: seeds, solved or not."""
    cpu.tune()
    import numpy as np

    from jaxq import lanes, programs
    from jaxq.bench import equal_lanes
    from jaxq.tally import Lane, Result

    chosen, seeds = planned(case), SEEDS[how][case]
    one, family = chosen.settings[0], chosen.prng
    together = seeds if how == "together" else 1
    built = equal_lanes.unevaluated(one, family)
    numbers = programs.hypers(one)

    def train(group: range, numbers: Any = numbers) -> list[Result]:
        queue = (Lane(0, seed, numbers) for seed in group)
        results = lanes.run(built, queue, root_seed=0, impl=family, total=len(group))
        return sorted(results, key=lambda result: result.lane.seed)

    train(range(together), numbers._replace(run=numbers.run._replace(max_env_steps=np.int32(1))))

    def bout() -> float:
        seconds, results = [], []
        for first in range(0, seeds, together):
            began = time.perf_counter()
            results += train(range(first, first + together))
            seconds.append(time.perf_counter() - began)
        _last[case] = {
            "together": together,
            "seconds": seconds,
            "env_steps": [result.env_steps for result in results],
            "solved": [result.status == "solved" for result in results],
        }
        return float(seeds)

    return bout


def notes(case: str) -> dict[str, Any]:
    """The trainings of the last bout, as ``solved`` reads them."""
    return {"trainings": _last[case]}
