"""Gymnasium, both ways. Importing this registers every world as a Gymnasium environment, ``jaxq/CartPole-v1`` etc.

``gymnasium.make("jaxq/CartPole-v1", length=0.25)`` and ``gymnasium.make_vec("jaxq/CartPole-v1", num_envs=8)`` work
then, and ``gymnasium.make("jaxq.interop.gymnasium:jaxq/CartPole-v1")`` without an import. No jax is imported before
an environment is made. ``train`` has our learners in any Gymnasium environment; ``reference`` has Gymnasium's own
environments with the numbers of ours.
"""

from __future__ import annotations

import importlib
from typing import Any

import gymnasium

from jaxq.settings import NO_LIMIT
from jaxq.worlds import WORLDS

NAMESPACE = "jaxq"

_NAMES = {
    "PureEnv": "env",
    "PureVectorEnv": "vector",
    "Trained": "trained",
    "action": "reference",
    "greedy_returns": "reference",
    "load": "trained",
    "make": "reference",
    "place": "reference",
    "train": "host",
}

__all__ = [*_NAMES, "register"]


def register() -> None:
    """Registers every world as ``jaxq/<id>``, with Gymnasium's threshold and time limit; twice is once."""
    for name, kind in WORLDS.items():
        limit = kind().flat()["max_episode_steps"]
        if f"{NAMESPACE}/{name}" not in gymnasium.registry:
            gymnasium.register(
                id=f"{NAMESPACE}/{name}",
                entry_point="jaxq.interop.gymnasium.env:PureEnv",
                vector_entry_point="jaxq.interop.gymnasium.vector:PureVectorEnv",
                reward_threshold=kind.reward_threshold,
                max_episode_steps=None if limit == NO_LIMIT else limit,
                kwargs={"world": name},
            )


def __getattr__(name: str) -> Any:
    if name in _NAMES:
        return getattr(importlib.import_module(f"{__name__}.{_NAMES[name]}"), name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")


register()
