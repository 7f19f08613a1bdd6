"""Gymnasium's CartPole-v1 under random actions: environment steps per second, on one core.

``vector`` is its vectorised NumPy class, ``sync`` a SyncVectorEnv of single environments. In the peer's favour all
actions are drawn beforehand, observations are not copied, and a call in which an environment only resets is a step.
"""

from __future__ import annotations

from collections.abc import Callable

PACKAGES = ("gymnasium", "numpy")

#: Environment steps of a bout, about; and its calls of ``step``.
BOUT = {"vector": 2**21, "sync": 2**15}
CALLS = {"vector": range(8, 4096), "sync": range(1, 4096)}


def prepare(case: str, kind: str = "vector") -> Callable[[], float]:
    """``case`` environments; ``kind`` is vector or sync. Units: environment steps."""
    import gymnasium
    import numpy as np

    count = int(case)
    if kind == "vector":
        envs = gymnasium.make_vec("CartPole-v1", num_envs=count, vectorization_mode="vector_entry_point")
    elif kind == "sync":
        one = [lambda: gymnasium.make("CartPole-v1", disable_env_checker=True)]
        envs = gymnasium.vector.SyncVectorEnv(one * count, copy=False)
    else:
        raise ValueError(f"kind: {kind!r} is neither 'vector' nor 'sync'")
    envs.reset(seed=0)
    calls = min(max(BOUT[kind] // count, CALLS[kind].start), CALLS[kind].stop)
    actions = np.random.default_rng(0).integers(0, 2, (calls, count))

    def bout() -> float:
        for chosen in actions:
            envs.step(chosen)
        return float(calls * count)

    return bout


def notes(case: str) -> dict[str, str]:
    """What it runs on."""
    del case
    return {"differs": "one core: it has no threads"}
