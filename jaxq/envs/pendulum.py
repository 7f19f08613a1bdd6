"""Pendulum: a rod on a motor too weak to lift it at once must be swung up and held.

The reference for every number is Gymnasium's ``Pendulum-v1``, whose torque is any number in a range; here it is one of
a few.
"""

from __future__ import annotations

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax.typing import DTypeLike

from jaxq.elementary import sin_cos
from jaxq.envs.precision import float_dtype
from jaxq.types import Array, Env, Key, Step
from jaxq.worlds import Pendulum

_DEFAULT = Pendulum()


class PendulumParams(NamedTuple):
    """The numbers of the physics, each of which may be traced. ``worlds.Pendulum`` says what each is."""

    gravity: Array | float = _DEFAULT.gravity  # m / s^2
    mass: Array | float = _DEFAULT.mass  # kg
    length: Array | float = _DEFAULT.length  # m
    dt: Array | float = _DEFAULT.dt  # s between steps
    max_speed: Array | float = _DEFAULT.max_speed  # rad / s
    max_torque: Array | float = _DEFAULT.max_torque  # N m
    max_episode_steps: Array | int = _DEFAULT.max_episode_steps
    reset_angle: Array | float = _DEFAULT.reset_angle  # rad
    reset_speed: Array | float = _DEFAULT.reset_speed  # rad / s


_REALS = tuple(name for name in PendulumParams._fields if name != "max_episode_steps")


class PendulumState(NamedTuple):
    """The angle from upright (rad, never wrapped), its speed (rad/s), and the steps taken in this episode."""

    theta: Array
    theta_dot: Array
    t: Array


def torques(num_torques: int, max_torque: Array | float, dtype: DTypeLike = jnp.float32) -> Array:
    """The torque of each action, evenly from minus to plus ``max_torque``: u_k = max_torque (2 k / (n - 1) - 1).

    Shapes: -> [n]. Both ends are exact, and so is 0 in the middle of an odd n.
    """
    return jnp.asarray((2 * np.arange(num_torques) - (num_torques - 1)) / (num_torques - 1), dtype) * max_torque


def normalised(angle: Array) -> Array:
    """An angle in [-pi, pi): ((angle + pi) mod 2 pi) - pi. Shapes: [...] -> [...]."""
    return jnp.mod(angle + np.pi, 2 * np.pi) - np.pi


def pendulum(
    params: PendulumParams = PendulumParams(),  # noqa: B008 (a NamedTuple does not change)
    *,
    num_torques: int = _DEFAULT.num_torques,
    dtype: DTypeLike = jnp.float32,
    obs_dtype: DTypeLike = jnp.float32,
) -> Env:
    """Pendulum with the given physics; action k has the k-th of ``torques``.

    w' = clip(w + (3 g / (2 l) sin theta + 3 u / (m l^2)) dt, -max_speed, max_speed), theta' = theta + w' dt, and the
    reward is -(normalised(theta)^2 + 0.1 w^2 + 0.001 u^2) of the state that is left. Nothing terminates; an episode is
    truncated at ``max_episode_steps``.

    The state is of ``dtype``, observations ``[cos theta, sin theta, w]`` are of ``obs_dtype``. Raises ValueError for
    fewer than two torques, a dtype other than float32 or float64, or float64 without ``jax_enable_x64``.
    """
    if num_torques < 2:
        raise ValueError(f"num_torques: {num_torques} is not allowed: at least 2")
    dtype, obs_dtype = float_dtype("dtype", dtype), float_dtype("obs_dtype", obs_dtype)
    p = params._replace(**{name: jnp.asarray(getattr(params, name), dtype) for name in _REALS})
    choices = torques(num_torques, p.max_torque, dtype)
    pull, push = 3 * p.gravity / (2 * p.length), 3 / (p.mass * jnp.square(p.length))

    def reset(key: Key) -> PendulumState:
        high = jnp.stack([p.reset_angle, p.reset_speed])
        start = jax.random.uniform(key, (2,), dtype, -high, high)
        return PendulumState(start[0], start[1], jnp.zeros((), jnp.int32))

    def observe(state: PendulumState) -> Array:
        sin, cos = sin_cos(state.theta)
        return jnp.stack([cos, sin, state.theta_dot]).astype(obs_dtype)

    def step(key: Key, state: PendulumState, action: Array) -> tuple[PendulumState, Step]:
        del key
        theta, speed, t = state
        torque = choices[action]
        cost = jnp.square(normalised(theta)) + 0.1 * jnp.square(speed) + 0.001 * jnp.square(torque)
        speed = jnp.clip(speed + (pull * sin_cos(theta)[0] + push * torque) * p.dt, -p.max_speed, p.max_speed)
        after = PendulumState(theta + speed * p.dt, speed, t + 1)
        truncated = after.t >= p.max_episode_steps
        return after, Step(observe(after), -cost.astype(obs_dtype), jnp.zeros((), bool), truncated)

    return Env(reset, step, observe, num_actions=num_torques, obs_shape=(3,), deterministic=True)
