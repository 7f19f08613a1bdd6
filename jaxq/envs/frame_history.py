"""Frame history: the last few observations instead of the last one."""

from __future__ import annotations

from dataclasses import replace
from typing import Any, Literal, NamedTuple

import jax
import jax.numpy as jnp

from jaxq.envs.auto_reset import check_ends, starts
from jaxq.envs.mdp import is_whole
from jaxq.types import Array, Env, Key, Step

Padding = Literal["reset", "zero"]


class HistoryState(NamedTuple):
    """The state of what is wrapped, and its last observations, [count, ...], oldest first."""

    env: Any
    frames: Any


def frame_history(env: Env, count: int, *, padding: Padding = "reset") -> Env:
    """``env`` whose observation is its last ``count`` observations, oldest first.

    o'_t = [o_{t-count+1}, ..., o_t]; before an episode's first observation stands that one itself ("reset"), or 0
    ("zero"). An episode's last observation ends in the TRUE successor. Shapes: obs [...] -> [count, ...]. Raises
    ValueError for a count below 1 and an unknown padding. Mnih et al., *Human-level Control through Deep Reinforcement
    Learning*, 2015.

    >>> from jaxq.envs.cartpole import cartpole
    >>> frame_history(cartpole(), 4).obs_shape
    (4, 4)
    """
    check_ends(env, "frame_history")
    if not is_whole(count) or count < 1:
        raise ValueError(f"count: {count!r} is not allowed: a whole number, at least 1")
    if padding not in ("reset", "zero"):
        raise ValueError(f"padding: {padding!r} is not allowed: reset or zero")

    def begun(inner: Any) -> HistoryState:
        def frames(obs: Array) -> Array:
            before = obs if padding == "reset" else jnp.zeros_like(obs)
            return jnp.concatenate([jnp.broadcast_to(before, (count - 1, *obs.shape)), obs[None]])

        return HistoryState(inner, jax.tree.map(frames, env.observe(inner)))

    def step(key: Key, state: HistoryState, action: Array) -> tuple[HistoryState, Step]:
        inner, happened = env.step(key, state.env, action)
        frames = jax.tree.map(lambda old, new: jnp.concatenate([old[1:], new[None]]), state.frames, happened.obs)
        return HistoryState(inner, frames), happened._replace(obs=frames)

    return replace(
        env,
        **starts(env, begun),
        step=step,
        observe=lambda state: state.frames,
        obs_shape=(count, *env.obs_shape),
        num_states=None,
    )
