"""Stable-Baselines3's DQN with the settings that RL Baselines3 Zoo publishes for CartPole-v1: trainings until they are
solved.

The settings are those of ``hyperparams/dqn.yml`` at commit 22e3ff2 (April 2026), which train for ``ZOO_STEPS``: fewer
than a hundred episodes of the threshold's length take with the rest, so the trainings go on, up to the limit of ours.
"""

from __future__ import annotations

import runpy
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

SB3 = Path(__file__).with_name("sb3_dqn.py")

DIFFERS = (
    "the settings that RL Baselines3 Zoo publishes for CartPole-v1, hidden layers 256-256 among them, trained on"
    " beyond their 50,000 env steps"
)

ZOO_STEPS = 50_000
ZOO = {
    "learning_rate": 2.3e-3,
    "batch_size": 64,
    "buffer_size": 100_000,
    "learning_starts": 1000,
    "gamma": 0.99,
    "target_update_interval": 10,
    "train_freq": 256,
    "gradient_steps": 128,
    "exploration_final_eps": 0.04,
    "policy_kwargs": {"net_arch": [256, 256]},
}
EXPLORATION_FRACTION = 0.16


def solver(numbers: Mapping[str, Any], is_solved: Callable) -> Callable[[int], list]:
    """Trainings until they are solved (see ``solve``); of our settings the limit of env steps alone is taken."""
    from stable_baselines3 import DQN

    limit = numbers["max_env_steps"]
    falling = {"exploration_fraction": EXPLORATION_FRACTION * ZOO_STEPS / limit}
    return runpy.run_path(str(SB3))["until_solved"](DQN, {**ZOO, **falling, "device": "cpu"}, limit, is_solved)
