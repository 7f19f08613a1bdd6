"""A rule in a training step of flax and optax: double Q-learning on transitions of Gymnasium's CartPole.

The network, the optimiser and the batches are the caller's; the error and the target network are two lines of jaxq.

python docs/examples/flax_step.py
"""

from typing import NamedTuple

import flax.linen as nn
import gymnasium
import jax
import jax.numpy as jnp
import numpy as np
import optax

from jaxq import rules

GAMMA, TAU = 0.8, 0.05


class Batch(NamedTuple):
    """Shapes: obs_tm1, obs_t [B, 4], the rest [B]."""

    obs_tm1: np.ndarray
    a_tm1: np.ndarray
    r_t: np.ndarray
    discount_t: np.ndarray
    obs_t: np.ndarray


network = nn.Sequential([nn.Dense(64), nn.relu, nn.Dense(64), nn.relu, nn.Dense(2)])  # [B, 4] -> [B, 2]
optimiser = optax.adam(3e-3)


def loss_of(params, target_params, batch: Batch):
    q_tm1, selector = network.apply(params, batch.obs_tm1), network.apply(params, batch.obs_t)
    q_t = network.apply(target_params, batch.obs_t)
    # One transition in, one error out; vmap adds the batch. The online network selects the action, the target network
    # says what it is worth. No stop_gradient here: the rule lets a gradient flow through q_tm1 alone.
    delta = jax.vmap(rules.double_q_learning)(q_tm1, batch.a_tm1, batch.r_t, batch.discount_t, q_t, selector)
    return 0.5 * jnp.mean(delta**2)


@jax.jit
def train_step(params, target_params, opt_state, batch: Batch):
    loss, grads = jax.value_and_grad(loss_of)(params, target_params, batch)
    updates, opt_state = optimiser.update(grads, opt_state)
    params = optax.apply_updates(params, updates)
    return params, rules.polyak_update(params, target_params, TAU), opt_state, loss


def cartpole_transitions(count: int, rng: np.random.Generator) -> Batch:
    """So many transitions of a random policy."""
    env = gymnasium.make("CartPole-v1")
    obs, _ = env.reset(seed=0)
    rows = []
    for _ in range(count):
        a = int(rng.integers(2))
        obs_t, r_t, terminated, truncated, _ = env.step(a)
        rows.append((obs, a, r_t, GAMMA * (not terminated), obs_t))  # a truncation bootstraps from obs_t
        obs = env.reset()[0] if terminated or truncated else obs_t
    obs_tm1, a_tm1, r_t, discount_t, obs_t = (np.array(column) for column in zip(*rows, strict=True))
    return Batch(obs_tm1, a_tm1, r_t.astype(np.float32), discount_t.astype(np.float32), obs_t)


def main():
    rng = np.random.default_rng(0)
    data = cartpole_transitions(2000, rng)
    params = network.init(jax.random.key(0), data.obs_tm1)
    target_params, opt_state = params, optimiser.init(params)
    losses = []
    for _ in range(2000):
        rows = rng.integers(len(data.r_t), size=64)
        batch = Batch(*(column[rows] for column in data))
        params, target_params, opt_state, loss = train_step(params, target_params, opt_state, batch)
        losses.append(float(loss))
    for first in range(0, 2000, 400):
        print(f"updates {first + 1:4d} to {first + 400:4d}: mean loss {np.mean(losses[first : first + 400]):.4f}")
    norms = [optax.tree.norm(grads) for grads in jax.jit(jax.grad(loss_of, (0, 1)))(params, target_params, batch)]
    print(f"norm of the gradient: {norms[0]:.2f} for the online network, {norms[1]:.2f} for the target network")
    return params, target_params, opt_state, batch, losses


if __name__ == "__main__":
    main()
