"""Whole episodes with their time limit, step by step beside Gymnasium's."""

from __future__ import annotations

import contextlib
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from jaxq.interop.gymnasium import reference
from jaxq.interop.gymnasium.compiled import made
from jaxq.settings import changed
from jaxq.verify.checks import Found
from jaxq.worlds import World

#: Gymnasium goes on from our state after each step, so an error is that of one step in float32, of coordinates up to 10
#: that Acrobot's four stages make.
ALLOWED = 2e-5
#: A limit that random play reaches before an episode ends by itself, at least now and then.
LIMIT = 7
#: Episodes, of the cases that a run asks for.
SHARE = 0.01
SEED = 0


def compared(world: World, cases: int) -> Found:
    """The largest error of an observation in episodes of random actions; infinite where a reward or a flag differs, or
    where none was cut by its limit."""
    episodes = max(20, round(cases * SHARE))
    short: Any = changed(world, {"max_episode_steps": LIMIT})
    env, rng = made(short), np.random.default_rng(SEED)
    reset, step = jax.jit(env.reset), jax.jit(env.step)
    largest, count, truncations = 0.0, 0, 0
    with contextlib.closing(reference.make(short)) as theirs:
        for episode in range(episodes):
            key = jax.random.fold_in(jax.random.key(SEED), episode)
            state = reset(jax.random.fold_in(key, 0))
            theirs.reset(seed=SEED)
            over = False
            while not over:
                count += 1
                action = int(rng.integers(env.num_actions))
                reference.place(theirs.unwrapped, short, state)  # its time goes on by itself
                before = state
                state, happened = step(jax.random.fold_in(key, count), state, jnp.int32(action))
                obs, reward, terminated, truncated, _ = theirs.step(reference.action(short, action))
                if env.num_states is not None and not reference.same_episodes(short):
                    # Chance goes its own ways: what may follow is for ``outcomes``; here the limit counts.
                    same, error = bool(happened.truncated) == truncated, 0.0
                    over = truncated or bool(happened.terminated) or bool(terminated)
                else:
                    error = float(np.max(np.abs(np.asarray(happened.obs, float) - np.asarray(obs, float))))
                    same = np.isclose(float(happened.reward), float(reward), rtol=1e-5, atol=2e-6) and (
                        bool(happened.terminated),
                        bool(happened.truncated),
                    ) == (bool(terminated), bool(truncated))
                    over = bool(terminated or truncated)
                if not (same and error <= ALLOWED):
                    told = f"ours {jax.tree.map(lambda leaf: np.asarray(leaf).tolist(), tuple(happened))}"
                    return Found(
                        count,
                        np.inf if not same else error,
                        ALLOWED,
                        f"state {[np.asarray(x).item() for x in before]}, action {action}: {told}, theirs"
                        f" {(np.asarray(obs).tolist(), float(reward), bool(terminated), bool(truncated))}",
                    )
                largest, truncations = max(largest, error), truncations + bool(truncated)
    note = f"{episodes} episodes, {truncations} cut by the limit"
    return Found(count, largest if truncations else np.inf, ALLOWED, note)
