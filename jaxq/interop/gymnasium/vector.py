"""Many environments of a world at once, as a Gymnasium vector environment."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import gymnasium
import numpy as np
from gymnasium import spaces
from gymnasium.utils import seeding
from gymnasium.vector import AutoresetMode, VectorEnv

from jaxq.interop.gymnasium.compiled import Compiled, compiled, drawn, made, numbers
from jaxq.interop.gymnasium.env import RENDER_MODES, Chosen, checked_mode, metadata, settled
from jaxq.interop.gymnasium.spaces import batched, begun_with, observation_space

Seeds = int | Sequence[int | None] | None


class PureVectorEnv(VectorEnv):
    """A world as ``gymnasium.vector.VectorEnv``, all environments in one compiled step:
    ``gymnasium.make_vec("jaxq/CartPole-v1", num_envs=8, autoreset_mode="SameStep")``.

    Environment i under ``reset(seed=s)`` has the episodes of one environment alone under seed s + i. All three modes of
    auto-reset: in the next step, in the same one (the true successor is ``infos["final_obs"]``), or by the caller's
    ``reset(options={"reset_mask": ...})``. Keyword arguments are the world's numbers and options. Raises ValueError as
    ``PureEnv``, and for less than one environment.
    """

    metadata: dict[str, Any] = {"render_modes": list(RENDER_MODES)}  # noqa: RUF012

    def __init__(
        self,
        num_envs: int = 1,
        world: Chosen = "CartPole-v1",
        render_mode: str | None = None,
        autoreset_mode: str | AutoresetMode = AutoresetMode.NEXT_STEP,
        **settings: Any,
    ) -> None:
        if isinstance(num_envs, bool) or not isinstance(num_envs, int | np.integer) or num_envs < 1:
            raise ValueError(f"num_envs: {num_envs!r} is not allowed: a whole number, at least 1")
        self.world = settled(world, settings)
        self.num_envs = int(num_envs)
        modes = [mode.value for mode in AutoresetMode]
        if autoreset_mode not in (*modes, *AutoresetMode):
            raise ValueError(f"autoreset_mode: {autoreset_mode!r} is not allowed: one of {', '.join(modes)}")
        self.autoreset_mode = AutoresetMode(autoreset_mode)
        self.metadata = {**metadata(self.world), "autoreset_mode": self.autoreset_mode}
        self.render_mode = checked_mode(render_mode)
        env = made(self.world)
        self.single_action_space = spaces.Discrete(env.num_actions)
        self.single_observation_space = observation_space(self.world, env)
        self.action_space = batched(self.single_action_space, self.num_envs)
        self.observation_space = batched(self.single_observation_space, self.num_envs)
        self._dtype = np.int64 if env.num_states is not None else np.float32
        self._numbers = numbers(self.world)
        self._pure: Compiled | None = compiled(self.world, many=True)
        drawn_seeds = [seeding.np_random() for _ in range(self.num_envs)]
        self._generators: list[np.random.Generator] = [generator for generator, _ in drawn_seeds]
        self._seeds_of: list[int] = [seed for _, seed in drawn_seeds]
        self._of: Any = np.array([drawn(generator) for generator in self._generators])
        self._episode: Any = np.zeros(self.num_envs, np.uint32)
        self._over = np.zeros(self.num_envs, bool)
        self.state: Any = None
        self._obs: Any = None

    def reset(self, *, seed: Any = None, options: dict[str, Any] | None = None) -> tuple[np.ndarray, dict[str, Any]]:
        """Begins episodes in all environments, or in those of ``options["reset_mask"]``."""
        seeds = self._seeds(seed)
        options = dict(options or {})
        chosen = self._mask(options.pop("reset_mask")) if "reset_mask" in options else np.ones(self.num_envs, bool)
        begun = numbers(begun_with(self.world, options)) if options else self._numbers
        if self.state is None and not chosen.all():
            raise gymnasium.error.ResetNeeded("the first reset must begin all environments")
        of, episode = np.array(self._of), np.array(self._episode)
        for i in np.flatnonzero(chosen).tolist():
            if seeds[i] is not None:
                self._generators[i], self._seeds_of[i] = seeding.np_random(seeds[i])
                of[i], episode[i] = drawn(self._generators[i]), np.uint32(2**32 - 1)  # the next one is 0
        self._of = of
        if self.state is None:
            self._episode = np.where([one is None for one in seeds], episode, 0).astype(np.uint32)
            self.state, self._obs = self._functions.begin(of, self._episode, begun)
        else:
            self._episode, self.state, self._obs = self._functions.renew(
                chosen, of, episode, self.state, self._obs, begun
            )
        self._over &= ~chosen
        return self._seen(), {}

    def step(self, actions: Any) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray, dict[str, Any]]:
        """Takes an action in each environment."""
        if self.state is None:
            raise gymnasium.error.ResetNeeded("Cannot call env.step() before calling env.reset()")
        actions = np.asarray(actions)
        if not self.action_space.contains(actions.astype(np.int64) if actions.dtype.kind in "iu" else actions):
            raise gymnasium.error.InvalidAction(f"actions: {actions!r} is not allowed: {self.action_space}")
        waiting = self._over.copy()
        if self.autoreset_mode is AutoresetMode.DISABLED and waiting.any():
            raise gymnasium.error.ResetNeeded(f"environments {np.flatnonzero(waiting).tolist()} need a reset")
        self.state, self._obs, told = self._functions.step(
            self._of, self._episode, self.state, actions.astype(np.int32), self._numbers
        )
        told = np.asarray(told)
        rewards, terminated, truncated = told[:, 0].astype(np.float64), told[:, 1] > 0, told[:, 2] > 0
        if waiting.any():  # of NEXT_STEP: this step is their reset
            self._renew(waiting)
            rewards[waiting], terminated[waiting], truncated[waiting] = 0.0, False, False
        self._over = terminated | truncated
        infos: dict[str, Any] = {}
        if self.autoreset_mode is AutoresetMode.SAME_STEP and self._over.any():
            last = self._seen()
            for i in np.flatnonzero(self._over).tolist():
                final = int(last[i]) if self._dtype is np.int64 else last[i].copy()
                infos = self._add_info(infos, {"final_obs": final, "final_info": {}}, i)
            self._renew(self._over)
            self._over = np.zeros(self.num_envs, bool)
        return self._seen(), rewards, terminated, truncated, infos

    def render(self) -> tuple[np.ndarray, ...] | None:
        """The picture of each environment's state."""
        if self.render_mode is None:
            gymnasium.logger.warn('render needs gymnasium.make_vec(..., render_mode="rgb_array")')
            return None
        if self.state is None:
            raise gymnasium.error.ResetNeeded("Cannot call env.render() before calling env.reset()")
        from jaxq import frames

        states = [np.asarray(leaf) for leaf in self.state]
        return tuple(
            frames.draw(self.world, type(self.state)(*(leaf[i] for leaf in states))) for i in range(self.num_envs)
        )

    @property
    def np_random(self) -> Any:
        """The generators of the environments."""
        return tuple(self._generators)

    @property
    def np_random_seed(self) -> Any:
        """The seeds of the environments."""
        return tuple(self._seeds_of)

    @property
    def _functions(self) -> Compiled:
        if self._pure is None:
            self._pure = compiled(self.world, many=True)
        return self._pure

    def _renew(self, over: np.ndarray) -> None:
        self._episode, self.state, self._obs = self._functions.renew(
            over, self._of, self._episode, self.state, self._obs, self._numbers
        )

    def _seen(self) -> np.ndarray:
        return np.array(self._obs, self._dtype)

    def _seeds(self, seed: Seeds) -> list[int | None]:
        if seed is None:
            return [None] * self.num_envs
        if isinstance(seed, int | np.integer):
            return [int(seed) + i for i in range(self.num_envs)]
        if len(seed) != self.num_envs:
            raise ValueError(f"seed: {len(seed)} of them are not allowed: {self.num_envs}, one for each environment")
        return list(seed)

    def _mask(self, mask: Any) -> np.ndarray:
        if not isinstance(mask, np.ndarray) or mask.dtype != np.bool_:
            raise TypeError(f"reset_mask: {mask!r} is not allowed: a NumPy array of bool")
        if mask.shape != (self.num_envs,) or not mask.any():
            raise ValueError(f"reset_mask: {mask.tolist()} is not allowed: {self.num_envs} values, one of them True")
        return mask

    def __getstate__(self) -> dict[str, Any]:
        import jax

        names = ("state", "_obs", "_of", "_episode", "_numbers")
        return {**self.__dict__, "_pure": None, **jax.tree.map(np.asarray, {n: getattr(self, n) for n in names})}
