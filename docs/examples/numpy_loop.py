"""One rule in a NumPy loop over Gymnasium: the table is NumPy's, the environment is Gymnasium's, the rule is jaxq's.

CliffWalking (Sutton and Barto, 2018, example 6.6): -1 a step, -100 and back to the start for a step off the cliff, and
the goal is 13 steps away. A time limit of 20 steps ends most of the early episodes, and is no part of the task.

python docs/examples/numpy_loop.py
"""

from typing import NamedTuple

import gymnasium
import jax
import numpy as np

from jaxq import rules

GAMMA, STEP_SIZE, EPSILON = 0.9, 0.5, 0.1


class Seen(NamedTuple):
    """One transition as Gymnasium tells it."""

    s_tm1: int
    a_tm1: int
    r_t: float
    s_t: int
    terminated: bool
    truncated: bool


def learn(env: gymnasium.Env, episodes: int, rng: np.random.Generator) -> tuple[np.ndarray, list[Seen]]:
    """The table [S, A] after so many episodes, and what it was learned from."""
    q = np.zeros((env.observation_space.n, env.action_space.n))
    seen = []
    # A rule works without jit as well, operation by operation: the same numbers, some thirty times slower.
    q_learning = jax.jit(rules.q_learning)
    for _ in range(episodes):
        s, _ = env.reset(seed=int(rng.integers(2**31)))
        over = False
        while not over:
            best = np.flatnonzero(q[s] == q[s].max())
            a = int(rng.integers(q.shape[1]) if rng.random() < EPSILON else rng.choice(best))
            s_t, r_t, terminated, truncated, _ = env.step(a)
            # A termination ends the bootstrap. A truncation does not: the walker could have gone on from s_t.
            discount_t = GAMMA * (not terminated)
            delta = q_learning(q_tm1=q[s], a_tm1=a, r_t=float(r_t), discount_t=discount_t, q_t=q[s_t])
            q[s, a] += STEP_SIZE * float(delta)  # float: else JAX's float32 takes part in the sum
            seen.append(Seen(s, a, float(r_t), s_t, terminated, truncated))
            s, over = s_t, terminated or truncated
    return q, seen


def greedy_steps(env: gymnasium.Env, q: np.ndarray) -> int:
    """Steps of one greedy episode."""
    s, _ = env.reset(seed=0)
    steps, over = 0, False
    while not over:
        s, _, terminated, truncated, _ = env.step(int(np.argmax(q[s])))
        steps, over = steps + 1, terminated or truncated
    return steps


def main() -> tuple[np.ndarray, list[Seen]]:
    env = gymnasium.make("CliffWalking-v1", max_episode_steps=20)
    q, seen = learn(env, episodes=1000, rng=np.random.default_rng(0))
    start, _ = env.reset(seed=0)
    exact = -(1 - GAMMA**13) / (1 - GAMMA)  # 13 steps of -1
    print(f"{len(seen):,} steps, {sum(one.truncated for one in seen)} episodes cut by the time limit")
    print(f"value of the start: {q[start].max():.4f}, exact: {exact:.4f}")
    print(f"steps to the goal: {greedy_steps(env, q)}")
    return q, seen


if __name__ == "__main__":
    main()
