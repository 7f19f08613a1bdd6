"""Real Gymnasium environments with the numbers of ours, and greedy episodes in them."""

from __future__ import annotations

from typing import Any

import gymnasium
import numpy as np

from jaxq.saved_policy import SavedPolicy
from jaxq.worlds import CartPole, World


def make(world: World) -> gymnasium.Env:
    """Gymnasium's environment of a world, with its numbers and options.

    Raises ValueError for a world that Gymnasium has none of.
    """
    if not isinstance(world, CartPole):
        raise ValueError(f"env: Gymnasium has no {world} of ours")
    env = gymnasium.make(
        world.id, max_episode_steps=world.max_episode_steps, sutton_barto_reward=world.sutton_barto_reward
    )
    bare: Any = env.unwrapped
    for name in ("gravity", "masscart", "masspole", "length", "force_mag", "tau"):
        setattr(bare, name, getattr(world, name))
    bare.theta_threshold_radians, bare.x_threshold = world.theta_threshold_radians, world.x_threshold
    bare.total_mass, bare.polemass_length = world.masscart + world.masspole, world.masspole * world.length
    bare.kinematics_integrator = "euler" if world.integrator == "euler" else "semi-implicit euler"
    return env


def greedy_returns(world: World, policy: SavedPolicy, starts: np.ndarray) -> np.ndarray:
    """Returns of whole greedy episodes from given states. Shapes: starts [n, 4] -> [n]."""
    envs = [make(world) for _ in starts]
    obs = np.empty((len(starts), 4), np.float32)
    for env, start, row in zip(envs, starts, obs, strict=True):
        env.reset(seed=0)
        bare: Any = env.unwrapped
        bare.state = np.array(start, np.float64)
        row[:] = start
    totals, live = np.zeros(len(starts)), np.ones(len(starts), bool)
    while live.any():
        going = np.flatnonzero(live)
        for i, action in zip(going.tolist(), policy.act(obs[going]).tolist(), strict=True):
            obs[i], reward, terminated, truncated, _ = envs[i].step(action)
            totals[i] += float(reward)
            live[i] = not (terminated or truncated)
    return totals
