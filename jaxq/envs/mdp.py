"""A finite MDP as an environment, from the arrays that define it; and such arrays at random.

Shape letters: S states, A actions. ``solutions`` has the exact action values of the same arrays.
"""

from __future__ import annotations

import itertools
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax.typing import DTypeLike

from jaxq.types import Array, ArrayLike, Env, Key, Step

#: How far a sum of probabilities may be from 1: what dividing float32 numbers by their sum may lose.
SUM_TOLERANCE = 1e-5


#: What an int32 can count to.
MOST_STEPS = 2**31 - 1


class MDPState(NamedTuple):
    """Which state it is, the observation, and the steps taken in this episode. Both [] int32."""

    s: Array
    t: Array


class MDP(NamedTuple):
    """The arrays of a finite MDP, as ``finite_mdp`` and ``solutions`` take them."""

    transition: np.ndarray  # [S, A, S], probabilities of the next state
    reward: np.ndarray  # [S, A], expected reward of a step, or [S, A, S], reward of the transition
    start: np.ndarray  # [S], probabilities of the first state
    terminal: np.ndarray  # [S] bool, where an episode ends


def finite_mdp(
    transition: ArrayLike,
    reward: ArrayLike,
    start: ArrayLike,
    *,
    terminal: ArrayLike | None = None,
    max_episode_steps: ArrayLike | None = None,
    reward_dtype: DTypeLike = jnp.float32,
) -> Env:
    """The MDP of these arrays; the observation is the state, an integer.

    P(s' | s, a) = transition[s, a, s'], R = reward[s, a] or reward[s, a, s'], P(s_0) = start[s_0]. An episode
    terminates when it enters a ``terminal`` state, and is truncated after ``max_episode_steps``. Sutton and Barto,
    2018, section 3.1.

    Shapes: transition [S, A, S], reward [S, A] or [S, A, S], start [S], terminal [S] bool, max_episode_steps []. All
    may be traced. A reset and a step use one uniform number of their key each, and never enter a state of probability
    0. Its resolution is that of the probabilities' dtype, so float32 takes one below 2^-23 for 0 or 2^-23. A step costs
    as many operations as a state and action have successors at most, or S where the transitions are traced.

    Raises ValueError for a shape that does not fit, and, where the values are known, for what is not a distribution, a
    reward that is not finite, a start in a terminal state, and steps that are not a whole number from 1 on.

    >>> stay_or_go = np.array([[[1.0, 0.0], [0.0, 1.0]], [[0.0, 1.0], [0.0, 1.0]]])
    >>> finite_mdp(stay_or_go, np.zeros((2, 2)), np.array([1.0, 0.0]), terminal=np.array([False, True])).num_states
    2
    """
    num_states, num_actions = check_mdp(transition, reward, terminal)
    check_distribution("start", start, (num_states,))
    check_start(start, terminal)
    if max_episode_steps is not None:
        check_steps(max_episode_steps)
    rewards = jnp.asarray(reward, reward_dtype)
    which, ends_of = _successors(transition)
    starts = cumulative(start)
    ends = None if terminal is None else jnp.asarray(terminal)

    def reset(key: Key) -> MDPState:
        return MDPState(draw(key, starts), jnp.zeros((), jnp.int32))

    def observe(state: MDPState) -> Array:
        return state.s

    def step(key: Key, state: MDPState, action: Array) -> tuple[MDPState, Step]:
        k = draw(key, ends_of[state.s, action])
        after = MDPState(k if which is None else which[state.s, action, k], state.t + 1)
        earned = rewards[state.s, action] if rewards.ndim == 2 else rewards[state.s, action, after.s]
        terminated = jnp.zeros((), bool) if ends is None else ends[after.s]
        truncated = jnp.zeros((), bool) if max_episode_steps is None else after.t >= jnp.asarray(max_episode_steps)
        return after, Step(observe(after), earned, terminated, truncated)

    return Env(reset, step, observe, num_actions=num_actions, obs_shape=(), num_states=num_states)


def _successors(transition: ArrayLike) -> tuple[Array | None, Array]:
    """The states that may follow, [S, A, K] int32 ascending, and ``cumulative`` of their probabilities.

    K is how many there are at most, and what is left over has probability 0. None and [S, A, S] where all may follow or
    the values are not known.
    """
    if not known(transition):
        return None, cumulative(transition)
    probabilities = np.asarray(transition)
    most = int(np.max(np.sum(probabilities > 0, -1)))
    if most == probabilities.shape[-1]:
        return None, cumulative(transition)
    which = np.argsort(probabilities <= 0, -1, kind="stable")[..., :most]
    return jnp.asarray(which, jnp.int32), cumulative(np.take_along_axis(probabilities, which, -1))


def random_mdp(
    rng: np.random.Generator, num_states: int, num_actions: int, *, terminal: int = 1, branching: int | None = None
) -> MDP:
    """An MDP whose transitions are Dirichlet and whose rewards are normal.

    P(. | s, a) ~ Dirichlet(1, ..., 1) over ``branching`` successors (default: all states), R(s, a) ~ N(0, 1). The last
    ``terminal`` states are terminal; an episode starts in ``branching`` of the others. A path through all states that
    are not terminal, in random order and then into a terminal one, is among the successors, so every such state can be
    reached, and the end can be reached from each. A terminal state leads to itself with reward 0.

    Shapes: float64, transition [S, A, S], reward [S, A], start [S]; terminal [S] bool. Raises ValueError for counts
    that are not whole or out of range: ``terminal`` in 0 .. S - 1, ``branching`` in 1 .. S.
    """
    branching = num_states if branching is None else branching
    ranges = {
        "num_states": (num_states, 1, None),
        "num_actions": (num_actions, 1, None),
        "terminal": (terminal, 0, num_states - 1),
        "branching": (branching, 1, num_states),
    }
    for name, (count, low, high) in ranges.items():
        if not is_whole(count) or count < low or (high is not None and count > high):
            allowed = f"at least {low}" if high is None else f"{low} to {high}"
            raise ValueError(f"{name}: {count!r} is not allowed: a whole number, {allowed}")
    inner = num_states - terminal
    path = rng.permutation(inner)
    after = dict(itertools.pairwise(path))  # the last of the path goes to a terminal state
    transition = np.zeros((num_states, num_actions, num_states))
    transition[range(inner, num_states), :, range(inner, num_states)] = 1
    for s in range(inner):
        on_path = rng.integers(num_actions)
        for a in range(num_actions):
            wanted = after.get(s, num_states - 1 if terminal else s) if a == on_path else None
            transition[s, a] = _few(rng, num_states, branching, wanted)
    reward = rng.normal(size=(num_states, num_actions))
    reward[inner:] = 0
    start = np.zeros(num_states)
    start[:inner] = _few(rng, inner, min(branching, inner), path[0])
    return MDP(transition, reward, start, np.arange(num_states) >= inner)


def check_mdp(transition: ArrayLike, reward: ArrayLike, terminal: ArrayLike | None) -> tuple[int, int]:
    """S and A of arrays that fit together; raises ValueError where they do not, as ``finite_mdp`` says."""
    shape = np.shape(transition)
    if len(shape) != 3 or shape[0] != shape[2] or 0 in shape:
        raise ValueError(f"transition: shape {shape} is not allowed: [S, A, S]")
    num_states, num_actions = shape[:2]
    check_distribution("transition", transition, shape)
    if np.shape(reward) not in (shape[:2], shape):
        raise ValueError(f"reward: shape {np.shape(reward)} is not allowed: {shape[:2]} or {shape}")
    if known(reward) and not np.all(np.isfinite(reward)):
        where = _first_place(~np.isfinite(reward))
        raise ValueError(f"reward: {np.asarray(reward)[where]} at {list(where)} is not allowed: a finite number")
    if terminal is not None:
        if np.shape(terminal) != (num_states,):
            raise ValueError(f"terminal: shape {np.shape(terminal)} is not allowed: {(num_states,)}")
        if (dtype := jnp.asarray(terminal).dtype) != jnp.bool_:
            raise ValueError(f"terminal: dtype {dtype} is not allowed: bool")
    return num_states, num_actions


def check_distribution(name: str, given: ArrayLike, shape: tuple[int, ...]) -> None:
    """Raises ValueError unless ``given`` has this shape and, where it is known, its last axis are probabilities."""
    if np.shape(given) != shape:
        raise ValueError(f"{name}: shape {np.shape(given)} is not allowed: {shape}")
    if not known(given):
        return
    values = np.asarray(given, np.float64)
    wrong = ~(np.isfinite(values) & (values >= 0))
    if np.any(wrong):
        where = _first_place(wrong)
        raise ValueError(f"{name}: {values[where]} at {list(where)} is not allowed: a probability")
    total = np.asarray(values.sum(-1))
    wrong = np.abs(total - 1) > SUM_TOLERANCE
    if np.any(wrong):
        where = _first_place(wrong)
        at = f" at {list(where)}" if where else ""
        raise ValueError(f"{name}: probabilities{at} sum to {total[where]}, allowed: 1")


def known(given: ArrayLike | None) -> bool:
    """Whether the values of an array can be looked at, which those of a tracer cannot."""
    return not isinstance(given, jax.core.Tracer)


def in_float(given: ArrayLike) -> Array:
    """The array in its own dtype, or in float32 where that holds more."""
    array = jnp.asarray(given)
    return array.astype(jnp.promote_types(array.dtype, jnp.float32))


def cumulative(probabilities: ArrayLike) -> Array:
    """Upper ends of the intervals of [0, 1) that belong to each outcome, [..., S] -> [..., S].

    An outcome of probability 0 has an interval of no length, whatever the sums are rounded to and in whatever order
    they are added: its end is the largest before it. The last interval of the others has no end.
    """
    p = in_float(probabilities)
    last = p.shape[-1] - 1 - jnp.argmax(jnp.flip(p > 0, -1), -1)
    ends = jax.lax.cummax(jnp.where(p > 0, jnp.cumsum(p, -1), 0), axis=p.ndim - 1)
    return jnp.where(jnp.arange(p.shape[-1]) >= last[..., None], jnp.inf, ends)


def draw(key: Key, ends: Array) -> Array:
    """The outcome into whose interval one uniform number falls, [S] -> [] int32."""
    u = jax.random.uniform(key, (), ends.dtype)
    return jnp.sum(u >= ends, dtype=jnp.int32)


def check_steps(steps: ArrayLike, name: str = "max_episode_steps") -> None:
    """Raises ValueError for steps after which no episode can be truncated; ``name`` is what the caller calls them."""
    dtype = getattr(steps, "dtype", None) or np.asarray(steps).dtype
    fits = np.shape(steps) == () and jnp.issubdtype(dtype, jnp.integer)
    if not fits or (known(steps) and not 1 <= int(np.asarray(steps)) <= MOST_STEPS):
        raise ValueError(f"{name}: {steps!r} is not allowed: a whole number from 1 to {MOST_STEPS}")


def _few(rng: np.random.Generator, count: int, branching: int, wanted: int | None) -> np.ndarray:
    """Dirichlet probabilities of ``branching`` of ``count`` outcomes, ``wanted`` among them: [count]."""
    chosen = rng.choice(count, branching, replace=False)
    if wanted is not None and wanted not in chosen:
        chosen[0] = wanted
    probabilities = np.zeros(count)
    probabilities[chosen] = rng.dirichlet(np.ones(branching))
    return probabilities


def check_start(start: ArrayLike, terminal: ArrayLike | None) -> None:
    """Raises ValueError where an episode would begin in a terminal state."""
    if terminal is None or not (known(start) and known(terminal)):
        return
    begins = np.asarray(start)
    wrong = (begins > 0) & np.asarray(terminal)
    if np.any(wrong):
        (where,) = _first_place(wrong)
        raise ValueError(f"start: {begins[where]} at [{where}], a terminal state, is not allowed: 0")


def is_whole(count: object) -> bool:
    """Whether it is an integer, Python's or NumPy's."""
    return isinstance(count, int | np.integer) and not isinstance(count, bool)


def _first_place(wrong: np.ndarray) -> tuple[int, ...]:
    return tuple(int(i) for i in np.argwhere(wrong)[0])
