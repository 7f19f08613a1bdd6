"""Environment steps per second under a random policy: CartPole with auto-reset, alone.

Environments run in chunks of up to ``CHUNK``, each through a loop of its own that XLA compiles into one function whose
state stays in the nearest cache; chunks are shared out among a thread per core.
"""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from typing import Any, NamedTuple

from jaxq import cpu

PACKAGES = ("jaxq", "jax", "jaxlib")

#: Environments that step together, and steps before the next chunk's turn: whole words of random actions.
CHUNK, STEPS = 64, 32 * 64
#: Steps of a bout, at least.
BOUT = 2**20


class Rolled(NamedTuple):
    """Chunks after some steps: their states [C, N, ...], and how many episodes ended."""

    states: Any
    episodes: Any


def prepare(case: str, family: str = "pcg4d") -> Callable[[], float]:
    """``case`` environments, keys of ``family``; a bout is at least ``BOUT`` steps. Units: environment steps."""
    cpu.tune()
    import jax
    import jax.numpy as jnp

    from jaxq import lanes, prng
    from jaxq.envs import make
    from jaxq.envs.auto_reset import auto_reset

    count = int(case)
    width = min(count, CHUNK) if jax.default_backend() == "cpu" else count
    chunks = -(-count // width)
    workers = min(lanes.default_workers(), chunks)
    shares = [len(range(i, chunks, workers)) for i in range(workers)]
    env = auto_reset(make("CartPole-v1"))

    def init(root: Any, share: int) -> Any:
        keys = jax.random.split(prng.wrap(root, family), (share, width))
        return jax.vmap(jax.vmap(env.reset))(keys)

    built: dict[int, Any] = {}
    work = []
    for i, share in enumerate(shares):
        root = jax.random.key_data(jax.random.fold_in(prng.key(0, family), i))
        states = jax.jit(init, static_argnums=1)(root, share)
        if share not in built:
            run = jax.jit(lambda root, states, first: roll(env, family, root, states, first), donate_argnums=1)
            built[share] = run.lower(root, states, jnp.uint32(0)).compile()
        work.append([built[share], root, states, 0])
    pool = ThreadPoolExecutor(workers)
    calls = -(-BOUT // (chunks * width * STEPS))

    def one(item: list[Any]) -> None:
        run, root, states, first = item
        for _ in range(calls):
            states, _ = jax.block_until_ready(run(root, states, jnp.uint32(first)))
            first += STEPS
        item[2:] = states, first

    def bout() -> float:
        list(pool.map(one, work))
        return float(chunks * width * STEPS * calls)

    return bout


def roll(env: Any, family: str, root: Any, states: Any, first: Any) -> Rolled:
    """``STEPS`` steps of every chunk under a random policy, chunk after chunk; ``first`` is the number of steps before.

    Shapes: root [2], states [C, N, ...], first [] uint32. A word holds an environment's actions of 32 steps.
    """
    import jax
    import jax.numpy as jnp

    from jaxq import prng

    act_key, env_key = jax.random.split(prng.wrap(root, family))

    def chunk(index: Any, states: Any) -> Rolled:
        width = jax.tree.leaves(states)[0].shape[0]
        here = index * width + jnp.arange(width, dtype=jnp.uint32)

        def keys(key: Any, time: Any) -> Any:
            return jax.vmap(jax.random.fold_in, (None, 0))(jax.random.fold_in(key, time), here)

        def block(carry: Rolled, start: Any) -> tuple[Rolled, None]:
            words = jax.vmap(lambda key: jax.random.bits(key, (), jnp.uint32))(keys(act_key, start))

            def step(carry: Rolled, t: Any) -> tuple[Rolled, None]:
                actions = ((words >> t) & 1).astype(jnp.int32)
                states, happened = jax.vmap(env.step)(keys(env_key, start + t), carry.states, actions)
                over = happened.terminated | happened.truncated
                return Rolled(states, carry.episodes + over), None

            return jax.lax.scan(step, carry, jnp.arange(32, dtype=jnp.uint32))[0], None

        start = first + jnp.arange(0, STEPS, 32, dtype=jnp.uint32)
        return jax.lax.scan(block, Rolled(states, jnp.zeros(width, jnp.int32)), start)[0]

    indices = jnp.arange(jax.tree.leaves(states)[0].shape[0], dtype=jnp.uint32)
    return jax.lax.map(lambda one: chunk(*one), (indices, states))
