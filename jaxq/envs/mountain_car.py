"""Mountain car: a car too weak for the hill before it must swing up on the hill behind it.

Moore, *Efficient Memory-based Learning for Robot Control*, 1990. The reference for every number is Gymnasium's
``MountainCar-v0``.
"""

from __future__ import annotations

from typing import NamedTuple

import jax
import jax.numpy as jnp
from jax.typing import DTypeLike

from jaxq.elementary import sin_cos
from jaxq.envs.precision import float_dtype
from jaxq.types import Array, Env, Key, Step
from jaxq.worlds import MountainCar

_DEFAULT = MountainCar()


class MountainCarParams(NamedTuple):
    """The numbers of the physics, each of which may be traced. ``worlds.MountainCar`` says what each is."""

    min_position: Array | float = _DEFAULT.min_position  # m
    max_position: Array | float = _DEFAULT.max_position  # m
    max_speed: Array | float = _DEFAULT.max_speed  # m per step
    goal_position: Array | float = _DEFAULT.goal_position  # m
    goal_velocity: Array | float = _DEFAULT.goal_velocity  # m per step
    force: Array | float = _DEFAULT.force  # m per step^2
    gravity: Array | float = _DEFAULT.gravity  # m per step^2
    max_episode_steps: Array | int = _DEFAULT.max_episode_steps
    reset_low: Array | float = _DEFAULT.reset_low  # m
    reset_high: Array | float = _DEFAULT.reset_high  # m


_REALS = tuple(name for name in MountainCarParams._fields if name != "max_episode_steps")


class MountainCarState(NamedTuple):
    """Where the car is (m), its velocity (m per step), and the steps taken in this episode."""

    position: Array
    velocity: Array
    t: Array


def mountain_car(
    params: MountainCarParams = MountainCarParams(),  # noqa: B008 (a NamedTuple does not change)
    *,
    dtype: DTypeLike = jnp.float32,
    obs_dtype: DTypeLike = jnp.float32,
) -> Env:
    """Mountain car with the given physics; action 0 pushes to the left, 1 not at all, 2 to the right.

    v' = clip(v + (a - 1) force - gravity cos 3x, -max_speed, max_speed), x' = clip(x + v', min_position, max_position),
    and the wall at min_position takes the velocity. An episode terminates where x' >= goal_position and
    v' >= goal_velocity, and is truncated at ``max_episode_steps``. The reward is -1 for every step.

    The state is of ``dtype``, observations ``[position, velocity]`` are of ``obs_dtype``. Raises ValueError for a dtype
    other than float32 or float64, or float64 without ``jax_enable_x64``.
    """
    dtype, obs_dtype = float_dtype("dtype", dtype), float_dtype("obs_dtype", obs_dtype)
    p = params._replace(**{name: jnp.asarray(getattr(params, name), dtype) for name in _REALS})

    def reset(key: Key) -> MountainCarState:
        start = jax.random.uniform(key, (), dtype, p.reset_low, p.reset_high)
        return MountainCarState(start, jnp.zeros((), dtype), jnp.zeros((), jnp.int32))

    def observe(state: MountainCarState) -> Array:
        return jnp.stack([state.position, state.velocity]).astype(obs_dtype)

    def step(key: Key, state: MountainCarState, action: Array) -> tuple[MountainCarState, Step]:
        del key
        push = (jnp.asarray(action) - 1).astype(dtype) * p.force
        velocity = state.velocity + (push - sin_cos(3 * state.position)[1] * p.gravity)
        velocity = jnp.clip(velocity, -p.max_speed, p.max_speed)
        position = jnp.clip(state.position + velocity, p.min_position, p.max_position)
        velocity = jnp.where((position == p.min_position) & (velocity < 0), 0.0, velocity)
        after = MountainCarState(position, velocity, state.t + 1)
        terminated = (position >= p.goal_position) & (velocity >= p.goal_velocity)
        truncated = after.t >= p.max_episode_steps
        return after, Step(observe(after), jnp.full((), -1.0, obs_dtype), terminated, truncated)

    return Env(reset, step, observe, num_actions=3, obs_shape=(2,), deterministic=True)
