"""The tutorial's tabular agent, in plain NumPy over Gymnasium: the slow, independent reference.

Run it to remake ``tutorial_tabular.json``, the summary the tests compare ``article-q`` with:

    python tests/reference/tutorial_tabular.py --seeds 2000 --processes 2 > tests/reference/tutorial_tabular.json

One loop per seed, float64 table, Python floats: nothing here is shared with jaxq.
"""

import argparse
import json
import math
import multiprocessing
import platform
import random
import sys
import time

import gymnasium
import numpy as np

NUM_BUCKETS = (1, 1, 6, 3)
NUM_ACTIONS = 2
VELOCITY_BOUND = 0.5
ANGULAR_BOUND = math.radians(50)


def state_bounds(env):
    """The observation space's bounds (float32), with the two infinite ones replaced."""
    bounds = [list(pair) for pair in zip(env.observation_space.low, env.observation_space.high, strict=True)]
    bounds[1] = [-VELOCITY_BOUND, VELOCITY_BOUND]
    bounds[3] = [-ANGULAR_BOUND, ANGULAR_BOUND]
    return bounds


def bucket(value, low, high, count):
    """One coordinate's bucket: ends clamp, the inside rounds half to even on a linear scale."""
    if value <= low:
        return 0
    if value >= high:
        return count - 1
    width = high - low
    return round((count - 1) / width * value - (count - 1) * low / width)


def discretise(observation, bounds, counts=NUM_BUCKETS):
    """All coordinates' buckets."""
    return tuple(bucket(v, lo, hi, n) for v, (lo, hi), n in zip(observation, bounds, counts, strict=True))


def decay(episode, low, high, coefficient=25):
    """The tutorial's log10 schedule, clipped to [low, high]."""
    return max(low, min(high, 1.0 - math.log10((episode + 1) / coefficient)))


def update(table, state, action, reward, successor, alpha, gamma):
    """The tutorial's update: it bootstraps through the terminal state. Returns max_a Q(s', a)."""
    best = np.amax(table[successor])
    cell = state + (action,)
    table[cell] += alpha * (reward + gamma * best - table[cell])
    return best


def train(seed, max_episodes=5000, success_steps=450, success_streak=50, gamma=0.99):
    """One training; returns (solved, episodes run, environment steps, last table)."""
    rng = random.Random(seed)
    env = gymnasium.make("CartPole-v1")
    env.action_space.seed(seed)
    bounds = state_bounds(env)
    table = np.zeros((*NUM_BUCKETS, NUM_ACTIONS))
    streak = steps = 0
    for episode in range(max_episodes):
        epsilon, alpha = decay(episode, 0.01, 1.0), decay(episode, 0.1, 0.5)
        observation, _ = env.reset(seed=seed if episode == 0 else None)
        state = discretise(observation, bounds)
        step, done = 0, False
        while not done:
            greedy = int(np.argmax(table[state]))
            action = int(env.action_space.sample()) if rng.random() < epsilon else greedy
            observation, reward, terminated, truncated, _ = env.step(action)
            successor = discretise(observation, bounds)
            update(table, state, action, reward, successor, alpha, gamma)
            state, done = successor, terminated or truncated
            step += 1
        steps += step
        streak = streak + 1 if step - 1 >= success_steps else 0  # the tutorial's step counts from 0
        if streak > success_streak:
            return True, episode + 1, steps, table
    return False, max_episodes, steps, table


def _summary(seed):
    start = time.perf_counter()
    solved, episodes, steps, _ = train(seed)
    print(f"seed {seed}: {'solved' if solved else 'not solved'}, {episodes} episodes", file=sys.stderr)
    return {"seed": seed, "solved": solved, "episodes": episodes, "env_steps": steps, "s": time.perf_counter() - start}


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seeds", type=int, default=2000)
    parser.add_argument("--first-seed", type=int, default=0)
    parser.add_argument("--processes", type=int, default=2)
    args = parser.parse_args()
    with multiprocessing.Pool(args.processes) as pool:
        rows = pool.map(_summary, range(args.first_seed, args.first_seed + args.seeds), chunksize=1)
    print(
        json.dumps(
            {
                "made_by": f"python tests/reference/tutorial_tabular.py --seeds {args.seeds}",
                "versions": {
                    "python": platform.python_version(),
                    "numpy": np.__version__,
                    "gymnasium": gymnasium.__version__,
                },
                "solved": [row["solved"] for row in rows],
                "episodes": [row["episodes"] for row in rows],
                "env_steps": [row["env_steps"] for row in rows],
                "steps_per_s": round(sum(row["env_steps"] for row in rows) / sum(row["s"] for row in rows)),
            }
        )
    )


if __name__ == "__main__":
    main()
