"""Two states, for teaching: small enough to work out by hand, and already with a choice, a discount and chance."""

from __future__ import annotations

import jax.numpy as jnp
import numpy as np

from jaxq.envs.mdp import finite_mdp, known
from jaxq.types import Array, ArrayLike, Env


def two_states(p: Array | float = 0.5, max_episode_steps: Array | int = 100) -> Env:
    """States 0, poor, and 1, rich. Action 0 stays, action 1 crosses over with probability ``p`` and else stays. A step
    that ends rich earns 1.

    R(s, a, s') = s'. Nothing ends but by the time limit. ``two_states_q_star`` is the answer. Raises ValueError for a
    known ``p`` outside [0, 1]. ``jaxq.sweep("q-learning", env=jaxq.envs.two_states)`` learns it.

    >>> two_states().num_states
    2
    """
    if known(p) and not 0 <= float(np.asarray(p)) <= 1:
        raise ValueError(f"p: {p} is not allowed: from 0 to 1")
    stay, swap = np.eye(2), np.eye(2)[::-1]
    cross = p * swap + (1 - p) * stay
    rich = np.broadcast_to(np.array([0.0, 1.0]), (2, 2, 2))
    return finite_mdp(jnp.stack([stay, cross], 1), rich, np.array([1.0, 0.0]), max_episode_steps=max_episode_steps)


def two_states_q_star(p: ArrayLike, gamma: ArrayLike) -> Array:
    """The optimal action values of ``two_states``.

    Who is rich stays: V(1) = 1 + gamma V(1), so V(1) = 1 / (1 - gamma). Who is poor crosses over: with p the step earns
    1 and goes on from 1, which is worth 1 + gamma V(1) = V(1), and else one is where one was, so
    V(0) = p V(1) + (1 - p) gamma V(0), which is p V(1) / (1 - (1 - p) gamma). The other two actions are worth
    Q(0, stay) = gamma V(0) and Q(1, cross) = p gamma V(0) + (1 - p) V(1).

    Shapes: p and gamma [], gamma below 1 -> [2, 2].

    >>> np.asarray(two_states_q_star(0.5, 0.5), float).round(4).tolist()
    [[0.6667, 1.3333], [2.0, 1.3333]]
    """
    rich = 1 / (1 - jnp.asarray(gamma))
    poor = p * rich / (1 - (1 - jnp.asarray(p)) * gamma)
    return jnp.stack([jnp.stack([gamma * poor, poor]), jnp.stack([rich, p * gamma * poor + (1 - p) * rich])])
