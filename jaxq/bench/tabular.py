"""Updates per second of ``article-q`` through the engine: act, step, discretise, update, with its log."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

from jaxq import cpu

PACKAGES = ("jaxq", "jax", "jaxlib")

#: Updates of a lane, whole segments; the lanes of a bout together make ``BOUT`` updates, as far as that allows.
LEAST, MOST, BOUT = 20_000, 400_000, 2**24


def prepare(case: str, family: str = "pcg4d") -> Callable[[], float]:
    """``case`` lanes, all of the same length and none solved, without the evaluation at their end. Units: updates."""
    cpu.tune()
    import numpy as np

    from jaxq import executables, programs
    from jaxq import lanes as engine
    from jaxq.plans import plan
    from jaxq.tally import Lane

    count = int(case)
    each = max(LEAST, min(MOST, BOUT // count // LEAST * LEAST))
    one = plan("article-q", max_episodes=10**6, success_streak=10**6).settings[0]
    numbers = programs.hypers(one)
    numbers = numbers._replace(run=numbers.run._replace(max_env_steps=np.int32(each)))
    built = executables.build(programs.program(one, family), numbers, family)
    built = replace(built, evaluate=lambda *_: np.zeros((built.program.width, 1)))

    def bout() -> float:
        lanes = (Lane(0, seed, numbers) for seed in range(count))
        results: Any = engine.run(built, lanes, root_seed=0, impl=family, total=count)
        return float(sum(result.updates for result in results))

    return bout
