"""Environments by name.

>>> make("CartPole-v1", length=0.25).num_actions
2
"""

from __future__ import annotations

from typing import Any

from jaxq.envs.auto_reset import auto_reset
from jaxq.envs.cartpole import CartPoleParams, CartPoleState, cartpole
from jaxq.envs.discretise import discretise, tutorial_edges
from jaxq.envs.mdp import MDP, MDPState, finite_mdp, random_mdp
from jaxq.envs.one_hot import one_hot
from jaxq.envs.probes import Probe, ProbeState, probes
from jaxq.envs.solutions import policy_evaluation, value_iteration
from jaxq.suggest import nearest
from jaxq.types import Env

__all__ = [
    "MDP",
    "CartPoleParams",
    "CartPoleState",
    "MDPState",
    "Probe",
    "ProbeState",
    "auto_reset",
    "cartpole",
    "discretise",
    "finite_mdp",
    "make",
    "names",
    "one_hot",
    "policy_evaluation",
    "probes",
    "random_mdp",
    "registered",
    "tutorial_edges",
    "value_iteration",
]

_REGISTRY = {"CartPole-v1": (cartpole, CartPoleParams)}


def names() -> list[str]:
    """The names that ``make`` knows."""
    return sorted(_REGISTRY)


def registered(name: str) -> tuple[Any, Any]:
    """The factory of an environment, a function of its numbers and options, and the record of its numbers.

    Raises ValueError for an unknown name.
    """
    if name not in _REGISTRY:
        raise ValueError(f"environment: {name!r} is unknown{nearest(name, names())}")
    return _REGISTRY[name]


def make(name: str, **settings: Any) -> Env:
    """The environment of that name; settings are fields of its physics or options of its factory.

    Raises ValueError for an unknown name and TypeError for an unknown setting, with the nearest known one.
    """
    factory, params_type = registered(name)
    options = set(factory.__kwdefaults__ or {})
    unknown = [k for k in settings if k not in params_type._fields and k not in options]
    if unknown:
        raise TypeError(f"{name}: no setting {unknown[0]!r}{nearest(unknown[0], [*params_type._fields, *options])}")
    params = params_type(**{k: v for k, v in settings.items() if k in params_type._fields})
    return factory(params, **{k: v for k, v in settings.items() if k in options})
