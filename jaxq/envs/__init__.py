"""Environments by name.

>>> make("CartPole-v1", length=0.25).num_actions
2
"""

from __future__ import annotations

from typing import Any

import numpy as np

from jaxq.envs.acrobot import AcrobotParams, AcrobotState, acrobot
from jaxq.envs.auto_reset import auto_reset
from jaxq.envs.cartpole import CartPoleParams, CartPoleState, cartpole
from jaxq.envs.discretise import discretise, tutorial_edges
from jaxq.envs.frame_history import frame_history
from jaxq.envs.mdp import MDP, MDPState, finite_mdp, random_mdp
from jaxq.envs.moments import Moments
from jaxq.envs.mountain_car import MountainCarParams, MountainCarState, mountain_car
from jaxq.envs.normalise import normalise_observation, normalise_reward
from jaxq.envs.one_hot import one_hot
from jaxq.envs.outcomes import Outcomes, outcome_mdp
from jaxq.envs.pendulum import PendulumParams, PendulumState, pendulum
from jaxq.envs.probes import Probe, ProbeState, probes
from jaxq.envs.scale_reward import scale_reward
from jaxq.envs.solutions import policy_evaluation, stationary_distribution, value_iteration
from jaxq.envs.sticky_actions import sticky_actions
from jaxq.envs.time_limit import time_limit
from jaxq.envs.toy_text import (
    CliffWalkingParams,
    FrozenLake8x8Params,
    FrozenLakeParams,
    TaxiParams,
    cliff_walking,
    exact,
    frozen_lake,
    frozen_lake_8x8,
    taxi,
)
from jaxq.envs.two_states import two_states, two_states_q_star
from jaxq.settings import changed
from jaxq.suggest import nearest
from jaxq.types import Env
from jaxq.worlds import WORLDS

__all__ = [
    "MDP",
    "AcrobotParams",
    "AcrobotState",
    "CartPoleParams",
    "CartPoleState",
    "CliffWalkingParams",
    "FrozenLake8x8Params",
    "FrozenLakeParams",
    "MDPState",
    "Moments",
    "MountainCarParams",
    "MountainCarState",
    "Outcomes",
    "PendulumParams",
    "PendulumState",
    "Probe",
    "ProbeState",
    "TaxiParams",
    "acrobot",
    "auto_reset",
    "cartpole",
    "cliff_walking",
    "discretise",
    "exact",
    "finite_mdp",
    "frame_history",
    "frozen_lake",
    "frozen_lake_8x8",
    "make",
    "mountain_car",
    "names",
    "normalise_observation",
    "normalise_reward",
    "one_hot",
    "outcome_mdp",
    "pendulum",
    "policy_evaluation",
    "probes",
    "random_mdp",
    "registered",
    "scale_reward",
    "stationary_distribution",
    "sticky_actions",
    "taxi",
    "time_limit",
    "tutorial_edges",
    "two_states",
    "two_states_q_star",
    "value_iteration",
]

_REGISTRY = {
    "CartPole-v1": (cartpole, CartPoleParams),
    "Acrobot-v1": (acrobot, AcrobotParams),
    "MountainCar-v0": (mountain_car, MountainCarParams),
    "Pendulum-v1": (pendulum, PendulumParams),
    "FrozenLake-v1": (frozen_lake, FrozenLakeParams),
    "FrozenLake8x8-v1": (frozen_lake_8x8, FrozenLake8x8Params),
    "CliffWalking-v1": (cliff_walking, CliffWalkingParams),
    "Taxi-v4": (taxi, TaxiParams),
}


def names() -> list[str]:
    """The names that ``make`` knows."""
    return sorted(_REGISTRY)


def registered(name: str) -> tuple[Any, Any]:
    """The factory of an environment, a function of its numbers and options, and the record of its numbers.

    Raises ValueError for an unknown name.
    """
    if not isinstance(name, str) or name not in _REGISTRY:
        raise ValueError(f"environment: {name!r} is unknown{nearest(str(name), names())}")
    return _REGISTRY[name]


def make(name: str, **settings: Any) -> Env:
    """The environment of that name; settings are fields of its physics or options of its factory.

    Raises ValueError for an unknown name and for a known number or option outside of what ``worlds`` allows, and
    TypeError for an unknown setting, with the nearest known one.
    """
    factory, params_type = registered(name)
    options = set(factory.__kwdefaults__ or {})
    unknown = [k for k in settings if k not in params_type._fields and k not in options]
    if unknown:
        raise TypeError(f"{name}: no setting {unknown[0]!r}{nearest(unknown[0], [*params_type._fields, *options])}")
    kind, plain = WORLDS[name], (bool, int, float, str, np.generic)  # what is traced, nobody can look at
    known = {k: v for k, v in settings.items() if k in kind.model_fields and isinstance(v, plain)}
    world: Any = changed(kind(), known)
    settings |= {k: getattr(world, k) for k in known}
    params = params_type(**{k: v for k, v in settings.items() if k in params_type._fields})
    return factory(params, **{k: v for k, v in settings.items() if k in options})
