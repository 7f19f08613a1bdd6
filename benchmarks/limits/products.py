"""The ceiling of a DQN update: its four large matrix products and nothing else, on all cores.

Forward with the online and with the target parameters, backward to the hidden layer, and the kernel's gradient: four
products of the shapes of the largest layer, in groups of four lanes, a thread per core.
"""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor

from jaxq import machine
from jaxq.bench.scaling import NETWORK_LANES

PACKAGES = ("jax", "jaxlib")
GROUP, LOOPS = 4, 512
#: batch, inputs and outputs of the largest layer.
SHAPES = {"article": (128, 128, 128), "64-64": (64, 64, 64), "cleanrl": (128, 120, 84)}


def prepare(case: str, setting: str = "article") -> Callable[[], float]:
    """``case`` lanes of ``setting``, or with "width" the lanes of the suite scaling-network, whose layers have ``case``
    units. A group per core is worked on at a time. Units: updates, that is, four products each."""
    from jaxq import cpu

    cpu.tune()
    import jax
    import jax.numpy as jnp

    if jax.default_backend() != "cpu":
        raise RuntimeError("a ceiling of CPUs alone: groups of four lanes, a thread per core")
    count = int(case)
    batch, inputs, outputs = (SHAPES["article"][0], count, count) if setting == "width" else SHAPES[setting]
    groups = -(-(NETWORK_LANES if setting == "width" else count) // GROUP)
    workers = min(machine.cores(), groups)
    shapes = {"x": (batch, inputs), "w": (inputs, outputs), "v": (inputs, outputs), "g": (batch, outputs)}
    arrays = {
        name: jax.random.normal(jax.random.key(i), (GROUP, *shape)) / 12
        for i, (name, shape) in enumerate(shapes.items())
    }

    def nudge(array: jax.Array, product: jax.Array) -> jax.Array:
        """Changes one number, so that no product is dropped or moved out of the loop."""
        return jax.lax.dynamic_update_slice(array, array[:, :1, :1] + 1e-6 * product[:, :1, :1], (0, 0, 0))

    def body(carry: dict[str, jax.Array], _: None) -> tuple[dict[str, jax.Array], None]:
        # The last two lie turned already: XLA multiplies them as they are.
        x, w, v, g, x_turned, w_turned = (carry[name] for name in ("x", "w", "v", "g", "x_turned", "w_turned"))
        moved = {"w": nudge(w, x @ w), "v": nudge(v, x @ v), "w_turned": nudge(w_turned, g @ w_turned)}
        return {**moved, "x": x, "g": g, "x_turned": nudge(x_turned, x_turned @ g)}, None

    arrays |= {"w_turned": jnp.swapaxes(arrays["w"], 1, 2) + 0, "x_turned": jnp.swapaxes(arrays["x"], 1, 2) + 0}
    run = jax.jit(lambda carry: jax.lax.scan(body, carry, length=LOOPS)[0]).lower(arrays).compile()
    states = [jax.tree.map(jnp.copy, arrays) for _ in range(workers)]
    pool = ThreadPoolExecutor(workers)
    rounds = -(-groups // workers)

    def work(index: int) -> None:
        for _ in range(max(1, rounds // 8)):
            states[index] = jax.block_until_ready(run(states[index]))

    def bout() -> float:
        list(pool.map(work, range(workers)))
        return float(workers * max(1, rounds // 8) * GROUP * LOOPS)

    return bout
