"""Value-based reinforcement learning as pure JAX functions, thousands of small trainings at once on a CPU.

The legend, in Sutton and Barto's symbols:

==============================  ============================================================
``obs_tm1``, ``a_tm1``          S_t, A_t: where the agent was and what it did
``r_t``, ``obs_t``              R_{t+1}, S_{t+1}: what came of it
``continues_t``                 0 after a termination, else 1 (a truncation continues)
``discount_t``                  gamma times ``continues_t``
``q_tm1``, ``q_t``              action values at S_t and S_{t+1}, one row of A numbers
``v_t``                         value of S_{t+1}, what a rule bootstraps from
==============================  ============================================================

Importing this package imports no jax; modules load when they are first named.
"""

from __future__ import annotations

import importlib
from typing import Any

__version__ = "0.1.0"

_MODULES = tuple(
    "agents axes compile_cache cpu envs experiment functions lanes networks optimisers pictures policies presets prng"
    " programs replay rules saved_policy schedules stats success types worlds".split()
)
_NAMES = {
    "Outcome": "outcome",
    "Plan": "plans",
    "Range": "axes",
    "load": "outcome",
    "plan": "plans",
    "sweep": "sweeps",
    "train": "sweeps",
}

__all__ = [*_MODULES, *_NAMES]


def __getattr__(name: str) -> Any:
    if name in _NAMES:
        return getattr(importlib.import_module(f"jaxq.{_NAMES[name]}"), name)
    if name in _MODULES:
        return importlib.import_module(f"jaxq.{name}")
    raise AttributeError(f"module 'jaxq' has no attribute {name!r}")


def __dir__() -> list[str]:
    return sorted(__all__)
