"""CartPole: a pole hinged on a cart that is pushed left or right.

Barto, Sutton and Anderson, *Neuronlike adaptive elements that can solve difficult learning control problems*, 1983;
equations of motion as corrected by Florian, 2007. The reference for every number is Gymnasium's classic ``CartPole-v1``
(``CartPoleEnv`` under ``TimeLimit``).
"""

from __future__ import annotations

from typing import NamedTuple, get_args

import jax
import jax.numpy as jnp
from jax.typing import DTypeLike

from jaxq.elementary import sin_cos
from jaxq.envs.precision import float_dtype
from jaxq.types import Array, Env, Key, Step
from jaxq.worlds import CartPole
from jaxq.worlds.classic import Integrator

_DEFAULT = CartPole()


class CartPoleParams(NamedTuple):
    """The numbers of the physics, each of which may be traced. What derives from them is computed, never stored.

    ``worlds.CartPole`` has the defaults and says what each is.
    """

    gravity: Array | float = _DEFAULT.gravity  # m / s^2
    masscart: Array | float = _DEFAULT.masscart  # kg
    masspole: Array | float = _DEFAULT.masspole  # kg
    length: Array | float = _DEFAULT.length  # m, half the pole
    force_mag: Array | float = _DEFAULT.force_mag  # N
    tau: Array | float = _DEFAULT.tau  # s between steps
    theta_threshold_radians: Array | float = _DEFAULT.theta_threshold_radians  # rad
    x_threshold: Array | float = _DEFAULT.x_threshold  # m
    max_episode_steps: Array | int = _DEFAULT.max_episode_steps
    reset_low: Array | float = _DEFAULT.reset_low  # bounds of each of the four coordinates at a reset
    reset_high: Array | float = _DEFAULT.reset_high


_REALS = tuple(name for name in CartPoleParams._fields if name != "max_episode_steps")


class CartPoleState(NamedTuple):
    """Where the cart (m, m/s) and the pole (rad, rad/s) are, and the steps taken in this episode."""

    x: Array
    x_dot: Array
    theta: Array
    theta_dot: Array
    t: Array


def cartpole(
    params: CartPoleParams = CartPoleParams(),  # noqa: B008 (a NamedTuple does not change)
    *,
    integrator: Integrator = "euler",
    sutton_barto_reward: bool = False,
    dtype: DTypeLike = jnp.float32,
    obs_dtype: DTypeLike = jnp.float32,
) -> Env:
    """CartPole with the given physics.

    Action 1 pushes with +force_mag, any other action with -force_mag. An episode terminates when the cart or the pole
    is outside its threshold and is truncated at ``max_episode_steps``. The reward is 1 for every step, the one that
    falls included (with ``sutton_barto_reward``: 0, and -1 for the one that falls); a step from outside the thresholds
    that stays outside gives 0 (-1). Termination is judged from the new state alone.

    The state is of ``dtype``, observations ``[x, x_dot, theta, theta_dot]`` are of ``obs_dtype``, as Gymnasium's
    float32 observation of a float64 state. Raises ValueError for an unknown integrator, a dtype other than
    float32 or float64, or float64 without ``jax_enable_x64``.
    """
    if integrator not in (known := get_args(Integrator)):
        raise ValueError(f"integrator: {integrator!r} is not one of {', '.join(known)}")
    dtype = float_dtype("dtype", dtype)
    obs_dtype = float_dtype("obs_dtype", obs_dtype)
    p = params._replace(**{name: jnp.asarray(getattr(params, name), dtype) for name in _REALS})
    # Everything over the total mass, so that a step divides once.
    inverse_mass = 1 / (p.masspole + p.masscart)
    pole_share = p.masspole * inverse_mass
    polemass_share = pole_share * p.length

    def reset(key: Key) -> CartPoleState:
        start = jax.random.uniform(key, (4,), dtype, p.reset_low, p.reset_high)
        return CartPoleState(start[0], start[1], start[2], start[3], jnp.zeros((), jnp.int32))

    def observe(state: CartPoleState) -> Array:
        return jnp.stack([state.x, state.x_dot, state.theta, state.theta_dot]).astype(obs_dtype)

    def outside(state: CartPoleState) -> Array:
        return (
            (state.x < -p.x_threshold)
            | (state.x > p.x_threshold)
            | (state.theta < -p.theta_threshold_radians)
            | (state.theta > p.theta_threshold_radians)
        )

    def step(key: Key, state: CartPoleState, action: Array) -> tuple[CartPoleState, Step]:
        del key
        x, x_dot, theta, theta_dot, t = state
        force = jnp.where(action == 1, p.force_mag, -p.force_mag)
        sin, cos = sin_cos(theta)
        temp = force * inverse_mass + polemass_share * jnp.square(theta_dot) * sin
        theta_acc = (p.gravity * sin - cos * temp) / (p.length * (4.0 / 3.0 - pole_share * jnp.square(cos)))
        x_acc = temp - polemass_share * theta_acc * cos
        x_dot_next = x_dot + p.tau * x_acc
        theta_dot_next = theta_dot + p.tau * theta_acc
        if integrator == "euler":
            x, theta = x + p.tau * x_dot, theta + p.tau * theta_dot
        else:
            x, theta = x + p.tau * x_dot_next, theta + p.tau * theta_dot_next
        after = CartPoleState(x, x_dot_next, theta, theta_dot_next, t + 1)
        terminated = outside(after)
        if sutton_barto_reward:
            reward = jnp.where(terminated, -1.0, 0.0)
        else:
            reward = jnp.where(terminated & outside(state), 0.0, 1.0)
        truncated = after.t >= p.max_episode_steps
        return after, Step(observe(after), reward.astype(obs_dtype), terminated, truncated)

    return Env(reset, step, observe, num_actions=2, obs_shape=(4,), deterministic=True)
