"""stable-baselines3's DQN learns on our CartPole: ``make interop``.

Prints one JSON line: mean returns of 20 greedy episodes before training and with the best network of it, in our
environment and in Gymnasium's own, and the mean return of random play. The network is the best of those that the
trainer's callback looks at, as its users keep it: from one update to the next its returns go up and down. Run in an
environment of its own (``.venv-peers``).
"""

import json
import sys
import tempfile
import warnings

import gymnasium
import numpy as np
from stable_baselines3 import DQN
from stable_baselines3.common.callbacks import EvalCallback
from stable_baselines3.common.env_checker import check_env
from stable_baselines3.common.evaluation import evaluate_policy

STEPS, LOOKS = 50_000, 10


def main() -> None:
    warnings.filterwarnings("error")
    env, own = gymnasium.make("jaxq.interop.gymnasium:jaxq/CartPole-v1"), gymnasium.make("CartPole-v1")
    check_env(env.unwrapped)
    rng, random = np.random.default_rng(0), []
    for seed in range(100):
        env.reset(seed=seed)
        total, over = 0.0, False
        while not over:
            _, reward, terminated, truncated, _ = env.step(int(rng.integers(2)))
            total, over = total + reward, terminated or truncated
        random.append(total)
    model = DQN(
        "MlpPolicy",
        env,
        learning_rate=2.3e-3,
        batch_size=64,
        buffer_size=100_000,
        learning_starts=1000,
        target_update_interval=10,
        train_freq=256,
        gradient_steps=128,
        exploration_fraction=0.16,
        exploration_final_eps=0.04,
        policy_kwargs={"net_arch": [256, 256]},
        seed=1,
    )
    warnings.filterwarnings("ignore", message="Evaluation environment is not wrapped")
    before = float(evaluate_policy(model, env, 20)[0])
    with tempfile.TemporaryDirectory() as folder:
        watched = gymnasium.make("jaxq/CartPole-v1")
        looks = {"eval_freq": STEPS // LOOKS, "n_eval_episodes": 10, "best_model_save_path": folder}
        model.learn(STEPS, EvalCallback(watched, **looks, verbose=0))
        best = DQN.load(f"{folder}/best_model")
    after, in_gymnasium = (float(evaluate_policy(best, one, 20)[0]) for one in (env, own))
    rows = {"steps": STEPS, "random": float(np.mean(random)), "before": before, "after": after}
    print(json.dumps({**rows, "after_in_gymnasium": in_gymnasium}))
    if after < 5 * rows["random"]:
        sys.exit("stable-baselines3 has not learned")


if __name__ == "__main__":
    main()
