"""The tutorial's DQN, in PyTorch over Gymnasium: the slow, independent reference.

Run it (in an environment with torch and gymnasium) to remake ``tutorial_dqn.json``, the summary that
``article-dqn`` is compared with:

    python tests/reference/tutorial_dqn.py --seeds 24 --processes 2 > tests/reference/tutorial_dqn.json
"""

import argparse
import collections
import json
import math
import multiprocessing
import platform
import random
import sys
import time

import gymnasium
import torch

Transition = collections.namedtuple("Transition", "state action successor reward")

GAMMA, TAU, LEARNING_RATE = 0.99, 0.005, 1e-4
EPSILON_START, EPSILON_END, EPSILON_DECAY = 0.9, 0.05, 1000
BATCH_SIZE, CAPACITY = 128, 10_000
MAX_EPISODES, SUCCESS_STEPS, WINDOW = 600, 450, 50


def network():
    """4-128-128-2 with ReLU and PyTorch's default initialisation."""
    return torch.nn.Sequential(
        torch.nn.Linear(4, 128),
        torch.nn.ReLU(),
        torch.nn.Linear(128, 128),
        torch.nn.ReLU(),
        torch.nn.Linear(128, 2),
    )


def optimise(online, target, optimiser, memory, rng):
    """One update on a batch drawn without replacement; terminal successors have value 0."""
    batch = Transition(*zip(*rng.sample(memory, BATCH_SIZE), strict=True))
    alive = torch.tensor([s is not None for s in batch.successor], dtype=torch.bool)
    chosen = online(torch.cat(batch.state)).gather(1, torch.cat(batch.action))
    value = torch.zeros(BATCH_SIZE)
    with torch.no_grad():
        value[alive] = target(torch.cat([s for s in batch.successor if s is not None])).max(1).values
    expected = value * GAMMA + torch.cat(batch.reward)
    loss = torch.nn.SmoothL1Loss()(chosen, expected.unsqueeze(1))
    optimiser.zero_grad()
    loss.backward()
    torch.nn.utils.clip_grad_value_(online.parameters(), 100)
    optimiser.step()


def track(online, target):
    """The soft target update, through the state dictionaries as the tutorial does it."""
    kept, fresh = target.state_dict(), online.state_dict()
    for name in fresh:
        kept[name] = fresh[name] * TAU + kept[name] * (1 - TAU)
    target.load_state_dict(kept)


def train(seed, max_episodes=MAX_EPISODES, max_env_steps=None):
    """One training; returns (solved, lengths of all episodes, updates)."""
    torch.manual_seed(seed)
    rng = random.Random(seed)
    env = gymnasium.make("CartPole-v1")
    env.action_space.seed(seed)
    online, target = network(), network()
    target.load_state_dict(online.state_dict())
    optimiser = torch.optim.AdamW(online.parameters(), lr=LEARNING_RATE, amsgrad=True)
    memory = collections.deque(maxlen=CAPACITY)
    lengths, steps, updates = [], 0, 0
    for episode in range(max_episodes):
        observation, _ = env.reset(seed=seed if episode == 0 else None)
        state = torch.tensor(observation, dtype=torch.float32).unsqueeze(0)
        length, done = 0, False
        while not done:
            epsilon = EPSILON_END + (EPSILON_START - EPSILON_END) * math.exp(-steps / EPSILON_DECAY)
            steps += 1
            if rng.random() > epsilon:
                with torch.no_grad():
                    action = online(state).max(1).indices.view(1, 1)
            else:
                action = torch.tensor([[env.action_space.sample()]], dtype=torch.long)
            observation, reward, terminated, truncated, _ = env.step(action.item())
            done = terminated or truncated
            successor = None if terminated else torch.tensor(observation, dtype=torch.float32).unsqueeze(0)
            memory.append(Transition(state, action, successor, torch.tensor([reward])))
            state = successor
            if len(memory) >= BATCH_SIZE:
                optimise(online, target, optimiser, memory, rng)
                updates += 1
            track(online, target)
            length += 1
            if max_env_steps is not None and steps >= max_env_steps:
                return False, lengths, updates
        lengths.append(length)
        if sum(lengths[-WINDOW:]) / WINDOW > SUCCESS_STEPS:
            return True, lengths, updates
    return False, lengths, updates


def _summary(seed):
    torch.set_num_threads(1)
    start = time.perf_counter()
    solved, lengths, updates = train(seed)
    seconds = time.perf_counter() - start
    print(
        f"seed {seed}: solved {solved}, {len(lengths)} episodes, {sum(lengths)} steps, {seconds:.0f} s", file=sys.stderr
    )
    return {
        "seed": seed,
        "solved": solved,
        "episodes": len(lengths),
        "env_steps": sum(lengths),
        "updates": updates,
        "final_return": sum(lengths[-WINDOW:]) / len(lengths[-WINDOW:]),
    }


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seeds", type=int, default=24)
    parser.add_argument("--first-seed", type=int, default=0)
    parser.add_argument("--processes", type=int, default=2)
    args = parser.parse_args()
    with multiprocessing.get_context("spawn").Pool(args.processes) as pool:
        rows = pool.map(_summary, range(args.first_seed, args.first_seed + args.seeds), chunksize=1)
    columns = {name: [row[name] for row in rows] for name in rows[0]}
    versions = {
        "python": platform.python_version(),
        "torch": torch.__version__,
        "gymnasium": gymnasium.__version__,
    }
    print(
        json.dumps(
            {
                "made_by": f"python tests/reference/tutorial_dqn.py --seeds {args.seeds}",
                "versions": versions,
                **columns,
            }
        )
    )


if __name__ == "__main__":
    main()
