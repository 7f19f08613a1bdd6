"""The tutorial's DQN as one would write it in plain JAX: flax, optax, ``jax.random`` and one ``jit(vmap(scan))``.

The peer that the engine is measured against. It shares no code with the package. Where plain JAX leaves a choice it
takes the faster one: a minibatch is drawn with replacement.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import flax.linen as nn
import jax
import jax.numpy as jnp
import optax

BATCH, CAPACITY, GAMMA, TAU = 128, 10_000, 0.99, 0.005


class QNetwork(nn.Module):
    """4-128-128-2."""

    @nn.compact
    def __call__(self, x: jax.Array) -> jax.Array:
        x = nn.relu(nn.Dense(128)(x))
        x = nn.relu(nn.Dense(128)(x))
        return nn.Dense(2)(x)


NETWORK = QNetwork()
OPTIMISER = optax.chain(
    optax.clip(100.0), optax.scale_by_amsgrad(), optax.add_decayed_weights(0.01), optax.scale(-1e-4)
)


class Train(NamedTuple):
    """One training between two steps."""

    params: Any
    target: Any
    optimiser: Any
    obs: jax.Array
    time: jax.Array  # steps of the episode under way
    buffer: dict[str, jax.Array]
    steps: jax.Array
    key: jax.Array


def reset(key: jax.Array) -> jax.Array:
    return jax.random.uniform(key, (4,), minval=-0.05, maxval=0.05)


def cartpole_step(obs: jax.Array, action: jax.Array) -> tuple[jax.Array, jax.Array]:
    """The next observation, and whether the pole fell."""
    _, x_dot, theta, theta_dot = obs
    force = jnp.where(action == 1, 10.0, -10.0)
    cos, sin = jnp.cos(theta), jnp.sin(theta)
    temp = (force + 0.05 * theta_dot**2 * sin) / 1.1
    theta_acc = (9.8 * sin - cos * temp) / (0.5 * (4 / 3 - 0.1 * cos**2 / 1.1))
    x_acc = temp - 0.05 * theta_acc * cos / 1.1
    new = obs + 0.02 * jnp.stack([x_dot, x_acc, theta_dot, theta_acc])
    return new, (jnp.abs(new[0]) > 2.4) | (jnp.abs(new[2]) > 12 * jnp.pi / 180)


def init(key: jax.Array) -> Train:
    key, net_key, env_key = jax.random.split(key, 3)
    params = NETWORK.init(net_key, jnp.zeros(4))
    buffer = {
        "obs": jnp.zeros((CAPACITY, 4)),
        "action": jnp.zeros(CAPACITY, jnp.int32),
        "reward": jnp.zeros(CAPACITY),
        "fell": jnp.zeros(CAPACITY),
        "next_obs": jnp.zeros((CAPACITY, 4)),
    }
    zero = jnp.zeros((), jnp.int32)
    return Train(params, params, OPTIMISER.init(params), reset(env_key), zero, buffer, zero, key)


def step(state: Train, _: None) -> tuple[Train, jax.Array]:
    """One environment step and one update; returns whether an episode ended."""
    key, *keys = jax.random.split(state.key, 5)
    epsilon = 0.05 + 0.85 * jnp.exp(-state.steps / 1000)
    greedy = jnp.argmax(NETWORK.apply(state.params, state.obs))
    action = jnp.where(jax.random.uniform(keys[0]) < epsilon, jax.random.randint(keys[1], (), 0, 2), greedy)
    new, fell = cartpole_step(state.obs, action)
    over = fell | (state.time >= 499)

    row = {"obs": state.obs, "action": action, "reward": 1.0, "fell": fell.astype(float), "next_obs": new}
    position = state.steps % CAPACITY
    buffer = {name: values.at[position].set(row[name]) for name, values in state.buffer.items()}
    rows = jax.random.randint(keys[2], (BATCH,), 0, jnp.minimum(state.steps + 1, CAPACITY))
    batch = {name: values[rows] for name, values in buffer.items()}

    def loss(params: Any) -> jax.Array:
        chosen = jnp.take_along_axis(NETWORK.apply(params, batch["obs"]), batch["action"][:, None], 1)[:, 0]
        following = NETWORK.apply(state.target, batch["next_obs"]).max(1)
        return optax.huber_loss(chosen, batch["reward"] + GAMMA * (1 - batch["fell"]) * following).mean()

    changes, optimiser = OPTIMISER.update(jax.grad(loss)(state.params), state.optimiser, state.params)
    params = optax.apply_updates(state.params, changes)
    target = optax.incremental_update(params, state.target, TAU)
    obs = jnp.where(over, reset(keys[3]), new)
    time = jnp.where(over, 0, state.time + 1)
    return Train(params, target, optimiser, obs, time, buffer, state.steps + 1, key), over


def segment(state: Train, updates: int) -> tuple[Train, jax.Array]:
    """``updates`` steps of one training, and where its episodes ended."""
    return jax.lax.scan(step, state, length=updates)


PACKAGES = ("jax", "jaxlib", "flax", "optax")
UPDATES = 256


def prepare(case: str) -> Callable[[], float]:
    """``case`` trainings in one ``vmap``, compiled once. Units: updates."""
    count = int(case)
    advance = jax.jit(jax.vmap(lambda state: segment(state, UPDATES)), donate_argnums=0)
    held = [jax.jit(jax.vmap(init))(jax.random.split(jax.random.key(0), count))]

    def bout() -> float:
        held[0], _ = jax.block_until_ready(advance(held[0]))
        return float(count * UPDATES)

    return bout
