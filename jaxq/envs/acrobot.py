"""Acrobot: two links like a gymnast on a bar, driven at the hip alone, must swing their feet above a line.

Sutton, *Generalization in Reinforcement Learning: Successful Examples Using Sparse Coarse Coding*, 1996; Sutton and
Barto, 2018, example 11.3 of the first edition. The reference for every number is Gymnasium's ``Acrobot-v1``.
"""

from __future__ import annotations

from typing import NamedTuple, get_args

import jax
import jax.numpy as jnp
import numpy as np
from jax.typing import DTypeLike

from jaxq.elementary import sin_cos
from jaxq.envs.precision import float_dtype
from jaxq.types import Array, Env, Key, Step
from jaxq.worlds import Acrobot
from jaxq.worlds.classic import Dynamics

_DEFAULT = Acrobot()


class AcrobotParams(NamedTuple):
    """The numbers of the physics, each of which may be traced. ``worlds.Acrobot`` says what each is."""

    gravity: Array | float = _DEFAULT.gravity  # m / s^2
    link_length_1: Array | float = _DEFAULT.link_length_1  # m
    link_mass_1: Array | float = _DEFAULT.link_mass_1  # kg
    link_mass_2: Array | float = _DEFAULT.link_mass_2  # kg
    link_com_pos_1: Array | float = _DEFAULT.link_com_pos_1  # m
    link_com_pos_2: Array | float = _DEFAULT.link_com_pos_2  # m
    link_moi: Array | float = _DEFAULT.link_moi  # kg m^2
    torque: Array | float = _DEFAULT.torque  # N m
    torque_noise_max: Array | float = _DEFAULT.torque_noise_max  # N m
    max_vel_1: Array | float = _DEFAULT.max_vel_1  # rad / s
    max_vel_2: Array | float = _DEFAULT.max_vel_2  # rad / s
    dt: Array | float = _DEFAULT.dt  # s between steps
    max_episode_steps: Array | int = _DEFAULT.max_episode_steps
    reset_low: Array | float = _DEFAULT.reset_low  # bounds of each of the four coordinates at a reset
    reset_high: Array | float = _DEFAULT.reset_high


_REALS = tuple(name for name in AcrobotParams._fields if name != "max_episode_steps")


class AcrobotState(NamedTuple):
    """The angles of the first link from hanging down and of the second from the first (rad, in [-pi, pi]), their speeds
    (rad/s), and the steps taken in this episode."""

    theta1: Array
    theta2: Array
    theta1_dot: Array
    theta2_dot: Array
    t: Array


def wrapped(angle: Array) -> Array:
    """An angle in [-pi, pi], as it is where it lies there already. Shapes: [...] -> [...]."""
    turns = jnp.ceil((jnp.abs(angle) - np.pi) / (2 * np.pi))
    return angle - jnp.sign(angle) * jnp.maximum(turns, 0) * (2 * np.pi)


def acrobot(
    params: AcrobotParams = AcrobotParams(),  # noqa: B008 (a NamedTuple does not change)
    *,
    dynamics: Dynamics = "book",
    dtype: DTypeLike = jnp.float32,
    obs_dtype: DTypeLike = jnp.float32,
) -> Env:
    """Acrobot with the given physics; actions 0, 1 and 2 have the torques -torque, 0 and torque, plus uniform noise of
    size up to ``torque_noise_max``.

    One step of Runge and Kutta's fourth order over ``dt``, then angles are wrapped and speeds clipped. With
    d1 = m1 c1^2 + m2 (l1^2 + c2^2 + 2 l1 c2 cos th2) + 2 I, d2 = m2 (c2^2 + l1 c2 cos th2) + I,
    phi2 = m2 c2 g sin(th1 + th2), phi1 = -m2 l1 c2 w2 (w2 + 2 w1) sin th2 + (m1 c1 + m2 l1) g sin th1 + phi2:

        w2' = (u + d2 / d1 phi1 - m2 l1 c2 w1^2 sin th2 - phi2) / (m2 c2^2 + I - d2^2 / d1),
        w1' = -(d2 w2' + phi1) / d1,

    of which "nips" leaves out the term in w1^2. An episode terminates where -cos th1 - cos(th1 + th2) > 1 and is
    truncated at ``max_episode_steps``. The reward is -1 for every step but the one that terminates, which has 0.

    The state is of ``dtype``, observations ``[cos th1, sin th1, cos th2, sin th2, w1, w2]`` are of ``obs_dtype``.
    Raises ValueError for unknown dynamics, a dtype other than float32 or float64, or float64 without
    ``jax_enable_x64``.
    """
    if dynamics not in (known := get_args(Dynamics)):
        raise ValueError(f"dynamics: {dynamics!r} is not one of {', '.join(known)}")
    dtype, obs_dtype = float_dtype("dtype", dtype), float_dtype("obs_dtype", obs_dtype)
    p = params._replace(**{name: jnp.asarray(getattr(params, name), dtype) for name in _REALS})
    m2, l1, c2, moi = p.link_mass_2, p.link_length_1, p.link_com_pos_2, p.link_moi
    still = p.link_mass_1 * jnp.square(p.link_com_pos_1) + m2 * (jnp.square(l1) + jnp.square(c2)) + 2 * moi
    second = m2 * jnp.square(c2) + moi
    coupling = m2 * l1 * c2
    weight1, weight2 = (p.link_mass_1 * p.link_com_pos_1 + m2 * l1) * p.gravity, m2 * c2 * p.gravity

    def slope(y: Array, torque: Array) -> Array:
        """Time derivative of [th1, th2, w1, w2]."""
        w1, w2 = y[2], y[3]
        (sin, cos), (sin1, sin12) = sin_cos(y[1]), sin_cos(jnp.stack([y[0], y[0] + y[1]]))[0]
        d1, d2 = still + 2 * coupling * cos, second + coupling * cos
        phi2 = weight2 * sin12
        phi1 = -coupling * w2 * (w2 + 2 * w1) * sin + weight1 * sin1 + phi2
        centrifugal = coupling * jnp.square(w1) * sin if dynamics == "book" else 0.0
        a2 = (torque + d2 / d1 * phi1 - centrifugal - phi2) / (second - jnp.square(d2) / d1)
        return jnp.stack([w1, w2, -(d2 * a2 + phi1) / d1, a2])

    def reset(key: Key) -> AcrobotState:
        start = jax.random.uniform(key, (4,), dtype, p.reset_low, p.reset_high)
        return AcrobotState(start[0], start[1], start[2], start[3], jnp.zeros((), jnp.int32))

    def observe(state: AcrobotState) -> Array:
        sin, cos = sin_cos(jnp.stack([state.theta1, state.theta2]))
        return jnp.stack([cos[0], sin[0], cos[1], sin[1], state.theta1_dot, state.theta2_dot]).astype(obs_dtype)

    def step(key: Key, state: AcrobotState, action: Array) -> tuple[AcrobotState, Step]:
        noise = jax.random.uniform(key, (), dtype, -1, 1) * p.torque_noise_max
        torque = (jnp.asarray(action) - 1).astype(dtype) * p.torque + noise
        y = jnp.stack(state[:4])
        k1 = slope(y, torque)
        k2 = slope(y + p.dt / 2 * k1, torque)
        k3 = slope(y + p.dt / 2 * k2, torque)
        k4 = slope(y + p.dt * k3, torque)
        y = y + p.dt / 6 * (k1 + 2 * k2 + 2 * k3 + k4)
        angles = wrapped(y[:2])
        after = AcrobotState(
            angles[0],
            angles[1],
            jnp.clip(y[2], -p.max_vel_1, p.max_vel_1),
            jnp.clip(y[3], -p.max_vel_2, p.max_vel_2),
            state.t + 1,
        )
        cos = sin_cos(jnp.stack([angles[0], angles[0] + angles[1]]))[1]
        terminated = -cos[0] - cos[1] > 1
        truncated = after.t >= p.max_episode_steps
        reward = jnp.where(terminated, 0.0, -1.0).astype(obs_dtype)
        return after, Step(observe(after), reward, terminated, truncated)

    return Env(reset, step, observe, num_actions=3, obs_shape=(6,))
