"""brax's PPO trainer on our CartPole: the figures of ``docs/neighbours.md``.

python -m benchmarks.brax_ppo
"""

from __future__ import annotations

import contextlib
import functools
import io
import time
import warnings

from jaxq import cpu

cpu.tune()

from jaxq import envs  # noqa: E402
from jaxq.interop import brax  # noqa: E402

STEPS = 1_000_000


def main() -> None:
    with warnings.catch_warnings(), contextlib.redirect_stdout(io.StringIO()):
        warnings.simplefilter("ignore")
        from brax.training.agents.ppo import networks

    began = time.perf_counter()

    def told(env_steps: int, metrics: dict[str, float]) -> None:
        returned, seconds = float(metrics["eval/episode_reward"]), time.perf_counter() - began
        print(f"{env_steps:>9,} env steps, {seconds:3.0f} s: mean return {returned:.0f}", flush=True)

    sizes = {"policy_hidden_layer_sizes": (32, 32), "value_hidden_layer_sizes": (32, 32)}
    brax.ppo(
        envs.make("CartPole-v1"),
        num_timesteps=STEPS,
        num_envs=64,
        episode_length=500,
        unroll_length=32,
        batch_size=64,
        num_minibatches=8,
        num_updates_per_batch=4,
        learning_rate=1e-3,
        entropy_cost=0.01,
        discounting=0.99,
        normalize_observations=True,
        num_evals=6,
        num_eval_envs=64,
        network_factory=functools.partial(networks.make_ppo_networks, **sizes),
        progress_fn=told,
    )


if __name__ == "__main__":
    main()
