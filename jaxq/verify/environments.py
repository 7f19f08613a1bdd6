"""Every environment against Gymnasium's: its numbers, a step from any state, resets, whole
episodes, tables of outcomes."""

from __future__ import annotations

from collections.abc import Iterator
from importlib import metadata

import gymnasium

from jaxq.settings import NO_LIMIT
from jaxq.suggest import nearest
from jaxq.verify import episodes, outcomes, resets, steps
from jaxq.verify.checks import Found, Job
from jaxq.verify.states import BETWEEN
from jaxq.worlds import (
    WORLDS,
    Acrobot,
    CartPole,
    CliffWalking,
    FrozenLake,
    FrozenLake8x8,
    MountainCar,
    Pendulum,
    Taxi,
    World,
)

#: Other worlds beside the defaults. In those that are "otherwise" every number is another one; none makes a step
#: larger than the defaults do, so that the errors allowed stay what they are. Gymnasium's Acrobot cannot be given
#: another gravity, nor noise.
VARIANTS: tuple[tuple[str, World], ...] = (
    (
        "otherwise",
        CartPole(
            gravity=9.1,
            masscart=1.3,
            masspole=0.17,
            length=0.6,
            force_mag=8.0,
            tau=0.017,
            theta_threshold_radians=0.17,
            x_threshold=1.9,
            max_episode_steps=300,
            reset_low=-0.03,
            reset_high=0.07,
            integrator="semi-implicit",
            sutton_barto_reward=True,
        ),
    ),
    ("nips", Acrobot(dynamics="nips")),
    (
        "otherwise",
        Acrobot(
            link_length_1=0.9,
            link_mass_1=1.2,
            link_mass_2=0.8,
            link_com_pos_1=0.6,
            link_com_pos_2=0.4,
            link_moi=1.1,
            torque=0.7,
            max_vel_1=10.0,
            max_vel_2=20.0,
            dt=0.15,
            max_episode_steps=300,
            reset_low=-0.05,
            reset_high=0.15,
        ),
    ),
    (
        "otherwise",
        MountainCar(
            min_position=-1.1,
            max_position=0.55,
            max_speed=0.06,
            goal_position=0.45,
            goal_velocity=0.02,
            force=0.0009,
            gravity=0.0023,
            max_episode_steps=300,
            reset_low=-0.7,
            reset_high=-0.3,
        ),
    ),
    (
        "otherwise",
        Pendulum(
            gravity=9.0,
            mass=0.75,  # 3 / (m l^2) is 1: Gymnasium multiplies a torque of float32 by it
            length=2.0,
            dt=0.04,
            max_speed=7.0,
            max_torque=1.5,
            max_episode_steps=300,
            reset_angle=2.0,
            reset_speed=0.7,
            num_torques=3,
        ),
    ),
    ("dry", FrozenLake(is_slippery=False)),
    *(
        ("otherwise", kind(success_rate=0.6, goal_reward=2.5, hole_reward=-1.5, frozen_reward=-0.25))
        for kind in (FrozenLake, FrozenLake8x8)
    ),
    ("slippery", CliffWalking(is_slippery=True, max_episode_steps=300)),
    ("rainy", Taxi(is_rainy=True)),
    ("otherwise", Taxi(is_rainy=True, rainy_probability=0.6)),
)

#: Labels of those that begin as the default does.
SAME_START = ("nips", "dry", "slippery", "rainy")


def jobs(cases: int, against: str | None = None) -> Iterator[Job]:
    """The checks of all environments, with ``cases`` random states each; with ``against`` of one alone, see ``run``.

    Raises ValueError for an id that Gymnasium does not know, or whose last part is no world of ours with states to be
    put into.
    """
    if against is not None:
        yield from _against(cases, against)
        return
    said = f"gymnasium {metadata.version('gymnasium')}"
    for label, world in [*(("", kind()) for kind in WORLDS.values()), *VARIANTS]:
        name = f"{world.id} {label}".strip()
        if not label:
            yield Job("environments", f"{name}: limit and threshold", said, lambda world=world: _numbers(world))  # type: ignore[misc]
        if world.id in BETWEEN:
            for dtype in steps.DTYPES:
                yield Job(
                    "environments",
                    f"{name}: a step, {dtype}",
                    said,
                    lambda world=world, dtype=dtype: steps.compared(world, dtype, cases),  # type: ignore[misc]
                )
        else:
            yield Job("environments", f"{name}: exact arrays", said, lambda world=world: outcomes.tabulated(world))  # type: ignore[misc]
            yield Job("environments", f"{name}: outcomes", said, lambda world=world: outcomes.compared(world, cases))  # type: ignore[misc]
        if label not in SAME_START:
            yield Job("environments", f"{name}: resets", said, lambda world=world: resets.compared(world))  # type: ignore[misc]
        yield Job("environments", f"{name}: episodes", said, lambda world=world: episodes.compared(world, cases))  # type: ignore[misc]


def _against(cases: int, against: str) -> Iterator[Job]:
    name = against.rsplit("/", 1)[-1]
    if name not in BETWEEN:
        raise ValueError(f"against: {against!r} is not allowed: its last part must be one of {', '.join(BETWEEN)}")
    if against not in gymnasium.registry:
        raise ValueError(f"against: {against!r} is unknown to Gymnasium{nearest(against, gymnasium.registry)}")
    world = WORLDS[name]()
    said = f"{against} of gymnasium {metadata.version('gymnasium')}"
    for dtype in steps.DTYPES:
        yield Job(
            "environments",
            f"{name}: a step, {dtype}",
            said,
            lambda dtype=dtype: steps.compared(world, dtype, cases, against),  # type: ignore[misc]
        )


def _numbers(world: World) -> Found:
    """Counts what Gymnasium registers otherwise."""
    spec = gymnasium.spec(world.id)
    limit = world.flat()["max_episode_steps"]
    pairs = {
        "max_episode_steps": (None if limit == NO_LIMIT else limit, spec.max_episode_steps),
        "reward_threshold": (world.reward_threshold, spec.reward_threshold),
    }
    wrong = [f"{name}: ours {ours}, theirs {theirs}" for name, (ours, theirs) in pairs.items() if ours != theirs]
    return Found(len(pairs), len(wrong), 0, "; ".join(wrong))
