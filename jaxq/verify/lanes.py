"""Lanes: the same bits alone as among others, seeds of their own, and no harm from one that diverges."""

from __future__ import annotations

import dataclasses
import functools
from collections.abc import Iterator
from typing import Any, NamedTuple

import jax
import numpy as np

from jaxq import executables, lanes, programs
from jaxq.executables import Executables
from jaxq.plans import plan
from jaxq.rounds import RUNNING
from jaxq.tally import Lane, Result
from jaxq.verify.checks import Found, Job

#: Small trainings whose lanes end at different times, four settings each, and their key families.
TRAININGS: dict[str, dict[str, Any]] = {
    "q-learning": {"gamma": [0.9, 0.99], "max_episodes": [20, 300], "success_steps": 200},
    "dqn": {
        "learning_rate": [1e-3, 1e-2],
        "hidden": (16,),
        "batch_size": 16,
        "learning_starts": 32,
        "buffer_size": 200,
        "max_env_steps": [300, 1200],
        "eval_episodes": 5,
    },
}
FAMILIES = {"q-learning": "threefry", "dqn": "pcg4d"}
#: Lanes of each: more than a group has slots, so that slots are filled again.
LANES = {"q-learning": 48, "dqn": 16}
#: Lanes that run alone: one of the first, whose neighbours are replaced, and the last.
ALONE_TOO = (3, 6, -1)
ALONE = "jaxq, the lane alone"


class Compiled(NamedTuple):
    """A training, its lanes, and how often a slot was filled beside neighbours that were under way."""

    built: Executables
    everyone: tuple[Lane, ...]
    refills: list[int]


def jobs(cases: int) -> Iterator[Job]:
    """The checks of a table and of a network; ``cases`` plays no part."""
    del cases
    trainings = {name: _Runs(name) for name in TRAININGS}
    for name, runs in trainings.items():
        yield Job("lanes", f"{name}: among others", ALONE, lambda runs=runs: _alone(runs), 5)  # type: ignore[misc]
        yield Job("lanes", f"{name}: in another order and on two cores", ALONE, lambda runs=runs: _shuffled(runs))  # type: ignore[misc]
        yield Job("lanes", f"{name}: seeds", "each other", lambda runs=runs: _seeds(runs))  # type: ignore[misc]
    yield Job("lanes", "dqn: beside one that diverges", ALONE, lambda: _diverging(trainings["dqn"]))


class _Runs:
    """A training compiled once for all its checks, and the run of all its lanes, which they share."""

    def __init__(self, name: str):
        self.name, self.impl = name, FAMILIES[name]

    @functools.cached_property
    def compiled(self) -> Compiled:
        settings = plan(self.name, **TRAININGS[self.name]).settings
        numbers = [programs.hypers(one) for one in settings]
        built = executables.build(programs.program(settings[0], self.impl), numbers[0], self.impl)
        refills: list[int] = []

        def start(root: Any, state: Any, fresh: np.ndarray, *rest: Any) -> Any:
            under_way = (np.asarray(state.status) == RUNNING) & (np.asarray(state.clock.env_steps) > 0) & ~fresh
            refills.append(int(fresh.sum()) if under_way.any() else 0)
            return built.start(root, state, fresh, *rest)

        found = (divmod(i, len(numbers)) for i in range(LANES[self.name]))
        everyone = tuple(Lane(config, seed, numbers[config]) for seed, config in found)
        return Compiled(dataclasses.replace(built, start=start), everyone, refills)

    @functools.cached_property
    def together(self) -> dict[tuple[int, int], Result]:
        return self.run(list(self.compiled.everyone))

    def run(self, chosen: list[Lane], workers: int = 1) -> dict[tuple[int, int], Result]:
        ended = lanes.run(
            self.compiled.built, iter(chosen), root_seed=0, impl=self.impl, total=len(chosen), workers=workers
        )
        return {(one.lane.config, one.lane.seed): one for one in ended}


def _bits(one: Result) -> list[bytes]:
    leaves = jax.tree.leaves((one.policy, one.episodes, one.curve, one.eval_returns, one.env_steps, one.updates))
    return [np.asarray(leaf).tobytes() for leaf in leaves] + [one.status.encode()]


def _same(some: dict[tuple[int, int], Result], other: dict[tuple[int, int], Result]) -> Found:
    """Counts lanes of which a bit differs."""
    off = [key for key in some if key not in other or _bits(some[key]) != _bits(other[key])]
    detail = f"setting {off[0][0]}, seed {off[0][1]} differs" if off else ""
    return Found(len(some), len(off), 0, detail)


def _alone(runs: _Runs) -> Found:
    chosen = [runs.compiled.everyone[i] for i in ALONE_TOO]
    alone = {key: one for lane in chosen for key, one in runs.run([lane]).items()}
    runs.compiled.refills.clear()
    together = runs.run(list(runs.compiled.everyone))
    if not any(runs.compiled.refills):
        return Found(len(alone), np.inf, 0, "no slot was filled again beside a lane that was under way")
    return _same(alone, together)


def _shuffled(runs: _Runs) -> Found:
    everyone = runs.compiled.everyone
    order = np.random.default_rng(0).permutation(len(everyone))
    return _same(runs.run([everyone[i] for i in order], workers=2), runs.together)


def _seeds(runs: _Runs) -> Found:
    """Counts lanes that are missing, or have the episodes or the policy of another seed of their setting."""
    seen: list[set[tuple[int, bytes]]] = [set(), set()]
    for (config, _), one in runs.together.items():
        seen[0].add((config, one.episodes.length.tobytes()))
        seen[1].add((config, b"".join(np.asarray(leaf).tobytes() for leaf in jax.tree.leaves(one.policy))))
    count = len(runs.compiled.everyone)
    missing = [count - len(kind) for kind in seen]
    said = f"{missing[0]} have the episodes of another, {missing[1]} the policy"
    return Found(count, max(missing), 0, said if any(missing) else "")


def _diverging(runs: _Runs) -> Found:
    values = {**TRAININGS["dqn"], "learning_rate": 1e30, "max_env_steps": 300}
    numbers = programs.hypers(plan("dqn", **values).settings[0])
    another = 1 + max(lane.config for lane in runs.compiled.everyone)
    bad, calm = Lane(another, 0, numbers), list(runs.compiled.everyone[:6])
    together = runs.run([*calm[:2], bad, *calm[2:]])
    status = together.pop((bad.config, bad.seed)).status
    if status != "diverged":
        return Found(len(calm), np.inf, 0, f"a step size of 1e30 ended {status}")
    return _same(together, {key: one for key, one in runs.together.items() if key in together})
