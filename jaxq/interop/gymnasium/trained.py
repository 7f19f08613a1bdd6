"""What a training in a Gymnasium environment comes to, and its policy as a file."""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import safetensors
import safetensors.numpy

from jaxq import saved_policy
from jaxq.presets import Training
from jaxq.saved_policy import SavedPolicy
from jaxq.tally import Episodes


@dataclass(frozen=True)
class Trained:
    """A training in a Gymnasium environment.

    ``status`` is "solved", "finished", "diverged", or "interrupted" by Ctrl-C. ``loss`` and ``max_q`` have a value per
    update. ``eval_returns`` are those of greedy episodes in the end, None where it diverged or Ctrl-C came before;
    ``policy`` takes the environment's observations and gives its actions;
    ``curve`` [2, E] are env steps and mean greedy returns on the way, at least ``eval_every`` steps apart.
    """

    status: str
    env_steps: int
    episodes: Episodes
    loss: np.ndarray
    max_q: np.ndarray
    eval_returns: np.ndarray | None
    curve: np.ndarray
    policy: SavedPolicy
    settings: Training

    @property
    def updates(self) -> int:
        """How many there were."""
        return len(self.loss)

    def save(self, path: str | Path) -> None:
        """Writes the policy to a file that ``load`` reads."""
        about = {"policies": json.dumps({"0": self.policy.about})}
        safetensors.numpy.save_file(dict(self.policy.weights), path, metadata=about)


def load(path: str | Path) -> SavedPolicy:
    """The policy of a file that ``Trained.save`` wrote: ``load(path).act(obs)`` are the greedy actions of ``obs``
    [n, ...]. Raises ValueError for any other file."""
    try:
        with safetensors.safe_open(path, "numpy") as file:
            names, about = file.keys(), file.metadata() or {}
            return saved_policy.load({name: file.get_tensor(name) for name in names}, about, 0, 0)
    except FileNotFoundError:
        raise
    except (safetensors.SafetensorError, OSError, ValueError, AttributeError) as error:
        raise ValueError(f"{path}: holds no policy: {error}") from None
