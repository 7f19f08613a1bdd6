"""One compiled program for all numbers of a structure: XLA's compilations are counted."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator
from importlib import metadata
from typing import Any

from jax import monitoring

from jaxq import sweeps
from jaxq.verify.checks import Found, Job

#: JAX's name of a compilation.
EVENT = "/jax/core/compile/backend_compile_duration"
#: What is compiled of each structure.
PARTS = ("start", "advance", "evaluate", "policy")
#: Sweeps over numbers of every kind: of the environment, the learner and the run.
NUMBERS: dict[str, dict[str, Any]] = {
    "q-learning": {
        "gamma": [0.9, 0.99],
        "alpha_max": [0.3, 0.5],
        "env.length": [0.4, 0.5],
        "max_episodes": [5, 8],
        "eval_episodes": 2,
    },
    "dqn": {
        "learning_rate": [1e-4, 1e-3],
        "epsilon_decay": [100, 200],
        "tau": [0.01, 0.1],
        "max_env_steps": [300, 400],
        "hidden": (8,),
        "batch_size": 16,
        "learning_starts": 32,
        "buffer_size": 100,
        "eval_episodes": 2,
    },
}
#: One of these makes two structures.
STRUCTURES: dict[str, Any] = {"gamma": [0.9, 0.99], "double": [False, True], "max_episodes": 5, "eval_episodes": 2}


def jobs(cases: int) -> Iterator[Job]:
    """The checks of tables and of networks; ``cases`` plays no part."""
    del cases
    said = f"jax {metadata.version('jax')}"
    for name in NUMBERS:
        yield Job("compiles", f"{name}: settings of one structure", said, lambda name=name: _counted(name, 1), 6)  # type: ignore[misc]
    yield Job("compiles", "q-learning: settings of two structures", said, lambda: _counted("q-learning", 2), 6)


def _counted(name: str, structures: int) -> Found:
    """How far the number of compilations is from one of each part for each structure."""
    counts: Counter[str] = Counter()

    def compiled(event: str, duration_secs: float, **about: Any) -> None:
        del duration_secs
        if event == EVENT:
            counts[str(about.get("fun_name"))] += 1

    values = STRUCTURES if structures > 1 else NUMBERS[name]
    monitoring.register_event_duration_secs_listener(compiled)
    try:
        outcome = sweeps.sweep(name, **values)
    finally:
        monitoring.unregister_event_duration_listener(compiled)
    made = {part: sum(count for fn, count in counts.items() if fn in (part, f"jit({part})")) for part in PARTS}
    off = sum(abs(count - structures) for count in made.values())
    settings = len(outcome.lanes)
    return Found(settings, off, 0, f"{sum(made.values())} programs of {settings} settings" if off else "")
