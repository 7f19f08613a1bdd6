"""One step from any state, here and in Gymnasium."""

from __future__ import annotations

import contextlib
import itertools
import math

import gymnasium
import numpy as np

from jaxq.interop.gymnasium import reference
from jaxq.verify import stepped
from jaxq.verify.checks import Found
from jaxq.verify.states import drawn
from jaxq.verify.stepped import Stepped
from jaxq.worlds import World

DTYPES = ("float64", "float32")
#: Largest error of a successor that is allowed, some roundings of the largest numbers of a step: CartPole's are up to 4
#: and moved by 20 times 0.02, the car's at most 1, the pendulum's angles up to 12; Acrobot's speeds are up to 30, and
#: its four stages square them.
ALLOWED: dict[str, dict[str, float]] = {
    "CartPole-v1": {"float64": 1e-14, "float32": 2e-6},
    "Acrobot-v1": {"float64": 1e-12, "float32": 2e-5},
    "MountainCar-v0": {"float64": 1e-15, "float32": 3e-7},
    "Pendulum-v1": {"float64": 1e-13, "float32": 5e-6},
}
#: A reward is float32 here and float64 there; relative to max(1, |reward|).
ALLOWED_REWARD = 2e-6
#: Where a state that is an ulp away leads Gymnasium itself a hundredth as far, rounding decided: Acrobot's step is
#: chaotic at its greatest speeds, and a flag may turn within some ulps of a threshold.
ROUNDINGS, ULPS = 100, 8
SEED = 0
#: The share of cases that rounding may decide, besides one: past it something else is wrong.
DECIDED = {"Acrobot-v1": 0.015}
DECIDED_ELSE = 0.005
#: An observation is float32 in both, and as far off as its state is.
ROUNDED = 2.0**-23


def compared(world: World, dtype: str, cases: int, against: str | None = None) -> Found:
    """The largest error of a successor over ``cases`` random states and all actions, and states close to each
    threshold; infinite where an observation, a reward or a flag differs. ``against`` is another environment of
    Gymnasium's with the same states."""
    env = reference.make(world) if against is None else gymnasium.make(against)
    allowed = ALLOWED[world.id][dtype]
    with contextlib.closing(env), np.errstate(all="ignore"):
        env.reset(seed=SEED)
        count, rng = len(world.actions()), np.random.default_rng(SEED)
        states, actions = drawn(env, world, dtype, cases, count, rng)
        theirs = stepped.theirs(env, world, states, actions)
        ours = stepped.ours(world, dtype, states, actions)
        error = _apart(world, ours.after, theirs.after)
        seen = np.abs(ours.obs - theirs.obs) <= np.maximum(allowed, error)[:, None] + ROUNDED * np.abs(theirs.obs)
        off = ~(error <= allowed) | ~_paid(ours, theirs) | (ours.terminated != theirs.terminated)
        decided = np.zeros(len(off), bool)
        if off.any() and off.sum() <= 1 + DECIDED.get(world.id, DECIDED_ELSE) * len(off):
            chosen = (Stepped(*(column[off] for column in one)) for one in (ours, theirs))
            decided[off] = _rounding_decides(env, world, dtype, states[off], actions[off], *chosen)
    off = (off & ~decided) | ~seen.all(-1)
    if not off.any():
        return Found(len(states), float(error[~decided].max()), allowed, decided=int(decided.sum()))
    i = int(np.flatnonzero(off)[0])
    told = "; ".join(
        f"{whose} {one.after[i].tolist()}, seen {one.obs[i].tolist()}, reward {one.reward[i]:g}, terminated"
        f" {bool(one.terminated[i])}"
        for whose, one in (("ours", ours), ("theirs", theirs))
    )
    largest = float(error[off].max())
    return Found(
        len(states),
        largest if largest > allowed else math.inf,  # what is seen, a reward or a flag
        allowed,
        f"{off.sum()} are off; state {states[i].tolist()}, action {actions[i]}: {told}",
        int(decided.sum()),
    )


def _paid(ours: Stepped, theirs: Stepped, more: np.ndarray | float = 0.0) -> np.ndarray:
    """Whether a reward is the same but for its rounding, and for ``more``. [n]"""
    allowed = ALLOWED_REWARD * np.maximum(1, np.abs(theirs.reward)) + more
    near: np.ndarray = np.abs(ours.reward - theirs.reward) <= allowed
    return near


def _apart(world: World, one: np.ndarray, other: np.ndarray) -> np.ndarray:
    """The largest distance of a coordinate. Shapes: [n, D] -> [n]. An angle of Acrobot's at pi may be at -pi."""
    distance = np.abs(one - other)
    if world.id == "Acrobot-v1":
        distance[:, :2] = np.minimum(distance[:, :2], np.abs(2 * math.pi - distance[:, :2]))
    found: np.ndarray = distance.max(-1)
    return found


def _rounding_decides(
    env: gymnasium.Env,
    world: World,
    dtype: str,
    states: np.ndarray,
    actions: np.ndarray,
    ours: Stepped,
    theirs: Stepped,
) -> np.ndarray:
    """Whether Gymnasium's own steps from states some ulps away lead as far as ours do, to as different a reward and to
    the other flag. [n]"""
    moves, flips = np.zeros(len(states)), np.zeros(len(states), bool)
    pays = np.zeros(len(states))
    for i, ulps in itertools.product(range(states.shape[1]), (-ULPS, -1, 1, ULPS)):
        moved = states.copy()
        moved[:, i] += ulps * np.spacing(np.abs(states[:, i]).astype(dtype)).astype(float)
        other = stepped.theirs(env, world, moved, actions)
        moves = np.maximum(moves, _apart(world, other.after, theirs.after))
        pays = np.maximum(pays, np.abs(other.reward - theirs.reward))
        flips |= other.terminated != theirs.terminated
    near = _apart(world, ours.after, theirs.after) <= np.maximum(ALLOWED[world.id][dtype], ROUNDINGS * moves)
    return near & _paid(ours, theirs, pays) & ((ours.terminated == theirs.terminated) | flips)
