"""Auto-reset: an episode that ended gives way to a new one within the same step."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import jax
import jax.numpy as jnp

from jaxq.types import Array, Env, Key, Step


def auto_reset(env: Env) -> Env:
    """``env`` with the state after an episode's end replaced by a fresh one.

    The Step keeps the TRUE successor of the action; the state returned beside it, and ``observe`` of it, belong to the
    new episode where ``terminated | truncated``. What outlives an episode, as running statistics, is kept. It goes
    around all other wrappers: one around it would not see that an episode ended. Raises ValueError for an environment
    that resets already.
    """
    check_ends(env, "auto_reset")

    def step(key: Key, state: Any, action: Array) -> tuple[Any, Step]:
        step_key, reset_key = (key, key) if env.deterministic else jax.random.split(key)
        after, happened = env.step(step_key, state, action)
        over = happened.terminated | happened.truncated
        fresh = next_episode(env, reset_key, after)
        return jax.tree.map(lambda new, old: jnp.where(over, new, old), fresh, after), happened

    return replace(env, step=step, deterministic=False, resets=True)


def check_ends(env: Env, wrapper: str) -> None:
    """Raises ValueError for an environment whose episodes begin anew by themselves, which a wrapper would not see."""
    if env.resets:
        why = "" if wrapper == "auto_reset" else f": auto_reset goes around {wrapper}"
        raise ValueError(f"env: one that resets by itself is not allowed{why}")


def starts(env: Env, begun: Callable[[Any], Any]) -> dict[str, Any]:
    """``reset`` and ``restart`` of a wrapper whose state is ``begun(inner)`` where an episode begins."""
    restart = None if env.restart is None else lambda key, state: begun(next_episode(env, key, state.env))
    return {"reset": lambda key: begun(env.reset(key)), "restart": restart}


def next_episode(env: Env, key: Key, state: Any) -> Any:
    """The state in which the episode after that of ``state`` begins; the key is consumed."""
    return env.reset(key) if env.restart is None else env.restart(key, state)
