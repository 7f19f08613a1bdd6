"""Pictures of classic control."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from jaxq.frames.canvas import BLUE, FAINT, GREEN, INK, ORANGE, PAPER, YELLOW, Canvas
from jaxq.worlds import Acrobot, CartPole, MountainCar, Pendulum

Size = tuple[int, int]


def cartpole(world: CartPole, state: Any, size: Size) -> np.ndarray:
    """The cart on its track between the thresholds, and the pole."""
    half = max(1.15 * world.x_threshold, 0.6)
    top = 2 * world.length + 0.45
    canvas = Canvas(size, (-half, -0.45), (half, max(top, 1.3)))
    x, theta, tip = float(state.x), float(state.theta), 2 * world.length
    canvas.line([(-half, 0), (half, 0)], FAINT, 0.03, round_ends=False)
    for side in (-1, 1):
        edge = side * world.x_threshold
        canvas.line([(edge, -0.12), (edge, 0.12)], ORANGE, 0.03)
    for side in (-1, 1):  # the angle that ends an episode
        angle = side * world.theta_threshold_radians
        canvas.line([(x, 0.12), (x + tip * math.sin(angle), 0.12 + tip * math.cos(angle))], FAINT, 0.012)
    canvas.box((x - 0.25, -0.12), (x + 0.25, 0.12), INK, rounded=0.04)
    for wheel in (-0.14, 0.14):
        canvas.disc((x + wheel, -0.14), 0.06, INK)
        canvas.disc((x + wheel, -0.14), 0.025, PAPER)
    canvas.line([(x, 0.12), (x + tip * math.sin(theta), 0.12 + tip * math.cos(theta))], BLUE, 0.08)
    canvas.disc((x, 0.12), 0.045, YELLOW)
    return canvas.pixels()


def acrobot(world: Acrobot, state: Any, size: Size) -> np.ndarray:
    """The two links on their bar, and the line to swing above."""
    reach = world.link_length_1 + 1.0 + 0.25  # Gymnasium's second link is 1 m long in the picture, and in no equation
    canvas = Canvas(size, (-reach, -reach), (reach, reach))
    one, both = float(state.theta1), float(state.theta1) + float(state.theta2)
    hip = world.link_length_1 * math.sin(one), -world.link_length_1 * math.cos(one)
    foot = hip[0] + math.sin(both), hip[1] - math.cos(both)
    canvas.line([(-reach, 1.0), (reach, 1.0)], GREEN, 0.025, round_ends=False)
    canvas.line([(0, 0), hip], INK, 0.15)
    canvas.line([hip, foot], BLUE, 0.13)
    canvas.disc((0, 0), 0.09, FAINT)
    canvas.disc(hip, 0.08, YELLOW)
    canvas.disc(foot, 0.07, ORANGE)
    return canvas.pixels()


def mountain_car(world: MountainCar, state: Any, size: Size) -> np.ndarray:
    """The car on the hills, and the flag at the goal."""

    def height(x: float) -> float:
        return 0.45 * math.sin(3 * x) + 0.55

    low, high = world.min_position, world.max_position
    canvas = Canvas(size, (low - 0.05, -0.05), (high + 0.05, 1.25))
    along = np.linspace(low - 0.3, high + 0.3, 160).tolist()
    hill = [(x, height(x)) for x in along]
    canvas.polygon([(along[0], -1.0), *hill, (along[-1], -1.0)], FAINT)
    canvas.line(hill, INK, 0.008, round_ends=False)
    canvas.line([(low, height(low)), (low, height(low) + 0.12)], ORANGE, 0.012)
    goal = world.goal_position
    canvas.line([(goal, height(goal)), (goal, height(goal) + 0.2)], INK, 0.008)
    canvas.polygon([(goal, height(goal) + 0.2), (goal + 0.09, height(goal) + 0.16), (goal, height(goal) + 0.12)], GREEN)
    x = float(state.position)
    slope = math.atan(0.45 * 3 * math.cos(3 * x))
    along_, up = (math.cos(slope), math.sin(slope)), (-math.sin(slope), math.cos(slope))

    def at(forward: float, above: float) -> tuple[float, float]:
        return x + forward * along_[0] + above * up[0], height(x) + forward * along_[1] + above * up[1]

    canvas.polygon([at(-0.07, 0.025), at(0.07, 0.025), at(0.07, 0.055), at(-0.07, 0.055)], BLUE)
    canvas.polygon([at(-0.04, 0.05), at(0.045, 0.05), at(0.025, 0.085), at(-0.025, 0.085)], BLUE)
    for wheel in (-0.04, 0.04):
        canvas.disc(at(wheel, 0.022), 0.02, INK)
        canvas.disc(at(wheel, 0.022), 0.008, PAPER)
    return canvas.pixels()


def pendulum(world: Pendulum, state: Any, size: Size) -> np.ndarray:
    """The rod, where up is the goal."""
    reach = 1.25 * world.length
    canvas = Canvas(size, (-reach, -reach), (reach, reach))
    angle, length = float(state.theta), world.length
    canvas.arc((0, 0), length, 0, 360, FAINT, 0.01 * length)
    canvas.line([(0, 0.95 * length), (0, 1.05 * length)], GREEN, 0.02 * length)
    # As in Gymnasium's picture, angles grow to the left.
    canvas.line([(0, 0), (-length * math.sin(angle), length * math.cos(angle))], BLUE, 0.16 * length)
    canvas.disc((0, 0), 0.05 * length, INK)
    return canvas.pixels()
