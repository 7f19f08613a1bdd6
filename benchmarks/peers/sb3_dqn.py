"""Stable-Baselines3's DQN on CartPole-v1: updates per second of one training.

The clock runs over a training that has started to learn; updates are those that the library counts. In the peer's
favour PyTorch uses one thread, as its layers are too small to gain from a second, and nothing is logged or evaluated.
"""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path

PACKAGES = ("stable-baselines3", "torch", "gymnasium", "numpy")

SETTINGS = Path(__file__).with_name("dqn_settings.json")

#: Environment steps of a bout for each step per update.
STEPS = 1000


def prepare(case: str, setting: str = "article") -> Callable[[], float]:
    """One training of ``setting`` (a name in dqn_settings.json); ``case`` is 1. Units: updates."""
    import torch
    from stable_baselines3 import DQN

    if case != "1":
        raise ValueError(f"case: {case!r} must be '1', the library trains one agent")
    torch.set_num_threads(1)
    numbers = json.loads(SETTINGS.read_text())[setting]
    model = DQN(
        "MlpPolicy",
        "CartPole-v1",
        policy_kwargs={"net_arch": numbers["hidden"]},
        learning_rate=numbers["learning_rate"],
        buffer_size=numbers["capacity"],
        learning_starts=numbers["learning_starts"],
        batch_size=numbers["batch_size"],
        tau=numbers["tau"],
        gamma=numbers["gamma"],
        train_freq=numbers["steps_per_update"],
        gradient_steps=1,
        target_update_interval=numbers["target_period"],
        device="cpu",
        seed=0,
    )
    model.learn(2 * numbers["learning_starts"], log_interval=None)

    def bout() -> float:
        before = model._n_updates
        model.learn(STEPS * numbers["steps_per_update"], log_interval=None, reset_num_timesteps=False)
        return float(model._n_updates - before)

    return bout
