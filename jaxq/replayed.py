"""Saved policies played again on the pure environment."""

from __future__ import annotations

import functools
import math
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any, NamedTuple, Protocol

import jax
import jax.numpy as jnp
import numpy as np

from jaxq import prng, programs
from jaxq.evaluation import begin, greedy_returns
from jaxq.saved_policy import SavedPolicy, lasting_state, learnt
from jaxq.types import Array, Key


class Trained(Protocol):
    """A sweep whose policies were kept."""

    def settings(self, config: int) -> Any:
        """The settings of one setting's index."""

    def policy(self, config: int, seed: int = 0) -> SavedPolicy:
        """A training's final policy."""


class Played(NamedTuple):
    """Greedy episodes: the states of the world in which they began, and what they returned, [n]."""

    starts: Any
    returns: np.ndarray


class LanePlayed(NamedTuple):
    """What plays a lane's policy, its action values as a function that can be traced, the policy, and the environment's
    state in which the training ended, where something of that outlives an episode.
    """

    made: Any
    q_values: Callable[[Array], Array]
    policy: Any
    before: Any


class Followed(NamedTuple):
    """States along greedy episodes: the largest action value there, and the discounted return that followed. [n]"""

    predicted: np.ndarray
    followed: np.ndarray


def play(outcome: Trained, config: int, seed: int, episodes: int, root_seed: int = 0) -> Played:
    """Plays a saved policy greedily, from start states that its training and evaluation did not see.

    Raises ValueError where no policy was kept.
    """
    made, _, policy, before = lane(outcome, config, seed)

    def key() -> Key:  # made twice: an episode consumes what its start is told by
        return jax.random.fold_in(prng.key(root_seed, "threefry"), 0)

    def start(key: Array) -> Any:  # where an episode of this key begins
        return begin(made.world, jax.random.split(key)[0], before)

    starts = jax.vmap(start)(jax.random.split(key(), episodes))
    settings = outcome.settings(config)
    run = _game(_Structure(settings.structural(), settings), episodes)
    returns = run(key(), programs.hypers(settings), policy, before)
    return Played(jax.tree.map(np.asarray, starts), np.asarray(returns))


@dataclass(frozen=True)
class _Structure:
    """Settings of which the structure alone counts."""

    shapes: tuple[Any, ...]
    settings: Any = field(compare=False)


@functools.lru_cache(maxsize=8)
def _game(structure: _Structure, episodes: int) -> Callable[..., Array]:
    """Greedy episodes as one compiled function of the key, the numbers, the policy and the environment's state."""
    make_env, make_agent = programs.pieces(structure.settings)
    limit = structure.settings.env.eval_steps

    def game(key: Key, numbers: Any, policy: Any, before: Any) -> Array:
        env = make_env(numbers.env)
        q_values = functools.partial(make_agent(numbers.agent, env).q_values, policy)
        return greedy_returns(key, env, q_values, episodes, limit, before)

    return jax.jit(game)


def follow(outcome: Trained, config: int, seed: int, episodes: int = 20, steps: int = 500) -> Followed:
    """What a saved policy predicts along its greedy episodes beside the return that really follows.

    max_a q(s_t, a) beside r_{t+1} + gamma r_{t+2} + ..., which ends at a termination alone: an episode that would be
    truncated is played on, until what is left out weighs less than a hundredth. Raises ValueError where no policy was
    kept.
    """
    settings = outcome.settings(config)
    gamma = float(settings.gamma)
    beyond = math.ceil(math.log(0.01) / math.log(gamma)) if 0 < gamma < 1 else 1 if gamma == 0 else 10 * steps
    beyond = min(beyond, 20_000)
    made, q_values, _, before = lane(outcome, config, seed, endless=True)
    env = made.env

    def one(key: Array) -> tuple[Array, Array, Array]:
        reset_key, step_key = jax.random.split(key)

        def body(carry: Any, t: Array) -> Any:
            state, live = carry
            q = q_values(env.observe(state))
            state, happened = env.step(jax.random.fold_in(step_key, t), state, jnp.argmax(q))
            row = jnp.max(q), happened.reward * live, live
            return (state, live * (1.0 - happened.terminated)), row

        start = begin(env, reset_key, before), jnp.ones(())
        return jax.lax.scan(body, start, jnp.arange(steps + beyond))[1]

    keys = jax.random.split(jax.random.fold_in(prng.key(0, "threefry"), 1), episodes)
    predicted, rewards, live = (np.asarray(x, float) for x in jax.jit(jax.vmap(one))(keys))
    followed = np.zeros(len(rewards))
    returns = np.empty_like(rewards)
    for t in reversed(range(rewards.shape[1])):
        followed = rewards[:, t] + gamma * followed
        returns[:, t] = followed
    seen = live[:, :steps] > 0
    return Followed(predicted[:, :steps][seen], returns[:, :steps][seen])


def lane(outcome: Trained, config: int, seed: int, endless: bool = False) -> LanePlayed:
    """What plays a lane's policy.

    Raises ValueError where no policy was kept.
    """
    settings = outcome.settings(config)
    if endless and "max_episode_steps" in type(settings.env).model_fields:
        world = settings.env.model_copy(update={"max_episode_steps": 10**9})
        settings = settings.model_copy(update={"env": world})
    weights = outcome.policy(config, seed).weights
    made = programs.played(settings)
    before = lasting_state(weights, jax.eval_shape(made.env.reset, jax.random.key(0)))
    tree = _tree(learnt(weights))
    return LanePlayed(made, lambda obs: made.agent.q_values(tree, obs), tree, before)


def _tree(weights: Any) -> Any:
    """The policy's tree of its arrays by path."""
    if set(weights) == {"table"}:
        return jnp.asarray(weights["table"])
    tree: dict[str, Any] = {}
    for name, array in weights.items():
        *path, last = name.split(".")
        branch = tree
        for part in path:
            branch = branch.setdefault(part, {})
        branch[last] = jnp.asarray(array)
    return tree
