"""Stable-Baselines3's DQN on CartPole-v1: updates per second of one training, and trainings until they are solved.

For updates per second the clock runs over a training that has started to learn; updates are those that the library
counts. PyTorch uses one thread. In the peer's favour nothing is logged or evaluated.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

PACKAGES = ("stable-baselines3", "torch", "gymnasium", "numpy")

SETTINGS = Path(__file__).with_name("dqn_settings.json")

#: Environment steps of a bout for each step per update.
STEPS = 1000

DIFFERS = "Huber loss, no double Q-learning: it has no others; uniform actions until updates start"


def prepare(case: str, setting: str = "article") -> Callable[[], float]:
    """One training of ``setting`` (a name in dqn_settings.json); ``case`` is 1. Units: updates."""
    from stable_baselines3 import DQN

    return throughput(DQN, case, setting)


def solver(numbers: Mapping[str, Any], is_solved: Callable) -> Callable[[int], list]:
    """Trainings until they are solved (see ``solve``), with AMSGrad and a falling step size, as ours."""
    from stable_baselines3 import DQN

    high, low = numbers["learning_rate"], numbers["learning_rate_end"]
    return until_solved(
        DQN,
        numbers,
        is_solved,
        learning_rate=lambda left: low + left * (high - low),
        policy_kwargs={"net_arch": numbers["hidden"], "optimizer_kwargs": {"amsgrad": True}},
        max_grad_norm=float("inf"),
    )


def throughput(DQN: Any, case: str, setting: str) -> Callable[[], float]:
    """A bout of a training of this class, or of one that is made like it, once it learns. Units: updates."""
    import torch

    if case != "1":
        raise ValueError(f"case: {case!r} must be '1', the library trains one agent")
    torch.set_num_threads(1)
    numbers = json.loads(SETTINGS.read_text())[setting]
    model = DQN("MlpPolicy", "CartPole-v1", **arguments(numbers), seed=0)
    model.learn(2 * numbers["learning_starts"], log_interval=None)

    def bout() -> float:
        before = model._n_updates
        model.learn(STEPS * numbers["steps_per_update"], log_interval=None, reset_num_timesteps=False)
        return float(model._n_updates - before)

    return bout


def until_solved(DQN: Any, numbers: Mapping[str, Any], is_solved: Callable, **more: Any) -> Callable[[int], list]:
    """``train(seed)`` of this class, or of one that is made like it; a callback ends it when ``is_solved``."""
    import torch
    from stable_baselines3.common.callbacks import BaseCallback

    torch.set_num_threads(1)
    limit = numbers["max_env_steps"]
    given = arguments(
        {
            **numbers,
            "capacity": numbers["buffer_size"],
            "target_period": numbers["target_period"] * numbers["steps_per_update"],  # theirs counts env steps
        }
    )
    given |= {
        "exploration_initial_eps": numbers["epsilon_start"],
        "exploration_final_eps": numbers["epsilon_end"],
        "exploration_fraction": numbers["epsilon_decay"] / limit,
    }

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
        model = DQN("MlpPolicy", "CartPole-v1", **given | more, seed=seed)
        judge = Judge()
        model.learn(limit, callback=judge, log_interval=None)
        return [(judge.solved, model.num_timesteps)]

    return one


def arguments(numbers: Mapping[str, Any]) -> dict[str, Any]:
    """The numbers as the library's arguments."""
    return {
        "policy_kwargs": {"net_arch": numbers["hidden"]},
        "learning_rate": numbers["learning_rate"],
        "buffer_size": numbers["capacity"],
        "learning_starts": numbers["learning_starts"],
        "batch_size": numbers["batch_size"],
        "tau": numbers["tau"],
        "gamma": numbers["gamma"],
        "train_freq": numbers["steps_per_update"],
        "gradient_steps": 1,
        "target_update_interval": numbers["target_period"],
        "device": "cpu",
    }
