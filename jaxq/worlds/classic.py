"""Classic control: the numbers of Gymnasium's environments whose actions are discrete, or made so."""

from __future__ import annotations

import math
from typing import Any, ClassVar, Literal, TypeAlias

from pydantic import model_validator

from jaxq.settings import NO_LIMIT, number, structure
from jaxq.worlds.world import SIGNED, SIZE, Bounds, World


def _limit(steps: int) -> int:
    return number(steps, "steps after which an episode is truncated", ge=1, le=NO_LIMIT)  # type: ignore[no-any-return]


#: How CartPole's equations of motion are stepped, and which Acrobot's are.
Integrator: TypeAlias = Literal["euler", "semi-implicit"]
Dynamics: TypeAlias = Literal["book", "nips"]


class CartPole(World):
    """Gymnasium's classic CartPole-v1."""

    id: ClassVar[str] = "CartPole-v1"
    frame_rate: ClassVar[int] = 50
    summary: ClassVar[str] = "a pole on a cart, to be kept upright"
    reward_threshold: ClassVar[float | None] = 475.0

    gravity: float = number(9.8, "m/s^2", **SIZE)
    masscart: float = number(1.0, "kg: mass of the cart", **SIZE)
    masspole: float = number(0.1, "kg: mass of the pole", **SIZE)
    length: float = number(0.5, "m: half the pole's length", **SIZE)
    force_mag: float = number(10.0, "N: force of a push", **SIZE)
    tau: float = number(0.02, "s between two steps", **SIZE)
    theta_threshold_radians: float = number(12 * 2 * math.pi / 360, "rad: pole angle that ends an episode", **SIZE)
    x_threshold: float = number(2.4, "m: cart position that ends an episode", **SIZE)
    max_episode_steps: int = _limit(500)
    reset_low: float = number(-0.05, "least of each coordinate at a reset", **SIGNED)
    reset_high: float = number(0.05, "greatest of each coordinate at a reset", **SIGNED)
    integrator: Integrator = structure("euler", "how the equations of motion are stepped")
    sutton_barto_reward: bool = structure(False, "reward 0, and -1 for the step that falls")

    @model_validator(mode="after")
    def _ordered(self) -> CartPole:
        _check_order(self, "reset_low", "reset_high")
        return self

    def actions(self) -> tuple[str, ...]:
        return ("left", "right")

    @staticmethod
    def observed(numbers: Any) -> Bounds:
        """Twice the thresholds, so that the state which ends an episode is inside."""
        x, theta = 2 * numbers.x_threshold, 2 * numbers.theta_threshold_radians
        return [(-x, x), (-math.inf, math.inf), (-theta, theta), (-math.inf, math.inf)]


class Acrobot(World):
    """Gymnasium's Acrobot-v1, two links of which the second is driven."""

    id: ClassVar[str] = "Acrobot-v1"
    frame_rate: ClassVar[int] = 15
    summary: ClassVar[str] = "two links of which the second is driven, to be swung up"
    reward_threshold: ClassVar[float | None] = -100.0
    buckets: ClassVar[tuple[int, ...] | None] = (4, 4, 4, 4, 5, 5)

    gravity: float = number(9.8, "m/s^2", **SIZE)
    link_length_1: float = number(1.0, "m: length of the first link", **SIZE)
    link_mass_1: float = number(1.0, "kg: mass of the first link", **SIZE)
    link_mass_2: float = number(1.0, "kg: mass of the second link", **SIZE)
    link_com_pos_1: float = number(0.5, "m: from the first joint to the first link's centre of mass", **SIZE)
    link_com_pos_2: float = number(0.5, "m: from the second joint to the second link's centre of mass", **SIZE)
    link_moi: float = number(1.0, "kg m^2: moment of inertia of each link", **SIZE)
    torque: float = number(1.0, "N m: of action 2; action 0 has the opposite, action 1 none", **SIZE)
    torque_noise_max: float = number(0.0, "N m: greatest size of uniform noise on the torque", ge=0, le=1e6)
    max_vel_1: float = number(4 * math.pi, "rad/s: greatest speed of the first joint", **SIZE)
    max_vel_2: float = number(9 * math.pi, "rad/s: greatest speed of the second joint", **SIZE)
    dt: float = number(0.2, "s between two steps", **SIZE)
    max_episode_steps: int = _limit(500)
    reset_low: float = number(-0.1, "least of each coordinate at a reset", **SIGNED)
    reset_high: float = number(0.1, "greatest of each coordinate at a reset", **SIGNED)
    dynamics: Dynamics = structure("book", "equations of motion of the book, or of the paper of 1995")

    @model_validator(mode="after")
    def _ordered(self) -> Acrobot:
        _check_order(self, "reset_low", "reset_high")
        return self

    def actions(self) -> tuple[str, ...]:
        return ("back", "none", "forth")

    @staticmethod
    def observed(numbers: Any) -> Bounds:
        """Cosines and sines, and the greatest speeds."""
        speeds = numbers.max_vel_1, numbers.max_vel_2
        return [(-1.0, 1.0)] * 4 + [(-speed, speed) for speed in speeds]


class MountainCar(World):
    """Gymnasium's MountainCar-v0, a car too weak for the hill before it."""

    id: ClassVar[str] = "MountainCar-v0"
    summary: ClassVar[str] = "a car too weak for the hill before it"
    reward_threshold: ClassVar[float | None] = -110.0
    buckets: ClassVar[tuple[int, ...] | None] = (20, 20)

    min_position: float = number(-1.2, "m: the wall", **SIGNED)
    max_position: float = number(0.6, "m: the right end", **SIGNED)
    max_speed: float = number(0.07, "m per step: greatest speed", **SIZE)
    goal_position: float = number(0.5, "m: position that ends an episode", **SIGNED)
    goal_velocity: float = number(0.0, "m per step: least velocity at the goal", **SIGNED)
    force: float = number(0.001, "m per step^2: what a push adds to the velocity", **SIZE)
    gravity: float = number(0.0025, "m per step^2: what the steepest slope adds to the velocity", **SIZE)
    max_episode_steps: int = _limit(200)
    reset_low: float = number(-0.6, "m: least position at a reset", **SIGNED)
    reset_high: float = number(-0.4, "m: greatest position at a reset", **SIGNED)

    @model_validator(mode="after")
    def _ordered(self) -> MountainCar:
        _check_order(self, "min_position", "max_position")
        _check_order(self, "reset_low", "reset_high")
        return self

    def actions(self) -> tuple[str, ...]:
        return ("left", "none", "right")

    @staticmethod
    def observed(numbers: Any) -> Bounds:
        """The track, and the greatest speed."""
        return [(numbers.min_position, numbers.max_position), (-numbers.max_speed, numbers.max_speed)]


class Pendulum(World):
    """Gymnasium's Pendulum-v1, its torque one of a few."""

    id: ClassVar[str] = "Pendulum-v1"
    summary: ClassVar[str] = "a rod to be swung up and held, its torque one of a few"
    buckets: ClassVar[tuple[int, ...] | None] = (9, 9, 11)

    gravity: float = number(10.0, "m/s^2", **SIZE)
    mass: float = number(1.0, "kg", **SIZE)
    length: float = number(1.0, "m", **SIZE)
    dt: float = number(0.05, "s between two steps", **SIZE)
    max_speed: float = number(8.0, "rad/s: greatest speed", **SIZE)
    max_torque: float = number(2.0, "N m: greatest torque", **SIZE)
    max_episode_steps: int = _limit(200)
    reset_angle: float = number(math.pi, "rad: greatest size of the angle at a reset", ge=0, le=1e6)
    reset_speed: float = number(1.0, "rad/s: greatest size of the speed at a reset", ge=0, le=1e6)
    num_torques: int = structure(5, "torques to choose from, evenly from minus to plus max_torque", ge=2, le=1001)

    def actions(self) -> tuple[str, ...]:
        return tuple(f"{self.max_torque * (2 * k / (self.num_torques - 1) - 1):+.3g}" for k in range(self.num_torques))

    @staticmethod
    def observed(numbers: Any) -> Bounds:
        """Cosine and sine, and the greatest speed."""
        return [(-1.0, 1.0), (-1.0, 1.0), (-numbers.max_speed, numbers.max_speed)]


def _check_order(of: World, low: str, high: str) -> None:
    """Raises ValueError where a lower bound is above its upper one."""
    if getattr(of, low) > getattr(of, high):
        raise ValueError(f"{low}: {getattr(of, low)} must not be above {high} ({getattr(of, high)})")
