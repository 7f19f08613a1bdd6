"""From settings to a program: the Experiment that a structure makes, and the Hypers that a setting's numbers make.

One structure is one compiled program; everything in Hypers is traced.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import singledispatch
from typing import Any

import numpy as np

from jaxq import networks, success
from jaxq.agents.dqn import DQNHypers, dqn
from jaxq.agents.tabular import TabularHypers, tabular
from jaxq.envs import CartPoleParams, cartpole, discretise, tutorial_edges
from jaxq.experiment import Limits, experiment
from jaxq.presets import NO_LIMIT, DQNSettings, Settings, TabularSettings
from jaxq.types import Agent, Env, Experiment, Hypers


@dataclass(frozen=True)
class Program:
    """An Experiment with what the engine must know of it: the lanes of a group, and the environments of a lane.

    ``width`` is the number of lanes that are vmapped together: on a CPU few enough to stay in cache, on an accelerator
    enough to fill it, the same for one lane and for a hundred thousand.
    """

    experiment: Experiment
    width: int
    num_envs: int


#: Lanes of a group, of table learners and of networks: on a CPU a core has a group, an accelerator has one in all.
TABLES, NETWORKS = {"cpu": 32, "accelerator": 8192}, {"cpu": 4, "accelerator": 256}


def _width(widths: dict[str, int]) -> int:
    import jax

    return widths["cpu" if jax.default_backend() == "cpu" else "accelerator"]


@singledispatch
def program(settings: Settings, impl: str) -> Program:
    """The program of the settings' structure; their numbers play no part."""
    raise TypeError(f"settings: no program for {type(settings).__name__}")


@singledispatch
def hypers(settings: Settings) -> Hypers:
    """The numbers of the settings, as NumPy leaves."""
    raise TypeError(f"settings: no hypers for {type(settings).__name__}")


@program.register
def _(settings: TabularSettings, impl: str) -> Program:
    def make_env(numbers: Any) -> Env:
        params, edges = numbers
        return discretise(cartpole(params), edges)

    def make_agent(numbers: TabularHypers, env: Env) -> Agent:
        return tabular(
            numbers,
            num_states=int(env.num_states or 0),
            num_actions=env.num_actions,
            bootstrap_terminal=settings.bootstrap_terminal,
        )

    made = experiment(make_env, make_agent, success=success.streak(), rounds=4000, impl=impl)
    return Program(made, width=_width(TABLES), num_envs=1)


@hypers.register
def _(settings: TabularSettings) -> Hypers:
    # The tutorial takes these two bounds from Gymnasium's observation space, which is float32; its own two are not.
    high = (
        np.float32(settings.position_bound),
        settings.velocity_bound,
        np.float32(settings.angle_bound),
        settings.angular_velocity_bound,
    )
    edges = tutorial_edges([-bound for bound in high], high, settings.num_buckets)
    params = CartPoleParams(max_episode_steps=settings.max_steps)
    agent = TabularHypers(**{name: getattr(settings, name) for name in TabularHypers._fields})
    limits = Limits(settings.max_episodes, NO_LIMIT, settings.success_steps, settings.success_streak)
    return _as_numpy(Hypers((params, edges), agent, limits))


@program.register
def _(settings: DQNSettings, impl: str) -> Program:
    def make_agent(numbers: DQNHypers, env: Env) -> Agent:
        return dqn(
            numbers,
            network=networks.mlp(settings.hidden, env.num_actions),
            num_actions=env.num_actions,
            batch_size=settings.batch_size,
            buffer_size=settings.buffer_size,
            replacement=settings.replacement,
            double=settings.double,
            loss=settings.loss,
            epsilon_schedule=settings.epsilon_schedule,
            clip=settings.clip,
        )

    rule = success.window_mean(settings.success_window) if settings.success_window else success.never()
    made = experiment(
        cartpole,
        make_agent,
        success=rule,
        rounds=max(1, 256 // (settings.steps_per_update * settings.num_envs)),
        num_envs=settings.num_envs,
        steps_per_round=settings.steps_per_update,
        warm_up_steps=settings.learning_starts,
        impl=impl,
    )
    return Program(made, width=_width(NETWORKS), num_envs=settings.num_envs)


@hypers.register
def _(settings: DQNSettings) -> Hypers:
    per_round = settings.num_envs * settings.steps_per_update
    end = settings.learning_rate if settings.learning_rate_end is None else settings.learning_rate_end
    updates = max(1, (settings.max_env_steps - settings.learning_starts) // per_round)
    given = {name: getattr(settings, name) for name in DQNHypers._fields if hasattr(settings, name)}
    agent = DQNHypers(**{**given, "learning_rate_end": end, "anneal_updates": updates})
    limits = Limits(settings.max_episodes, settings.max_env_steps, settings.success_steps, NO_LIMIT)
    return _as_numpy(Hypers(CartPoleParams(), agent, limits))


def _as_numpy(tree: Hypers) -> Hypers:
    """Every number as the 32-bit scalar that the program is compiled for."""
    import jax

    def leaf(value: Any) -> np.ndarray:
        value = np.asarray(value)
        return value.astype(np.int32 if np.issubdtype(value.dtype, np.integer) else np.float32)

    return jax.tree.map(leaf, tree)
