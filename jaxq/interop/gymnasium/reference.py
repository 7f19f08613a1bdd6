"""Gymnasium's own environments with the numbers of ours, put into our states; and greedy episodes in them."""

from __future__ import annotations

from typing import Any

import gymnasium
import numpy as np
from gymnasium.wrappers import TimeLimit

from jaxq.saved_policy import SavedPolicy
from jaxq.settings import NO_LIMIT
from jaxq.worlds import WORLDS, Acrobot, CartPole, CliffWalking, FrozenLake, MountainCar, Pendulum, Taxi, World

#: Gymnasium's attributes for numbers of ours.
_CARTPOLE = ("gravity", "masscart", "masspole", "length", "force_mag", "tau", "theta_threshold_radians", "x_threshold")
_ACROBOT = (
    *("link_length_1", "link_mass_1", "link_mass_2", "link_com_pos_1", "link_com_pos_2", "link_moi"),
    *("max_vel_1", "max_vel_2"),
)
_MOUNTAIN_CAR = ("min_position", "max_position", "max_speed", "goal_position", "goal_velocity", "force", "gravity")
_PENDULUM = {
    "gravity": "g",
    "mass": "m",
    "length": "l",
    "dt": "dt",
    "max_speed": "max_speed",
    "max_torque": "max_torque",
}
#: Numbers that Gymnasium's environment of a world cannot be given.
_FIXED: dict[type[World], tuple[str, ...]] = {Acrobot: ("gravity", "torque_noise_max")}


def make(world: World) -> gymnasium.Env:
    """Gymnasium's environment of a world, with its numbers and options.

    Raises ValueError for a world that Gymnasium has none of, and for numbers that its environment cannot be given.
    """
    if WORLDS.get(world.id) is not type(world):
        raise ValueError(f"env: Gymnasium has no {world} of ours")
    for name in _FIXED.get(type(world), ()):
        if getattr(world, name) != (given := getattr(type(world)(), name)):
            raise ValueError(f"env.{name}: {getattr(world, name)} is not allowed: Gymnasium's {world} has {given}")
    limit = world.flat()["max_episode_steps"]
    options: dict[str, Any] = {} if limit == NO_LIMIT else {"max_episode_steps": limit}
    if isinstance(world, CartPole):
        options["sutton_barto_reward"] = world.sutton_barto_reward
    elif isinstance(world, FrozenLake):
        rewards = (world.goal_reward, world.hole_reward, world.frozen_reward)
        options |= {"is_slippery": world.is_slippery, "success_rate": world.success_rate, "reward_schedule": rewards}
    elif isinstance(world, CliffWalking):
        options["is_slippery"] = world.is_slippery
    elif isinstance(world, Taxi):
        options |= {"is_rainy": world.is_rainy, "rainy_probability": world.rainy_probability}
    env = gymnasium.make(world.id, **options)
    _set_numbers(env.unwrapped, world)
    return env


def place(env: gymnasium.Env, world: World, state: Any) -> None:
    """Puts Gymnasium's environment of a world into a state of ours, its time included; it was reset before.

    The state is a NamedTuple of one environment's numbers. An episode in it goes on, except that CartPole outside its
    thresholds is one that has fallen before.
    """
    bare: Any = env.unwrapped
    if isinstance(world, (CartPole, Acrobot, MountainCar, Pendulum)):
        bare.state = np.array([float(value) for value in state[:-1]], np.float64)
    else:
        bare.s = int(state.s)
    if isinstance(world, CartPole):
        fallen = abs(bare.state[0]) > bare.x_threshold or abs(bare.state[2]) > bare.theta_threshold_radians
        bare.steps_beyond_terminated = 1 if fallen else None
    outer: Any = env
    while outer is not bare:
        if isinstance(outer, TimeLimit):
            outer._elapsed_steps = int(state.t)
        outer = outer.env


def action(world: World, index: int) -> Any:
    """Gymnasium's action for ours: the torque of a pendulum, the index of all others."""
    if isinstance(world, Pendulum):
        count = world.num_torques
        return np.array([world.max_torque * (2 * index - (count - 1)) / (count - 1)], np.float32)
    return int(index)


def same_episodes(world: World) -> bool:
    """Whether the same actions from the same state lead through the same states in both."""
    options = world.flat()
    return not (options.get("is_slippery") or options.get("is_rainy") or options.get("torque_noise_max"))


def greedy_returns(world: World, policy: SavedPolicy, starts: Any) -> np.ndarray:
    """Returns of whole greedy episodes from given states.

    Shapes: starts is a state whose leaves are [n] -> [n]. Raises ValueError as ``make``.
    """
    states = [type(starts)(*row) for row in zip(*(np.asarray(leaf) for leaf in starts), strict=True)]
    envs = [make(world) for _ in states]
    obs: list[Any] = []
    for i, (env, state) in enumerate(zip(envs, states, strict=True)):
        env.reset(seed=i)
        place(env, world, state)
        obs.append(_observed(env))
    totals, live = np.zeros(len(states)), np.ones(len(states), bool)
    limit = world.eval_steps
    steps = 0
    while live.any() and steps < limit:
        going = np.flatnonzero(live).tolist()
        actions = policy.act(np.array([obs[i] for i in going])).tolist()
        for i, chosen in zip(going, actions, strict=True):
            obs[i], reward, terminated, truncated, _ = envs[i].step(action(world, chosen))
            totals[i] += float(reward)
            live[i] = not (terminated or truncated)
        steps += 1
    return totals


def _observed(env: gymnasium.Env) -> Any:
    """What Gymnasium's environment shows of the state it was put into."""
    bare: Any = env.unwrapped
    if hasattr(bare, "_get_ob"):
        return bare._get_ob()
    if hasattr(bare, "_get_obs"):
        return bare._get_obs()
    return np.array(bare.state, np.float32) if hasattr(bare, "state") else bare.s


def _set_numbers(bare: Any, world: World) -> None:
    if isinstance(world, CartPole):
        for name in _CARTPOLE:
            setattr(bare, name, getattr(world, name))
        bare.total_mass, bare.polemass_length = world.masscart + world.masspole, world.masspole * world.length
        bare.kinematics_integrator = "euler" if world.integrator == "euler" else "semi-implicit euler"
    elif isinstance(world, Acrobot):
        for name in _ACROBOT:
            setattr(bare, name.upper(), getattr(world, name))
        bare.dt, bare.book_or_nips = world.dt, world.dynamics
        bare.AVAIL_TORQUE = [-world.torque, 0.0, world.torque]
    elif isinstance(world, MountainCar):
        for name in _MOUNTAIN_CAR:
            setattr(bare, name, getattr(world, name))
    elif isinstance(world, Pendulum):
        for ours, theirs in _PENDULUM.items():
            setattr(bare, theirs, getattr(world, ours))
