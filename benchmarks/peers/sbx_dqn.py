"""SBX's DQN, Stable-Baselines3 in JAX, on CartPole-v1: made, run and counted as ``sb3_dqn`` does.

Its environment and replay are Stable-Baselines3's, outside the compiled update.
"""

from __future__ import annotations

import json
import runpy
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

PACKAGES = ("sbx-rl", "stable-baselines3", "jax", "jaxlib", "flax", "optax", "torch", "gymnasium")

SB3 = Path(__file__).with_name("sb3_dqn.py")

DIFFERS = (
    "Huber loss, no double Q-learning, all hidden layers as wide as the first: it has no others; uniform actions until"
    " updates start"
)


def prepare(case: str, settings: str) -> Callable[[], float]:
    """One training of our ``settings``, as JSON; ``case`` is 1. Units: updates."""
    from sbx import DQN

    numbers = json.loads(settings)
    theirs = runpy.run_path(str(SB3))
    return theirs["throughput"](DQN, case, theirs["as_ours"](numbers) | {"policy_kwargs": policy(numbers, 1)})


def notes(case: str) -> dict[str, str]:
    """How the work that ``prepare`` measures is another than ours."""
    del case
    return {
        "differs": "all hidden layers as wide as the first, which where they differ is more work; no value of the"
        " gradient is clipped; XLA may use all cores"
    }


def policy(numbers: Mapping[str, Any], updates: int) -> dict[str, Any]:
    """The network and the optimiser: AMSGrad and weight decay, with a step size that falls over so many updates.

    The library reads its own schedule for the step size at the start alone, so the optimiser brings one.
    """
    import optax

    falling = optax.linear_schedule(*runpy.run_path(str(SB3))["step_sizes"](numbers), updates)
    optimiser = optax.chain(
        optax.scale_by_amsgrad(),
        optax.add_decayed_weights(numbers["weight_decay"]),
        optax.scale_by_learning_rate(falling),
    )
    return {"net_arch": numbers["hidden"], "optimizer_class": lambda learning_rate: optimiser}


def solver(numbers: Mapping[str, Any], is_solved: Callable) -> Callable[[int], list]:
    """Trainings until they are solved (see ``solve``)."""
    from sbx import DQN

    updates = (numbers["max_env_steps"] - numbers["learning_starts"]) // numbers["steps_per_update"]
    static: dict[str, Any] = {}

    def make(*given: Any, **named: Any) -> Any:
        model = DQN(*given, **named)
        state = model.policy.qf_state
        if not static:  # with functions of its own every model would be compiled anew
            static.update(apply_fn=state.apply_fn, tx=state.tx)
        model.policy.qf_state = state.replace(**static)
        return model

    theirs = runpy.run_path(str(SB3))
    arguments = theirs["as_ours"](numbers) | {"policy_kwargs": policy(numbers, updates)}
    theirs["until_solved"](make, arguments, 2 * numbers["learning_starts"], is_solved)(0)  # compiles
    return theirs["until_solved"](make, arguments, numbers["max_env_steps"], is_solved)
