"""Stable-Baselines3's DQN on CartPole-v1: updates per second of one training, and trainings until they are solved.

For updates per second the clock runs over a training that has started to learn; updates are those that the library
counts. PyTorch uses as many threads as it is told, one until solved: a second gains it a few per cent at 128-128,
nothing at 120-84. In the peer's favour nothing is logged or evaluated.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping
from typing import Any

PACKAGES = ("stable-baselines3", "torch", "gymnasium", "numpy")

#: Environment steps of a bout for each step per update.
STEPS = 1000

DIFFERS = "Huber loss, no double Q-learning: it has no others; uniform actions until updates start"


def prepare(case: str, settings: str, threads: str = "1") -> Callable[[], float]:
    """One training of our ``settings``, as JSON; ``case`` is 1. Units: updates."""
    from stable_baselines3 import DQN

    numbers = json.loads(settings)
    return throughput(DQN, case, given(numbers), int(threads))


def notes(case: str) -> dict[str, str]:
    """How the work that ``prepare`` measures is another than ours."""
    del case
    return {"differs": "the gradient's norm is taken in every update, no value of it is clipped"}


def solver(numbers: Mapping[str, Any], is_solved: Callable) -> Callable[[int], list]:
    """Trainings until they are solved (see ``solve``)."""
    from stable_baselines3 import DQN

    return until_solved(DQN, given(numbers), numbers["max_env_steps"], is_solved)


def given(numbers: Mapping[str, Any]) -> dict[str, Any]:
    """Our settings as this library's arguments, with AMSGrad, weight decay and a falling step size."""
    import torch

    high, low = step_sizes(numbers)
    return as_ours(numbers) | {
        "learning_rate": lambda left: low + left * (high - low),
        "policy_kwargs": {
            "net_arch": numbers["hidden"],
            "optimizer_class": torch.optim.AdamW,
            "optimizer_kwargs": {"amsgrad": True, "weight_decay": numbers["weight_decay"]},
        },
        "max_grad_norm": float("inf"),
    }


def step_sizes(numbers: Mapping[str, Any]) -> tuple[float, float]:
    """The step size at the start and at the end, which are one where it does not fall."""
    high, low = numbers["learning_rate"], numbers["learning_rate_end"]
    return high, high if low is None else low


def throughput(DQN: Any, case: str, arguments: Mapping[str, Any], threads: int = 1) -> Callable[[], float]:
    """A bout of a training of this class, or of one that is made like it, once it learns. Units: updates."""
    import torch

    if case != "1":
        raise ValueError(f"case: {case!r} must be '1', the library trains one agent")
    torch.set_num_threads(threads)
    model = DQN("MlpPolicy", "CartPole-v1", **arguments, seed=0)
    model.learn(2 * arguments["learning_starts"], log_interval=None)

    def bout() -> float:
        before = model._n_updates
        model.learn(STEPS * arguments["train_freq"], log_interval=None, reset_num_timesteps=False)
        return float(model._n_updates - before)

    return bout


def until_solved(DQN: Any, arguments: Mapping[str, Any], limit: int, is_solved: Callable) -> Callable[[int], list]:
    """``train(seed)`` of this class, or of one that is made like it, with these arguments; a callback ends it
    when ``is_solved``, the limit of env steps otherwise."""
    import torch
    from stable_baselines3.common.callbacks import BaseCallback

    torch.set_num_threads(1)

    class Judge(BaseCallback):
        lengths: list[int]
        solved = False

        def _on_training_start(self) -> None:
            self.lengths, self.under_way = [], 0

        def _on_step(self) -> bool:
            self.under_way += 1
            if self.locals["dones"][0]:
                self.lengths.append(self.under_way)
                self.under_way, self.solved = 0, is_solved(self.lengths)
            return not self.solved

    def one(seed: int) -> list:
        model = DQN("MlpPolicy", "CartPole-v1", **arguments, seed=seed)
        judge = Judge()
        model.learn(limit, callback=judge, log_interval=None)
        return [(judge.solved, model.num_timesteps)]

    return one


def as_ours(numbers: Mapping[str, Any]) -> dict[str, Any]:
    """Our settings as the arguments that this library and those made like it share."""
    period = numbers["steps_per_update"]
    return {
        "policy_kwargs": {"net_arch": numbers["hidden"]},
        "learning_rate": numbers["learning_rate"],
        "buffer_size": numbers["buffer_size"],
        "learning_starts": numbers["learning_starts"],
        "batch_size": numbers["batch_size"],
        "tau": numbers["tau"],
        "gamma": numbers["gamma"],
        "train_freq": period,
        "gradient_steps": 1,
        "target_update_interval": numbers["target_period"] * period,  # theirs counts env steps
        "exploration_initial_eps": numbers["epsilon_start"],
        "exploration_final_eps": numbers["epsilon_end"],
        "exploration_fraction": numbers["epsilon_decay"] / numbers["max_env_steps"],
        "device": "cpu",
    }
