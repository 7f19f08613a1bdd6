"""Our learners in the real gymnax, and its CartPole beside ours: ``make interop-gymnax``.

Prints one JSON line: the largest difference of a step from a thousand states between gymnax's CartPole and ours, how
many ends differ; the episodes that gymnax's own wrappers count in ours, and whether they are those that are there; and
for each trained environment the mean greedy returns of a network nobody trained and of one that was. Run in an
environment of its own (``.venv-peers-gymnax``): gymnax excludes Gymnasium 1.4.
"""

import json
import sys
from importlib import metadata
from typing import Any

import gymnax
import jax
import jax.numpy as jnp
import numpy as np
from gymnax.wrappers import purerl

import jaxq
from jaxq import envs
from jaxq.interop.gymnax import GymnaxStyle, from_gymnax

STATES, LIMIT = 1000, 500
TRAINED = {"CartPole-v1": 30_000, "Catch-bsuite": 20_000}


def cartpoles() -> dict[str, float]:
    """Steps from the same states, inside and outside of the thresholds, in gymnax's CartPole and in ours."""
    theirs, ours = from_gymnax(*gymnax.make("CartPole-v1")), envs.make("CartPole-v1")
    rng, key = np.random.default_rng(0), jax.random.key(0)
    rows = jnp.asarray(rng.uniform([-2.4, -3, -0.2, -3], [2.4, 3, 0.2, 3], (STATES, 4)), jnp.float32)
    time = jnp.asarray(rng.integers(0, LIMIT, STATES), jnp.int32)
    begun, mine = theirs.reset(key), ours.reset(key)

    def compare(row: Any, t: Any, action: Any) -> tuple[Any, ...]:
        x, x_dot, theta, theta_dot = row
        named = {"x": x, "x_dot": x_dot, "theta": theta, "theta_dot": theta_dot, "time": t}
        other = theirs.step(key, begun._replace(state=begun.state.replace(**named)), action)[1]
        own = ours.step(key, type(mine)(x, x_dot, theta, theta_dot, t), action)[1]
        ends = (own.terminated != other.terminated) | (~own.terminated & (own.truncated != other.truncated))
        return jnp.abs(own.obs - other.obs).max(), ends, own.reward != other.reward

    both = jax.vmap(jax.vmap(compare, (None, None, 0)), (0, 0, None))
    apart, ends, rewards = jax.jit(both)(rows, time, jnp.arange(2))
    return {"largest": float(apart.max()), "ends": int(ends.sum()), "rewards": int(rewards.sum())}


def wrapped(num_envs: int = 8, steps: int = 200) -> dict[str, Any]:
    """gymnax's own wrappers around our CartPole, pushed to one side: the episodes that its log has, and whether they
    are those of the rewards and ends that were given."""
    env = purerl.LogWrapper(purerl.FlattenObservationWrapper(GymnaxStyle("CartPole-v1")))
    params = env.default_params.replace(max_steps_in_episode=9)

    def one(words: Any) -> Any:
        reset_key, *keys = jax.random.split(jax.random.wrap_key_data(words), steps + 1)
        _, state = env.reset(reset_key, params)

        def body(state: Any, word: Any) -> Any:
            obs, state, reward, terminated, truncated, info = env.step(
                jax.random.wrap_key_data(word), state, jnp.int32(1), params
            )
            return state, (obs, reward, terminated | truncated, info["returned_episode_returns"])

        return jax.lax.scan(body, state, jnp.stack([jax.random.key_data(key) for key in keys]))[1]

    each = jax.random.key_data(jax.random.split(jax.random.key(0), num_envs))
    obs, rewards, over, told = (np.asarray(leaf) for leaf in jax.jit(jax.vmap(one))(each))
    since, expected = np.zeros(num_envs), np.zeros(told.shape)
    for t in range(steps):
        since += rewards[:, t]
        expected[:, t] = np.where(over[:, t], since, expected[:, t - 1] if t else 0)
        since = np.where(over[:, t], 0, since)
    return {"episodes": int(over.sum()), "same": bool((told == expected).all() and obs.shape[2:] == (4,))}


def trained(name: str, env_steps: int) -> dict[str, float]:
    """Mean greedy returns of a DQN before and after so many steps, over four seeds."""

    def make() -> Any:
        return from_gymnax(*gymnax.make(name))

    found = {}
    for when, steps in (("before", 1001), ("after", env_steps)):
        outcome = jaxq.sweep("dqn", env=make, seeds=4, max_env_steps=steps, epsilon_decay=env_steps / 5, stop="none")
        found[when] = float(np.mean(outcome.lanes["eval_return"].to_numpy()))
    return found


def main() -> None:
    same = cartpoles()
    learned = {name: trained(name, steps) for name, steps in TRAINED.items()}
    logged = wrapped()
    print(json.dumps({"gymnax": metadata.version("gymnax"), "cartpole": same, "log": logged, **learned}))
    if not logged["same"] or logged["episodes"] < 100:
        sys.exit("gymnax's wrappers see other episodes in our CartPole")
    if same["largest"] > 1e-5 or same["ends"] or same["rewards"]:
        sys.exit("gymnax's CartPole is not ours")
    if not all(one["after"] > one["before"] for one in learned.values()):
        sys.exit("nothing was learned")


if __name__ == "__main__":
    main()
