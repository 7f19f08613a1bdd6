"""The records that everything else is made of, and their contracts. No logic.

Two kinds, and the kind says which side of ``jit`` a thing is on. *Values* (``Step``, ``Clock``, ``Transition``,
``Hypers``) are NamedTuples: traced, and may carry batch axes. *Records of pure functions* (``Env``, ``Agent``,
``Experiment``) are frozen dataclasses: never traced, made by factories that close over numbers, which may be tracers.

Shape letters, the same in every docstring, leading axes always in this order:

====  =============================================
L     lanes; a lane is one (setting, seed)
T     time
N     environments of one lane
B     minibatch
A     actions
====  =============================================
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, NamedTuple

import jax
import jax.typing
import numpy as np

Array = jax.Array
Key = jax.Array
ArrayLike = jax.typing.ArrayLike  # what a function of arrays takes: JAX's, NumPy's, numbers
Scalar = jax.Array | np.ndarray | float  # a number that may be a tracer
PyTree = Any


class Step(NamedTuple):
    """What happened when an action was taken.

    ``obs`` is the TRUE successor observation, never one that follows a reset. ``terminated`` says that the MDP
    ended, ``truncated`` that only the watching did (a time limit); both may be true, and then it is a termination.
    """

    obs: PyTree
    reward: Array
    terminated: Array
    truncated: Array


class Clock(NamedTuple):
    """What schedules read, all scalars of one lane.

    ``live`` is 1.0 while the lane trains and 0.0 once it has ended: every step size is multiplied by it, which is how
    an ended lane stands still without a select over its parameters. The counters of an ended lane stop.
    """

    env_steps: Array
    episodes: Array
    updates: Array
    live: Array


class Transition(NamedTuple):
    """What learners eat; names follow the (t-1, t) convention of the field.

    ``continues_t`` is 0 only where the MDP terminated, else 1 (truncation keeps 1). ``cut_t`` says that the trajectory
    stops here, for either reason. Rules take ``discount_t = gamma * continues_t``.
    """

    obs_tm1: PyTree
    a_tm1: Array
    r_t: Array
    continues_t: Array
    obs_t: PyTree
    cut_t: Array


class Hypers(NamedTuple):
    """The numbers of one setting, every leaf traced: what the environment, the agent and the run are made with."""

    env: PyTree
    agent: PyTree
    run: PyTree


class Metrics(NamedTuple):
    """What an update reports: the loss, and the largest action value of the state it bootstrapped from."""

    loss: Array
    max_q: Array


@dataclass(frozen=True)
class Env:
    """An environment as pure functions. Keys come first and are consumed.

    ``reset(key) -> state``; ``step(key, state, action) -> (state, Step)``; ``observe(state) -> obs``.
    One environment, one action: the caller vmaps. ``num_states`` is set where observations are the integers
    0 .. num_states - 1. ``deterministic`` says that ``step`` draws nothing from its key, which a wrapper may then use.
    ``restart(key, state) -> state`` begins the next episode and keeps of the old one's last state what outlives it, as
    running statistics do; None where nothing does, and ``reset`` is all there is. ``resets`` says that ``step`` begins
    the next episode itself, which ``auto_reset`` makes it do.
    """

    reset: Callable[[Key], PyTree]
    step: Callable[[Key, PyTree, Array], tuple[PyTree, Step]]
    observe: Callable[[PyTree], PyTree]
    num_actions: int
    obs_shape: tuple[int, ...]
    num_states: int | None = None
    deterministic: bool = False
    restart: Callable[[Key, PyTree], PyTree] | None = None
    resets: bool = False


@dataclass(frozen=True)
class Agent:
    """A learner as pure functions. Keys come first and are consumed.

    ``init(key, example) -> state``, where ``example`` is one Transition of the right shapes and dtypes.
    ``act(key, state, obs, clock) -> action`` for one observation (the rollout vmaps).
    ``exploration(clock) -> epsilon``, the rate that ``act`` explores with, for the record.
    ``update(key, state, experience, clock) -> (state, Metrics)`` with experience ``[T, N]``; ``clock`` is the one under
    which the first of these transitions was chosen.
    ``observe(state, experience) -> state`` stores experience ``[T, N]`` without learning (warm-up).
    ``policy(state) -> policy``: the part of the state that acting greedily needs.
    ``q_values(policy, obs) -> [A]`` for one observation.
    """

    init: Callable[[Key, Transition], PyTree]
    act: Callable[[Key, PyTree, PyTree, Clock], Array]
    exploration: Callable[[Clock], Array]
    update: Callable[[Key, PyTree, Transition, Clock], tuple[PyTree, Metrics]]
    observe: Callable[[PyTree, Transition], PyTree]
    policy: Callable[[PyTree], PyTree]
    q_values: Callable[[PyTree, PyTree], Array]


@dataclass(frozen=True)
class Experiment:
    """One training as pure functions, ready to be vmapped over lanes.

    ``init(key, hypers) -> (state, log)``, warm-up included; ``advance(state, hypers) -> (state, log)`` runs one segment
    of fixed length; ``evaluate(key, policy, hypers) -> [episodes]`` returns of whole greedy episodes.
    ``policy(state, hypers)`` is the part of the state that acting greedily needs, that of the environment included.
    """

    init: Callable[[Key, Hypers], tuple[PyTree, PyTree]]
    advance: Callable[[PyTree, Hypers], tuple[PyTree, PyTree]]
    evaluate: Callable[[Key, PyTree, Hypers], Array]
    policy: Callable[[PyTree, Hypers], PyTree]
