"""The package's own ``article-dqn`` in one wide ``jit(vmap(...))``, without the engine and without its XLA settings.

Keys are the unrolled threefry. A bout is one segment of every lane.
"""

from __future__ import annotations

from collections.abc import Callable

import jax
import jax.numpy as jnp

from jaxq import prng, programs
from jaxq.plans import plan

PACKAGES = ("jaxq", "jax", "jaxlib", "flax", "optax")


def prepare(case: str) -> Callable[[], float]:
    """``case`` lanes in one ``vmap``, compiled once. Units: updates."""
    one = plan("article-dqn", max_episodes=10**6).settings[0]
    made, hypers = programs.program(one, "threefry").experiment, programs.hypers(one)
    advance = jax.jit(jax.vmap(lambda state: made.advance(state, hypers)), donate_argnums=0)
    held = [jax.jit(jax.vmap(lambda seed: made.init(prng.key(seed), hypers)[0]))(jnp.arange(int(case)))]

    def bout() -> float:
        before = int(held[0].clock.updates.sum())
        held[0], _ = jax.block_until_ready(advance(held[0]))
        return float(int(held[0].clock.updates.sum()) - before)

    return bout
