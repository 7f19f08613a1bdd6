"""gymnax's CartPole-v1 under random actions with its auto-reset: environment steps per second, on all cores.

A compiled scan steps a group of environments under ``vmap``. In the peer's favour, of the shapes that were tried the
fastest is taken: a thread per core, groups of at most ``GROUP``, one step per turn of the scan, keys and actions of a
group drawn in one call.
"""

from __future__ import annotations

import os
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from typing import Any

PACKAGES = ("gymnax", "jax", "jaxlib")

GROUP = 8192
#: Environment steps of a bout, about; and the steps of a group.
BOUT, STEPS = 2**22, range(32, 2**15)


def prepare(case: str) -> Callable[[], float]:
    """``case`` environments. Units: environment steps."""
    import gymnax
    import jax
    import jax.numpy as jnp

    env, params = gymnax.make("CartPole-v1")
    count = int(case)
    cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    groups = max(min(cores, count), -(-count // GROUP))
    sizes = [count // groups + (i < count % groups) for i in range(groups)]
    steps = min(max(BOUT // count, STEPS.start), STEPS.stop)

    def start(key: Any, size: int) -> Any:
        reset_key, key = jax.random.split(key)
        keys = jax.random.split(reset_key, size)
        return key, jax.vmap(env.reset, (0, None))(keys, params)[1]

    def step(carry: Any, _: None) -> tuple[Any, None]:
        key, states = carry
        size = len(states.x)
        key, act_key, env_key = jax.random.split(key, 3)
        actions = jax.random.bits(act_key, (size,), jnp.uint8).astype(jnp.int32) & 1
        keys = jax.random.split(env_key, size)
        return (key, jax.vmap(env.step, (0, 0, 0, None))(keys, states, actions, params)[1]), None

    run = jax.jit(lambda carry: jax.lax.scan(step, carry, length=steps)[0], donate_argnums=0)
    begin = jax.jit(start, static_argnums=1)
    carries = [begin(jax.random.key(i), size) for i, size in enumerate(sizes)]
    pool = ThreadPoolExecutor(cores)

    def bout() -> float:
        carries[:] = pool.map(lambda carry: jax.block_until_ready(run(carry)), carries)
        return float(count * steps)

    return bout
