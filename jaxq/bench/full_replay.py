"""Gradient updates per second of a DQN whose replay is full, by the replay's capacity.

Groups of lanes as the engine holds them, one per core in a thread of its own. Only their segments are timed.
"""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from typing import Any

from jaxq import cpu

PACKAGES = ("jaxq", "jax", "jaxlib", "flax", "optax")

#: Segments of each group in a bout.
SEGMENTS = 4

_bytes: dict[str, int] = {}


def prepare(case: str, family: str = "pcg4d") -> Callable[[], float]:
    """Lanes of ``article-dqn`` with a replay of ``case`` transitions, all of them stored. Units: updates."""
    cpu.tune()
    import jax

    from jaxq import executables, lanes, programs
    from jaxq.plans import plan
    from jaxq.settings import NO_LIMIT

    # Nothing ends a lane: bout after bout goes on with the same ones.
    endless: dict[str, Any] = {"max_episodes": NO_LIMIT, "max_env_steps": NO_LIMIT, "stop": "none"}
    one = plan("article-dqn", buffer_size=int(case), **endless).settings[0]
    numbers = programs.hypers(one)
    built = executables.build(programs.program(one, family), numbers, family)
    group = stacked(numbers, built.program.width)
    states = [started(built, group, family, seed) for seed in range(lanes.default_workers())]
    _bytes[case] = sum(leaf.nbytes for leaf in jax.tree.leaves(states[0]))
    pool = ThreadPoolExecutor(len(states))

    def work(index: int) -> None:
        for _ in range(SEGMENTS):
            states[index], _ = jax.block_until_ready(built.advance(states[index], group))

    def bout() -> float:
        before = updates(states)
        list(pool.map(work, range(len(states))))
        return updates(states) - before

    return bout


def notes(case: str) -> dict[str, Any]:
    """The size of a group's state, nearly all of which is replay."""
    return {"group_mib": round(_bytes[case] / 2**20, 1)}


def stacked(numbers: Any, width: int) -> Any:
    """A setting's numbers for every lane of a group."""
    import jax
    import numpy as np

    return jax.tree.map(lambda leaf: np.stack([leaf] * width), numbers)


def started(built: Any, group: Any, family: str, seed: int) -> Any:
    """The state of a new group after its warm-up, with full replays; ``seed`` is the group's root seed."""
    import jax
    import numpy as np

    from jaxq import prng

    width = built.program.width
    root = np.asarray(jax.random.key_data(prng.key(seed, family)))
    empty = jax.tree.map(lambda leaf: np.zeros(leaf.shape, leaf.dtype), built.empty)
    state, _ = built.start(root, empty, np.ones(width, bool), np.arange(width, dtype=np.uint32), group)
    return state._replace(agent=state.agent._replace(replay=full(state.agent.replay)))


def full(replay: Any) -> Any:
    """The replays of a group with the transitions that they hold repeated until every row is written.

    Which transitions these are does not matter to the time that a batch of them takes; that each has memory of its own
    does.
    """
    import jax
    import numpy as np

    stored, capacity = int(replay.size[0]), replay.storage.a_tm1.shape[1]
    rows = np.arange(capacity) % stored
    storage = jax.tree.map(lambda leaf: jax.device_put(np.asarray(leaf)[:, rows]), replay.storage)
    return replay._replace(storage=storage, size=jax.device_put(np.full_like(replay.size, capacity)))


def updates(states: list[Any]) -> float:
    """The updates of all lanes so far."""
    return float(sum(int(state.clock.updates.sum()) for state in states))
