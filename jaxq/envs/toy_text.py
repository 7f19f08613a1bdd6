"""Toy text: Gymnasium's finite environments, from Gymnasium's own tables of outcomes.

``P[s][a]`` there is a list of (probability, next state, reward, terminated). What of it is a number here is traced: the
probability of going where one wants and FrozenLake's rewards share one program.
"""

from __future__ import annotations

import functools
from typing import Any, NamedTuple

import jax.numpy as jnp
import numpy as np

from jaxq.envs.mdp import MDP
from jaxq.envs.outcomes import Outcomes, as_mdp, outcome_mdp
from jaxq.types import Array, Env
from jaxq.worlds import CliffWalking, FrozenLake, FrozenLake8x8, Taxi, World

_LAKE, _LAKE_8X8, _CLIFF, _TAXI = FrozenLake(), FrozenLake8x8(), CliffWalking(), Taxi()


class FrozenLakeParams(NamedTuple):
    """The numbers of a frozen lake, each of which may be traced. ``worlds.FrozenLake`` says what each is."""

    success_rate: Array | float = _LAKE.success_rate
    goal_reward: Array | float = _LAKE.goal_reward
    hole_reward: Array | float = _LAKE.hole_reward
    frozen_reward: Array | float = _LAKE.frozen_reward
    max_episode_steps: Array | int = _LAKE.max_episode_steps


class FrozenLake8x8Params(NamedTuple):
    """The numbers of the larger lake, each of which may be traced. ``worlds.FrozenLake8x8`` says what each is."""

    success_rate: Array | float = _LAKE_8X8.success_rate
    goal_reward: Array | float = _LAKE_8X8.goal_reward
    hole_reward: Array | float = _LAKE_8X8.hole_reward
    frozen_reward: Array | float = _LAKE_8X8.frozen_reward
    max_episode_steps: Array | int = _LAKE_8X8.max_episode_steps


class CliffWalkingParams(NamedTuple):
    """The number of the walk along the cliff, which may be traced."""

    max_episode_steps: Array | int = _CLIFF.max_episode_steps


class TaxiParams(NamedTuple):
    """The numbers of the taxi, each of which may be traced. ``worlds.Taxi`` says what each is."""

    rainy_probability: Array | float = _TAXI.rainy_probability
    max_episode_steps: Array | int = _TAXI.max_episode_steps


class _Table(NamedTuple):
    """What Gymnasium's table says, but for probabilities."""

    outcomes: Outcomes
    rewards: tuple[float, ...]  # all that occur, ascending
    starts: np.ndarray


def frozen_lake(params: FrozenLakeParams = FrozenLakeParams(), *, is_slippery: bool = True) -> Env:  # noqa: B008
    """FrozenLake-v1: walk over 4 x 4 cells of ice to the goal, without falling into a hole.

    The observation is row * 4 + column; actions 0 to 3 go left, down, right, up. Where it is slippery one goes there
    with ``success_rate`` p, and to either side with (1 - p) / 2. An episode terminates in a hole or at the goal, and is
    truncated at ``max_episode_steps``. Shapes: obs [] int32. Raises ValueError as ``outcome_mdp`` for known numbers
    that are no probability, no finite reward or no number of steps. The reference is Gymnasium's ``FrozenLake-v1``.

    >>> frozen_lake().num_states
    16
    """
    return outcome_mdp(*_lake(params, is_slippery, "4x4"), max_episode_steps=params.max_episode_steps)


def frozen_lake_8x8(params: FrozenLake8x8Params = FrozenLake8x8Params(), *, is_slippery: bool = True) -> Env:  # noqa: B008
    """FrozenLake8x8-v1: ``frozen_lake`` of 8 x 8 cells; the observation is row * 8 + column. Raises as it does."""
    return outcome_mdp(*_lake(params, is_slippery, "8x8"), max_episode_steps=params.max_episode_steps)


def cliff_walking(params: CliffWalkingParams = CliffWalkingParams(), *, is_slippery: bool = False) -> Env:  # noqa: B008
    """CliffWalking-v1: walk along a cliff to the goal, -1 per step, -100 and back to the start over the edge.

    The observation is row * 12 + column of 4 x 12 cells; actions 0 to 3 go up, right, down, left. Where it is slippery
    one goes there or to either side, each with 1/3. An episode terminates at the goal, and is truncated at
    ``max_episode_steps``. Shapes: obs [] int32. Raises ValueError for known steps that are no whole number from 1 on.
    Sutton and Barto, 2018, example 6.6; the reference is Gymnasium's ``CliffWalking-v1``.
    """
    return outcome_mdp(*_cliff(is_slippery), max_episode_steps=params.max_episode_steps)


def taxi(params: TaxiParams = TaxiParams(), *, is_rainy: bool = False) -> Env:  # noqa: B008
    """Taxi-v4: fetch a passenger at one of four places and bring them to another, 20 for that, -1 per step, -10 for
    picking up or setting down where one cannot.

    The observation is ((row * 5 + column) * 5 + passenger) * 4 + destination; actions 0 to 3 go south, north, east,
    west, 4 picks up, 5 sets down. Where it rains a move that is possible goes there with ``rainy_probability`` p, and
    to either side with (1 - p) / 2. An episode terminates where the passenger is brought, and is truncated at
    ``max_episode_steps``. Shapes: obs [] int32. Raises ValueError as ``frozen_lake``. Dietterich, *Hierarchical
    Reinforcement Learning with the MAXQ Value Function Decomposition*, 2000; the reference is Gymnasium's ``Taxi-v4``.
    """
    return outcome_mdp(*_taxi(params, is_rainy), max_episode_steps=params.max_episode_steps)


def exact(world: World) -> MDP:
    """The arrays of a finite world, for ``solutions``: its transition tensor, rewards, start and terminal states.

    Time limits are no part of them. Raises ValueError for a world that is not one of these.

    >>> exact(FrozenLake()).transition.shape
    (16, 4, 16)
    """
    if isinstance(world, FrozenLake):
        of_map = "8x8" if isinstance(world, FrozenLake8x8) else "4x4"
        parts = _lake(world, world.is_slippery, of_map)
    elif isinstance(world, CliffWalking):
        parts = _cliff(world.is_slippery)
    elif isinstance(world, Taxi):
        parts = _taxi(world, world.is_rainy)
    else:
        raise ValueError(f"world: {world} is not allowed: FrozenLake, FrozenLake8x8, CliffWalking or Taxi")
    outcomes, probability, rewards, starts = parts
    # In float64: what was made of plain numbers must not be rounded.
    return as_mdp(outcomes, np.asarray(probability), np.asarray(rewards), starts)


def _lake(params: Any, is_slippery: bool, of_map: str) -> tuple[Outcomes, Any, Any, np.ndarray]:
    # 3, 2 and 1 stand for the three rewards, in the order of the rewards returned; where the episode is over it is 0.
    table = _table("frozen_lake:FrozenLakeEnv", map_name=of_map, is_slippery=is_slippery, reward_schedule=(3, 2, 1))
    rewards = _stack(0.0, params.frozen_reward, params.hole_reward, params.goal_reward)
    fails = (1 - params.success_rate) / 2
    return (
        table.outcomes,
        _stack(fails, params.success_rate, fails) if is_slippery else np.ones(1),
        rewards,
        table.starts,
    )


def _cliff(is_slippery: bool) -> tuple[Outcomes, Any, Any, np.ndarray]:
    table = _table("cliffwalking:CliffWalkingEnv", is_slippery=is_slippery)
    outcomes = table.outcomes.successor.shape[2]
    return table.outcomes, np.full(outcomes, 1 / outcomes), np.asarray(table.rewards), table.starts


def _taxi(params: Any, is_rainy: bool) -> tuple[Outcomes, Any, Any, np.ndarray]:
    table = _table("taxi:TaxiEnv", is_rainy=is_rainy)
    drifts = (1 - params.rainy_probability) / 2
    likely = _stack(params.rainy_probability, drifts, drifts) if is_rainy else np.ones(1)
    return table.outcomes, likely, np.asarray(table.rewards), table.starts


def _stack(*numbers: Any) -> Any:
    """Numbers that are known stay NumPy's float64; tracers become an array of JAX's."""
    if all(isinstance(one, (int, float, np.generic)) for one in numbers):
        return np.array(numbers, float)
    return jnp.stack([jnp.asarray(one, jnp.float32) for one in numbers])


@functools.lru_cache(maxsize=32)
def _table(where: str, **options: Any) -> _Table:
    """The table of Gymnasium's environment; an action with one outcome where others have K has it K times."""
    import importlib

    module, name = where.split(":")
    env = getattr(importlib.import_module(f"gymnasium.envs.toy_text.{module}"), name)(**options)
    most = max(len(listed) for actions in env.P.values() for listed in actions.values())
    rows = [[(listed * most)[:most] for _, listed in sorted(actions.items())] for _, actions in sorted(env.P.items())]
    found = np.array([[[(s, r, ends) for _, s, r, ends in listed] for listed in state] for state in rows], float)
    rewards, which = np.unique(found[..., 1], return_inverse=True)
    outcomes = Outcomes(
        successor=found[..., 0].astype(np.int32),
        reward=which.reshape(found.shape[:3]).astype(np.int32),
        terminated=found[..., 2] > 0,
    )
    begins = np.asarray(env.initial_state_distrib)
    starts = np.flatnonzero(begins)
    if not np.allclose(begins[starts], 1 / len(starts)):
        raise ValueError(f"{where}: its first states are not equally likely")
    return _Table(outcomes, tuple(rewards.tolist()), starts)
