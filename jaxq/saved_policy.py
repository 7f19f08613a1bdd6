"""Policies as they are saved: weights by name with a description, played with NumPy alone.

The description of a setting is JSON in the metadata of the file that holds its weights, under ``policies`` and the
setting's index: ``{"kind": "mlp", "layers": ["params.Linear_0", ...]}``, each layer y = x W + b with W its ``.kernel``
and b its ``.bias`` and ReLU between them (with ``"num_states": n`` the first one's x is 1 at the observation's place of
n, else 0); or ``{"kind": "table", "edges": [[...], ...]}``, the row of ``table`` being
the flat index (C order) of how many edges each coordinate has reached, or the observation itself without edges.
Integers that begin elsewhere than at 0 have ``first_state`` and ``first_action`` as well. What outlives the episodes of
an environment, as running statistics do, stands beside the weights: the leaves of its state, by path after ``env``.
"""

from __future__ import annotations

import json
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from jaxq.evaluation import parted
from jaxq.presets import DQNSettings, TabularSettings
from jaxq.programs import hypers, played
from jaxq.types import PyTree

#: What the names of the environment's leaves begin with.
ENV = "env"


@dataclass(frozen=True)
class SavedPolicy:
    """One lane's final policy."""

    about: Mapping[str, Any]
    weights: Mapping[str, np.ndarray]

    def q_values(self, obs: np.ndarray) -> np.ndarray:
        """Action values of observations, as the environment gives them. Shapes: obs [n, ...] -> [n, A]."""
        obs = np.asarray(obs)
        if "first_state" in self.about:
            obs = obs.astype(int) - self.about["first_state"]
        if self.about["kind"] == "table":
            return np.asarray(self.weights["table"])[self._row(obs)]
        count = self.about.get("num_states")
        x = obs.reshape(len(obs), -1) if count is None else np.arange(count) == obs.reshape(-1, 1)
        x = x.astype(np.float32)
        for i, layer in enumerate(self.about["layers"]):
            x = np.maximum(x, 0) if i else x
            x = x @ self.weights[f"{layer}.kernel"] + self.weights[f"{layer}.bias"]
        return x

    def act(self, obs: np.ndarray) -> np.ndarray:
        """The greedy actions of observations, the first of equals. Shapes: obs [n, ...] -> [n]."""
        return self.q_values(obs).argmax(axis=1) + int(self.about.get("first_action", 0))

    def _row(self, obs: np.ndarray) -> np.ndarray:
        edges: Sequence[Sequence[float]] | None = self.about.get("edges")
        if edges is None:
            return obs.astype(int)
        obs, row = obs.reshape(len(obs), -1), np.zeros(len(obs), int)
        for i, steps in enumerate(edges):
            reached = (obs[:, i, None].astype(np.float32) >= np.asarray(steps, np.float32)).sum(axis=1)
            row = row * (len(steps) + 1) + reached
        return row


def describe(settings: Any) -> dict[str, Any] | None:
    """What a setting's policies are; None for what is no table or network."""
    if isinstance(settings, TabularSettings):
        edges = [row.tolist() for row in hypers(settings).env[1]] if _num_states(settings) is None else None
        return {"kind": "table", "edges": edges}
    if isinstance(settings, DQNSettings):
        layers = [f"params.Linear_{i}" for i in range(len(settings.hidden) + 1)]
        count = _num_states(settings)
        return {"kind": "mlp", "layers": layers} | ({} if count is None else {"num_states": count})
    return None


def _num_states(settings: Any) -> int | None:
    """How many integers the world's observations are; None for real ones."""
    return played(settings).world.num_states


def described(settings: Sequence[Any], lanes: Mapping[tuple[int, int], Mapping[str, np.ndarray]]) -> dict[str, str]:
    """The metadata of a file of policies, by (setting, seed)."""
    about = {}
    for config, _ in lanes:
        if str(config) not in about and (one := describe(settings[config])) is not None:
            about[str(config)] = one
    return {"policies": json.dumps(about)}


def load(weights: Mapping[str, np.ndarray], about: Mapping[str, str], config: int, seed: int) -> SavedPolicy:
    """The policy of a lane's weights and the metadata of their file. Raises ValueError where nothing describes it."""
    described = json.loads(about.get("policies", "{}")).get(str(config))
    if not weights or not isinstance(described, dict):
        raise ValueError(f"setting {config}, seed {seed}: no policy is saved for it")
    return SavedPolicy(described, weights)


def flatten(policy: Any, alone: str = "table") -> dict[str, np.ndarray]:
    """A tree's arrays by path, as ``params.Linear_0.kernel`` of a network; an array alone has the name ``alone``."""
    weights, state = parted(policy)
    beside = {} if state is None else _leaves(state)
    return {name or alone: array for name, array in _paths(weights)} | beside


def learnt(weights: Mapping[str, np.ndarray]) -> dict[str, np.ndarray]:
    """The weights without the environment's state that may stand beside them."""
    return {name: array for name, array in weights.items() if not name.startswith(ENV)}


def lasting_state(weights: Mapping[str, np.ndarray], like: PyTree) -> PyTree:
    """The environment's state that stands beside the weights, with the structure of ``like``; None where none does.

    Raises ValueError where the two do not fit.
    """
    if len(learnt(weights)) == len(weights):
        return None
    wanted = _leaves(like)
    found = {name: array for name, array in weights.items() if name.startswith(ENV)}
    if {n: np.shape(leaf) for n, leaf in found.items()} != {n: np.shape(leaf) for n, leaf in wanted.items()}:
        raise ValueError("env: is not that of this run: its state has other parts")
    return jax.tree.unflatten(jax.tree.structure(like), [jnp.asarray(found[name]) for name in wanted])


def _leaves(state: PyTree) -> dict[str, Any]:
    return {ENV + jax.tree_util.keystr(path): leaf for path, leaf in jax.tree_util.tree_leaves_with_path(state)}


def _paths(tree: Any) -> Iterable[tuple[str, np.ndarray]]:
    branches: Iterable[tuple[Any, Any]] | None = tree.items() if isinstance(tree, dict) else None
    if isinstance(tree, (list, tuple)):
        named = getattr(tree, "_fields", None) or map(str, range(len(tree)))
        branches = zip(named, tree, strict=True)
    if branches is None:
        yield "", np.asarray(tree)
        return
    for name, branch in branches:
        for rest, array in _paths(branch):
            yield f"{name}.{rest}" if rest else str(name), array
