"""Rejax's DQN on gymnax's CartPole-v1, seeds in one jitted ``vmap`` on all cores: updates per second, and trainings
until they are solved.

Everything is one compiled program. In the peer's favour nothing is evaluated, and for updates per second the clock runs
over trainings that have started to learn.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping
from typing import Any

PACKAGES = ("rejax", "gymnax", "jax", "jaxlib", "flax", "optax")

#: Updates of a seed, so that those of a bout together make ``BOUT``, as far as that allows.
UPDATES, BOUT = range(32, 1024), 2**12

#: Environment steps between two looks at the episodes of a training, which cannot be stopped from within.
LOOK = 1000

#: How its agent is another in all that is measured.
AGENT = (
    "no AMSGrad, no weight decay, no clipping, which is less work; squared loss; as many environments as ours makes"
    " steps between updates"
)
DIFFERS = (
    f"{AGENT}; it cannot stop from within, so it is trained in pieces of {LOOK:,} env steps, each followed by a look at"
    " its episodes; an episode that is cut at its limit counts as a fall; uniform actions until updates start; seeds"
    " that run together wait for the last one"
)


def prepare(case: str, settings: str) -> Callable[[], float]:
    """``case`` seeds of our ``settings``, as JSON. Units: updates of all seeds together."""
    import jax

    count, numbers = int(case), json.loads(settings)
    period = numbers["steps_per_update"]
    updates = min(max(BOUT // count, UPDATES.start), UPDATES.stop)
    dqn = algorithm(numbers, updates * period)
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


def notes(case: str) -> dict[str, str]:
    """How the work that ``prepare`` measures is another than ours."""
    del case
    return {"differs": AGENT}


def solver(numbers: Mapping[str, Any], is_solved: Callable, together: str = "1") -> Callable[[int], list]:
    """Trainings until they are solved (see ``solve``), ``together`` in one ``vmap`` until the last one is."""
    import jax
    import jax.numpy as jnp
    import numpy as np
    import optax

    count, period = int(together), numbers["steps_per_update"]
    updates = (numbers["max_env_steps"] - numbers["learning_starts"]) // period
    falling = optax.linear_schedule(numbers["learning_rate"], numbers["learning_rate_end"], updates)
    dqn = algorithm(
        {**numbers, "learning_rate": falling},
        LOOK,
        eps_start=numbers["epsilon_start"],
        eps_end=numbers["epsilon_end"],
        exploration_fraction=numbers["epsilon_decay"] / LOOK,
    )

    def piece(state: Any) -> tuple[Any, Any]:
        last = (state.replay_buffer.index + jnp.arange(LOOK)) % numbers["buffer_size"]
        state = dqn.train(train_state=state)[0]
        return state, state.replay_buffer.data.done[last]

    start = jax.jit(jax.vmap(lambda seed: dqn.init_state(jax.random.key(seed))))
    train = jax.jit(jax.vmap(piece), donate_argnums=0)
    jax.block_until_ready(train(start(jnp.arange(count))))  # compiles

    def several(first: int) -> list:
        state = start(first + jnp.arange(count))
        judges = [Judge(is_solved, period) for _ in range(count)]
        for _ in range(-(-numbers["max_env_steps"] // LOOK)):
            state, over = train(state)
            for judge, flags in zip(judges, np.asarray(over), strict=True):
                judge.look(flags)
            if all(judge.solved for judge in judges):
                break
        return [(judge.solved, judge.env_steps) for judge in judges]

    return several


class Judge:
    """Follows the episodes of one training, whose ``num_envs`` environments take turns; stops where it is solved."""

    def __init__(self, is_solved: Callable, num_envs: int):
        self.is_solved, self.num_envs = is_solved, num_envs
        self.env_steps, self.solved = 0, False
        self.lengths: list[int] = []
        self.under_way = [0] * num_envs

    def look(self, over: Any) -> None:
        """The next environment steps: whether an episode ended with each."""
        for ended in over.tolist():
            if self.solved:
                return
            env = self.env_steps % self.num_envs
            self.env_steps += 1
            self.under_way[env] += 1
            if ended:
                self.lengths.append(self.under_way[env])
                self.under_way[env], self.solved = 0, self.is_solved(self.lengths)


def algorithm(numbers: Mapping[str, Any], env_steps: int, **more: Any) -> Any:
    """Their DQN with these numbers, whose ``train`` makes ``env_steps`` more."""
    from flax import linen as nn
    from rejax import get_algo
    from rejax.networks import DiscreteQNetwork, EpsilonGreedyPolicy

    dqn = get_algo("dqn").create(
        env="CartPole-v1",
        # one update follows a step of each environment
        num_envs=numbers["steps_per_update"],
        num_epochs=1,
        buffer_size=numbers["buffer_size"],
        fill_buffer=numbers["learning_starts"],
        batch_size=numbers["batch_size"],
        learning_rate=numbers["learning_rate"],
        gamma=numbers["gamma"],
        polyak=1 - numbers["tau"],
        target_update_freq=numbers["target_period"] * numbers["steps_per_update"],  # theirs counts env steps
        ddqn=numbers["double"],
        total_timesteps=env_steps,
        eval_freq=env_steps,
        skip_initial_evaluation=True,
        **more,
    )
    # ``create`` takes neither layer sizes for a DQN nor an evaluation: they collide with its own.
    network = EpsilonGreedyPolicy(DiscreteQNetwork)
    agent = network(hidden_layer_sizes=tuple(numbers["hidden"]), action_dim=2, activation=nn.relu)
    return dqn.replace(agent=agent, eval_callback=lambda *_: 0.0)
