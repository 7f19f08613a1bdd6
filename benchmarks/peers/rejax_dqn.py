"""Rejax's DQN on gymnax's CartPole-v1, all seeds in one jitted ``vmap``: updates per second, on all cores.

Everything is one compiled program. In the peer's favour nothing is evaluated, double Q-learning is off, and the clock
runs over trainings that have started to learn.
"""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path

PACKAGES = ("rejax", "gymnax", "jax", "jaxlib", "flax", "optax")

SETTINGS = Path(__file__).with_name("dqn_settings.json")

#: Updates of a seed, so that those of a bout together make ``BOUT``, as far as that allows.
UPDATES, BOUT = range(32, 1024), 2**12


def prepare(case: str, setting: str = "article") -> Callable[[], float]:
    """``case`` seeds of ``setting`` (a name in dqn_settings.json). Units: updates of all seeds together."""
    import jax
    from flax import linen as nn
    from rejax import get_algo
    from rejax.networks import DiscreteQNetwork, EpsilonGreedyPolicy

    count, numbers = int(case), json.loads(SETTINGS.read_text())[setting]
    period = numbers["steps_per_update"]
    updates = min(max(BOUT // count, UPDATES.start), UPDATES.stop)
    dqn = get_algo("dqn").create(
        env="CartPole-v1",
        # one update follows a step of each environment
        num_envs=period,
        num_epochs=1,
        ddqn=False,
        buffer_size=numbers["capacity"],
        fill_buffer=numbers["learning_starts"],
        batch_size=numbers["batch_size"],
        learning_rate=numbers["learning_rate"],
        gamma=numbers["gamma"],
        polyak=1 - numbers["tau"],
        target_update_freq=numbers["target_period"],
        total_timesteps=updates * period,
        eval_freq=updates * period,
        skip_initial_evaluation=True,
    )
    # ``create`` takes neither layer sizes for a DQN nor an evaluation: they collide with its own.
    network = EpsilonGreedyPolicy(DiscreteQNetwork)
    agent = network(hidden_layer_sizes=tuple(numbers["hidden"]), action_dim=2, activation=nn.relu)
    dqn = dqn.replace(agent=agent, eval_callback=lambda *_: 0.0)
    train = jax.jit(jax.vmap(lambda state: dqn.train(train_state=state)[0]), donate_argnums=0)
    state = jax.jit(jax.vmap(dqn.init_state))(jax.random.split(jax.random.key(0), count))
    done = 0

    def bout() -> float:
        nonlocal state, done
        before = done
        state = jax.block_until_ready(train(state))
        done = int(state.q_ts.step.sum())
        return float(done - before)

    while not bout():  # the replay is filled first
        pass
    return bout
