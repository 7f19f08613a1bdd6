"""Evaluation: whole episodes under a greedy policy."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp

from jaxq import policies
from jaxq.envs.auto_reset import next_episode
from jaxq.types import Array, Env, Key


class Lasting(NamedTuple):
    """A policy and what it needs of the environment it was trained in: a state, which ``Env.restart`` goes on from."""

    policy: Any
    env: Any


def lasting(env: Env, policy: Any, state: Any) -> Any:
    """``policy`` with the environment's ``state`` beside it where something of that outlives an episode, else alone."""
    return policy if env.restart is None else Lasting(policy, state)


def parted(policy: Any) -> tuple[Any, Any]:
    """The policy alone, and the environment's state beside it, or None; see ``lasting``."""
    return (policy.policy, policy.env) if isinstance(policy, Lasting) else (policy, None)


def begin(env: Env, key: Key, state: Any = None) -> Any:
    """A state in which an episode begins: after one that ended in ``state``, or with nothing before it. The key is
    consumed.
    """
    return env.reset(key) if state is None else next_episode(env, key, state)


def greedy_returns(
    key: Key, env: Env, q_values: Callable[[Any], Array], episodes: int, max_steps: int, state: Any = None
) -> Array:
    """Returns of whole episodes under the greedy policy, each from its own start and at most ``max_steps`` long.

    Shapes: -> [episodes] float32. The start states depend on the key alone, so settings that share a key are compared
    on the same ones. With a ``state`` of the environment each goes on from what outlives an episode in that.
    """

    def one(key: Key) -> Array:
        reset_key, step_key = jax.random.split(key)

        def goes_on(carry: tuple[Any, Array, Array, Array]) -> Array:
            return (carry[2] > 0) & (carry[3] < max_steps)

        def body(carry: tuple[Any, Array, Array, Array]) -> tuple[Any, Array, Array, Array]:
            state, total, going, t = carry
            action = policies.greedy(q_values(env.observe(state)))
            state, happened = env.step(jax.random.fold_in(step_key, t), state, action)
            total = total + happened.reward.astype(jnp.float32)
            return state, total, going * ~(happened.terminated | happened.truncated), t + 1

        total, going, t = jnp.zeros((), jnp.float32), jnp.ones((), jnp.float32), jnp.zeros((), jnp.int32)
        return jax.lax.while_loop(goes_on, body, (begin(env, reset_key, state), total, going, t))[1]

    return jax.vmap(one)(jax.random.split(key, episodes))
