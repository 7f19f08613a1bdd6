"""Toy text: the numbers of Gymnasium's finite environments."""

from __future__ import annotations

from typing import ClassVar

from jaxq.settings import NO_LIMIT, number, structure
from jaxq.worlds.world import SIGNED, World

PROBABILITY = {"ge": 0.0, "le": 1.0}


class FrozenLake(World):
    """Gymnasium's FrozenLake-v1, 4 x 4 cells of ice with holes."""

    id: ClassVar[str] = "FrozenLake-v1"
    frame_rate: ClassVar[int] = 4
    summary: ClassVar[str] = "4 x 4 cells of ice with holes"
    reward_threshold: ClassVar[float | None] = 0.7

    success_rate: float = number(1 / 3, "probability of going where one wants, where it is slippery", **PROBABILITY)
    goal_reward: float = number(1.0, "reward for the goal", **SIGNED)
    hole_reward: float = number(0.0, "reward for a hole", **SIGNED)
    frozen_reward: float = number(0.0, "reward for a step on the ice", **SIGNED)
    max_episode_steps: int = number(100, "steps after which an episode is truncated", ge=1, le=NO_LIMIT)
    is_slippery: bool = structure(True, "whether one may slide to either side of where one wants to go")

    def actions(self) -> tuple[str, ...]:
        return ("left", "down", "right", "up")


class FrozenLake8x8(FrozenLake):
    """Gymnasium's FrozenLake8x8-v1, 8 x 8 cells of ice with holes."""

    id: ClassVar[str] = "FrozenLake8x8-v1"
    summary: ClassVar[str] = "8 x 8 cells of ice with holes"
    reward_threshold: ClassVar[float | None] = 0.85

    max_episode_steps: int = number(200, "steps after which an episode is truncated", ge=1, le=NO_LIMIT)


class CliffWalking(World):
    """Gymnasium's CliffWalking-v1, a walk along a cliff."""

    id: ClassVar[str] = "CliffWalking-v1"
    frame_rate: ClassVar[int] = 4
    summary: ClassVar[str] = "a walk along a cliff"
    eval_steps: ClassVar[int] = 1000  # a greedy policy may go in circles

    max_episode_steps: int = number(NO_LIMIT, "steps after which an episode is truncated", ge=1, le=NO_LIMIT)
    is_slippery: bool = structure(False, "whether one may slide to either side of where one wants to go")

    def actions(self) -> tuple[str, ...]:
        return ("up", "right", "down", "left")


class Taxi(World):
    """Gymnasium's Taxi-v4, a passenger to fetch and to bring."""

    id: ClassVar[str] = "Taxi-v4"
    frame_rate: ClassVar[int] = 4
    summary: ClassVar[str] = "a passenger to fetch and to bring"
    reward_threshold: ClassVar[float | None] = 8.0

    rainy_probability: float = number(0.8, "probability of going where one wants, where it rains", **PROBABILITY)
    max_episode_steps: int = number(200, "steps after which an episode is truncated", ge=1, le=NO_LIMIT)
    is_rainy: bool = structure(False, "whether one may drift to either side of where one wants to go")

    def actions(self) -> tuple[str, ...]:
        return ("south", "north", "east", "west", "pick up", "set down")
