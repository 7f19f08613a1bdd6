"""A finite environment from the few outcomes that each action may have, where a whole transition tensor would be large.

Shape letters: S states, A actions, K outcomes of an action, R rewards there are.
"""

from __future__ import annotations

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from jaxq.envs.mdp import MDP, MDPState, check_distribution, check_steps, cumulative, draw, known
from jaxq.types import Array, ArrayLike, Env, Key, Step


class Outcomes(NamedTuple):
    """What may come of each action in each state, all [S, A, K]; how likely each is stands beside it."""

    successor: np.ndarray  # int32
    reward: np.ndarray  # int32, which of the rewards
    terminated: np.ndarray  # bool


def outcome_mdp(
    outcomes: Outcomes,
    probability: ArrayLike,
    rewards: ArrayLike,
    starts: np.ndarray,
    *,
    max_episode_steps: ArrayLike | None = None,
) -> Env:
    """The finite MDP in which outcome k of action a in state s comes with its probability.

    P(successor[s, a, k], rewards[reward[s, a, k]] | s, a) = probability[s, a, k], P(s_0) = 1 / n for each of the n
    ``starts``. A step costs one gather, whatever S is. The observation is the state. An episode terminates with an
    outcome that says so, and is truncated after ``max_episode_steps``. Sutton and Barto, 2018, section 3.1.

    Shapes: outcomes [S, A, K]; probability [K], or [S, A, K] where it differs between states; rewards [R]; starts [n];
    max_episode_steps []. Probabilities, rewards and steps may be traced. Raises ValueError for shapes and dtypes that
    do not fit, indices outside their arrays, and known rewards that are not finite.

    >>> one = np.zeros((1, 1, 1), np.int32)
    >>> outcome_mdp(Outcomes(one, one, one == 0), np.ones(1), np.ones(1), np.zeros(1, int)).num_states
    1
    """
    outcomes, starts = Outcomes(*(np.asarray(leaf) for leaf in outcomes)), np.asarray(starts)
    if np.ndim(rewards) != 1 or (known(rewards) and not np.all(np.isfinite(np.asarray(rewards)))):
        raise ValueError(f"rewards: {rewards!r} is not allowed: finite numbers [R]")
    num_rewards = np.shape(rewards)[0]
    _check(outcomes, num_rewards, starts)
    num_states, num_actions, num_outcomes = shape = np.shape(outcomes.successor)
    check_distribution("probability", probability, shape[2:] if np.ndim(probability) == 1 else shape)
    if max_episode_steps is not None:
        check_steps(max_episode_steps)
    values = jnp.asarray(rewards, jnp.float32)
    # All that an outcome says, in one number, so that a step reads memory once.
    packed = (outcomes.successor.astype(np.int64) * num_rewards + outcomes.reward) * 2 + outcomes.terminated
    if packed.max() >= 2**31:
        raise ValueError(f"outcomes: {num_states} states and {num_rewards} rewards are too many")
    table = jnp.asarray(packed.reshape(-1), jnp.int32)
    ends = None if num_outcomes == 1 else cumulative(probability)
    first = jnp.asarray(starts, jnp.int32)

    def reset(key: Key) -> MDPState:
        which = 0 if len(starts) == 1 else jax.random.randint(key, (), 0, len(starts), jnp.int32)
        return MDPState(first[which], jnp.zeros((), jnp.int32))

    def observe(state: MDPState) -> Array:
        return state.s

    def step(key: Key, state: MDPState, action: Array) -> tuple[MDPState, Step]:
        cell = state.s * num_actions + action
        k = 0 if ends is None else draw(key, ends if ends.ndim == 1 else ends.reshape(-1, num_outcomes)[cell])
        found = table[cell * num_outcomes + k]
        which = found // 2
        after = MDPState(which // num_rewards, state.t + 1)
        truncated = jnp.zeros((), bool) if max_episode_steps is None else after.t >= jnp.asarray(max_episode_steps)
        return after, Step(observe(after), values[which % num_rewards], found % 2 == 1, truncated)

    return Env(
        reset,
        step,
        observe,
        num_actions=num_actions,
        obs_shape=(),
        num_states=num_states,
        deterministic=num_outcomes == 1,
    )


def as_mdp(outcomes: Outcomes, probability: np.ndarray, rewards: np.ndarray, starts: np.ndarray) -> MDP:
    """The arrays of the same MDP, for ``solutions``.

    transition[s, a, s'] = sum_k P(k | s, a) 1(successor[s, a, k] = s'), reward[s, a] its expected reward. A state in
    which an outcome terminates is terminal. Shapes: as ``outcome_mdp``'s -> those of ``MDP``, float64. Raises
    ValueError where an outcome that can happen enters a terminal state without an end: then there are no such arrays.
    """
    num_states, num_actions, _ = outcomes.successor.shape
    likely = np.broadcast_to(np.asarray(probability, float), outcomes.successor.shape)
    transition = np.zeros((num_states, num_actions, num_states))
    s, a, _ = np.indices(outcomes.successor.shape)
    np.add.at(transition, (s, a, outcomes.successor), likely)
    terminal = np.zeros(num_states, bool)
    terminal[outcomes.successor[outcomes.terminated & (likely > 0)]] = True
    start = np.zeros(num_states)
    np.add.at(start, starts, 1 / len(starts))
    reached = _reached(outcomes, likely, starts, terminal)
    wrong = reached[:, None, None] & (likely > 0) & (terminal[outcomes.successor] != outcomes.terminated)
    if np.any(wrong):
        where = tuple(int(i) for i in np.argwhere(wrong)[0])
        raise ValueError(f"outcomes: {list(where)} enters a state that ends other episodes, without an end")
    return MDP(transition, (likely * np.asarray(rewards, float)[outcomes.reward]).sum(-1), start, terminal)


def _reached(outcomes: Outcomes, likely: np.ndarray, starts: np.ndarray, terminal: np.ndarray) -> np.ndarray:
    """Which states an episode can act in, [S] bool."""
    reached = np.zeros(len(terminal), bool)
    fresh = set(np.asarray(starts).tolist())
    while fresh:
        reached[list(fresh)] = True
        rows = outcomes.successor[list(fresh)][likely[list(fresh)] > 0]
        fresh = {int(s) for s in rows if not (reached[s] or terminal[s])}
    return reached


def _check(outcomes: Outcomes, num_rewards: int, starts: np.ndarray) -> None:
    shape = np.shape(outcomes.successor)
    if len(shape) != 3 or 0 in shape:
        raise ValueError(f"successor: shape {shape} is not allowed: [S, A, K]")
    for name in ("reward", "terminated"):
        if np.shape(getattr(outcomes, name)) != shape:
            raise ValueError(f"{name}: shape {np.shape(getattr(outcomes, name))} is not allowed: {shape}")
    if outcomes.terminated.dtype != bool:
        raise ValueError(f"terminated: {outcomes.terminated.dtype} is not allowed: bool")
    bounds = {"successor": shape[0], "reward": num_rewards}
    for name, indices, bound in (
        *((n, getattr(outcomes, n), b) for n, b in bounds.items()),
        ("starts", starts, shape[0]),
    ):
        if not np.issubdtype(indices.dtype, np.integer):
            raise ValueError(f"{name}: {indices.dtype} is not allowed: whole numbers")
        wrong = (np.asarray(indices) < 0) | (np.asarray(indices) >= bound)
        if np.any(wrong) or not np.size(indices):
            found = np.asarray(indices)[wrong][:1]
            raise ValueError(f"{name}: {found.tolist()} is not allowed: at least one index from 0 to {bound - 1}")
