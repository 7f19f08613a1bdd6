"""DQN on brax's inverted pendulum, its force cut into five: the curve and the figures of ``docs/neighbours.md``.

python -m benchmarks.brax_pendulum [--seeds 4]
"""

from __future__ import annotations

import argparse
import time
from pathlib import Path

from jaxq import cpu

PICTURE = Path(__file__).parent.parent / "docs" / "neighbours" / "brax.png"
SETTINGS = {"max_env_steps": 100_000, "epsilon_decay": 20_000.0, "eval_episodes": 10, "eval_every": 5_000}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seeds", type=int, default=4)
    seeds = parser.parse_args().seeds
    cpu.tune()
    import jaxq
    from jaxq.interop import brax
    from jaxq.pictures import learning_curves
    from jaxq.pictures.dress import save

    began = time.perf_counter()
    outcome = jaxq.sweep("dqn", env=brax.world("inverted_pendulum", bins=5), seeds=seeds, **SETTINGS)
    for row in sorted(outcome.lanes.to_pylist(), key=lambda row: row["seed"]):
        print(f"seed {row['seed']}: greedy return {row['eval_return']:.0f} after {row['env_steps']:,} env steps")
    print(f"{time.perf_counter() - began:.0f} s")
    figure = learning_curves(outcome.lanes, outcome.curves, {0: "dqn in brax's inverted_pendulum, five forces"})
    print(save(figure, PICTURE))


if __name__ == "__main__":
    main()
