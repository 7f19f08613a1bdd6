"""DQN in Gymnasium's LunarLander-v3 by the host loop: the figures and the picture of ``docs/neighbours.md``.

    make lunar-lander

Needs box2d, which has built packages for some machines only; ``benchmarks/peers/requirements-box2d.txt`` names it.
"""

from __future__ import annotations

import argparse
import time
from pathlib import Path
from typing import Any

import numpy as np

from jaxq.interop.gymnasium import Trained, train
from jaxq.pictures.dress import COLORS, dress, save

PICTURE = Path(__file__).parent.parent / "docs" / "neighbours" / "lunar-lander.png"
SETTINGS: dict[str, Any] = {
    "learning_rate": 6e-4,
    "learning_rate_end": 6e-5,
    "gamma": 0.99,
    "loss": "huber",
    "clip": "norm",
    "clip_at": 10.0,
    "tau": 1.0,
    "target_period": 250,
    "hidden": (128, 128),
    "steps_per_update": 1,
    "buffer_size": 100_000,
    "epsilon_decay": 25_000.0,
    "epsilon_end": 0.1,
    "max_env_steps": 300_000,
    "eval_every": 25_000,
    "eval_episodes": 20,
}
#: Episodes of which the picture shows the mean.
WINDOW = 100


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seeds", type=int, default=3)
    trainings = []
    for seed in range(parser.parse_args().seeds):
        began = time.perf_counter()
        one = train("dqn", "LunarLander-v3", seed=seed, **SETTINGS)
        seconds = time.perf_counter() - began
        greedy = "-" if one.eval_returns is None else f"{one.eval_returns.mean():.0f}"
        last = one.episodes.total[-WINDOW:].mean()
        print(
            f"seed {seed}: {one.status} after {one.env_steps:,} env steps and {len(one.episodes.total)} episodes in"
            f" {seconds:.0f} s; last {WINDOW} returns {last:.0f}, greedy {greedy}",
            flush=True,
        )
        trainings.append(one)
    print(save(picture(trainings), PICTURE))


def picture(trainings: list[Trained]) -> Any:
    """The mean of the last 100 returns of each seed, its greedy evaluations, and Gymnasium's threshold."""
    import matplotlib.pyplot as plt

    figure, axes = plt.subplots(figsize=(8, 4.5), layout="constrained")
    for seed, one in enumerate(trainings):
        returns, color = one.episodes.total, COLORS[seed % len(COLORS)]
        mean = np.convolve(returns, np.ones(WINDOW) / WINDOW, "valid")
        axes.plot(one.episodes.env_steps[WINDOW - 1 :], mean, color=color, label=f"seed {seed}")
        axes.plot(*one.curve, "o", color=color, markersize=4)
    axes.axhline(200, color="0.5", linestyle="--", linewidth=1)
    axes.annotate("solved", (0, 200), xytext=(2, 3), textcoords="offset points", color="0.4")
    dress(axes, "DQN in LunarLander-v3", "env steps", f"mean of the last {WINDOW} returns; dots: greedy")
    axes.legend()
    return figure


if __name__ == "__main__":
    main()
