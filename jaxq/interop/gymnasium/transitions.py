"""True transitions of a Gymnasium vector environment, whichever way it begins its next episodes."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from gymnasium.vector import AutoresetMode

from jaxq.interop.gymnasium.foreign import Foreign


class Row(NamedTuple):
    """One transition of each of N environments. ``obs_t`` is the true successor, also where an episode ended."""

    obs_tm1: np.ndarray  # [N, ...]
    a_tm1: np.ndarray  # [N] int32, from 0
    r_t: np.ndarray  # [N] float32
    continues_t: np.ndarray  # [N] float32, 0 after a termination
    obs_t: np.ndarray  # [N, ...]
    cut_t: np.ndarray  # [N] bool
    length: np.ndarray  # [N] int32 steps of the episode up to here
    total: np.ndarray  # [N] float32, its return up to here


class Transitions:
    """Takes actions in N environments and gives what came of it, N transitions at a time.

    ``obs`` [N, ...] is what to act on next. Where an environment resets in the step after an episode's end, that step
    is nobody's transition; those of the others wait until there are N. ``finished`` are the episodes that ended in the
    last step, as environment, length and return.

    Raises ValueError for a vector environment that does not say how it begins the next episode.
    """

    def __init__(self, of: Foreign):
        self.of, self.envs = of, of.envs
        given = self.envs.metadata.get("autoreset_mode")
        if given is None:
            raise ValueError(f"env: {type(self.envs).__name__} says no autoreset_mode in its metadata")
        self.mode = AutoresetMode(given)
        self.obs: Any = None
        self._nothing()

    def _nothing(self) -> None:
        count = self.envs.num_envs
        self.waiting: list[Row] = []  # of one environment each
        self.over = np.zeros(count, bool)  # of NEXT_STEP: the next step is a reset
        self.length, self.total = np.zeros(count, np.int32), np.zeros(count, np.float32)
        self.finished: list[tuple[int, int, float]] = []

    def begin(self, seed: int) -> None:
        """Begins an episode in every environment; environment i has the seed ``seed`` + i, as Gymnasium gives it."""
        self._nothing()
        obs, _ = self.envs.reset(seed=seed)
        self.obs = self._kept(obs)

    @property
    def resetting(self) -> bool:
        """Whether the next step is nobody's transition, whatever the actions."""
        return bool(self.over.all())

    def take(self, actions: np.ndarray) -> Row | None:
        """One step of all environments; None where fewer than N transitions are there. Shapes: actions [N]."""
        begun = ~self.over
        obs, rewards, terminated, truncated, infos = self.envs.step(actions.astype(np.int64) + self.of.first_action)
        obs, over = self._kept(obs), np.logical_or(terminated, truncated) & begun
        reward = np.asarray(rewards, np.float32)
        length, total = self.length + 1, self.total + reward
        before, reached, self.obs = self.obs, obs, obs
        if self.mode is AutoresetMode.SAME_STEP and over.any():
            reached = obs.copy()
            for i in np.flatnonzero(over).tolist():
                reached[i] = self.of.observe(np.asarray(infos["final_obs"][i])[None])[0]
        elif self.mode is AutoresetMode.DISABLED and over.any():
            fresh, _ = self.envs.reset(options={"reset_mask": over})
            self.obs = obs.copy()
            self.obs[over] = self._kept(fresh)[over]
        continues = 1.0 - np.asarray(terminated, np.float32)
        row = Row(before, actions.astype(np.int32), reward, continues, reached, over, length, total)
        self.finished = [(i, int(length[i]), float(total[i])) for i in np.flatnonzero(over).tolist()]
        ended = over | ~begun
        self.length, self.total = np.where(ended, 0, length), np.where(ended, np.float32(0), total)
        if self.mode is not AutoresetMode.NEXT_STEP:
            return row
        self.over = over
        if begun.all() and not self.waiting:
            return row
        self.waiting += [_one(row, i) for i in np.flatnonzero(begun).tolist()]
        if len(self.waiting) < len(begun):
            return None
        full, self.waiting = self.waiting[: len(begun)], self.waiting[len(begun) :]
        return Row(*(np.concatenate(leaves) for leaves in zip(*full, strict=True)))

    def _kept(self, obs: Any) -> np.ndarray:
        """As the learner sees them, and no view of what the environment will write into."""
        return np.array(self.of.observe(obs))


def _one(row: Row, i: int) -> Row:
    return Row(*(leaf[i : i + 1] for leaf in row))
