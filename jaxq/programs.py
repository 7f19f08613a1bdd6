"""From settings to a program: the Experiment that a structure makes, and the Hypers that a setting's numbers make.

One structure is one compiled program; everything in Hypers is traced.
"""

from __future__ import annotations

import inspect
from collections.abc import Callable
from dataclasses import dataclass
from functools import singledispatch
from typing import Any, NamedTuple

import numpy as np

from jaxq import networks, success, worlds
from jaxq.agents.dqn import DQNHypers, dqn
from jaxq.agents.tabular import TabularHypers, tabular
from jaxq.envs import discretise, registered, tutorial_edges
from jaxq.experiment import experiment
from jaxq.presets import DQNSettings, TabularSettings, Training
from jaxq.rounds import Limits
from jaxq.settings import NO_LIMIT, Settings
from jaxq.table_parts import unfit
from jaxq.types import Agent, Env, Experiment, Hypers
from jaxq.worlds import World


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


#: Of a lane that ends by itself.
NO_LIMITS = Limits(NO_LIMIT, NO_LIMIT, 0, 0)


class Pieces(NamedTuple):
    """What meets in a training, as functions of its numbers."""

    make_env: Callable[[Any], Env]
    make_agent: Callable[[Any, Env], Agent]


class Played(NamedTuple):
    """What it takes to play a policy: the world as it is, as the learner sees it, and the learner."""

    world: Env
    env: Env
    agent: Agent


def played(settings: Training) -> Played:
    """The environment and the learner of one setting."""
    make_env, make_agent = pieces(settings)
    numbers = hypers(settings)
    env = make_env(numbers.env)
    return Played(world_env(settings.env)(world_numbers(settings.env)), env, make_agent(numbers.agent, env))


@singledispatch
def pieces(settings: Settings) -> Pieces:
    """What meets in a training of the settings' structure."""
    raise TypeError(f"settings: no pieces for {type(settings).__name__}")


@singledispatch
def program(settings: Settings, impl: str) -> Program:
    """The program of the settings' structure; their numbers play no part."""
    raise TypeError(f"settings: no program for {type(settings).__name__}")


@singledispatch
def hypers(settings: Settings) -> Hypers:
    """The numbers of the settings, as NumPy leaves."""
    raise TypeError(f"settings: no hypers for {type(settings).__name__}")


@pieces.register
def _(settings: TabularSettings) -> Pieces:
    make_world = world_env(settings.env)

    def make_env(numbers: Any) -> Env:
        of_world, edges = numbers
        env = make_world(of_world)
        if env.num_states is None and env.obs_shape != (len(edges),):
            raise ValueError(
                f"env: {settings.env} has observations of shape {env.obs_shape}, which a table divides between bounds:"
                " give its function .bounds, a low and a high of each"
            )
        return env if env.num_states is not None else discretise(env, edges)

    def make_agent(numbers: TabularHypers, env: Env) -> Agent:
        return tabular(
            numbers,
            num_states=int(env.num_states or 0),
            num_actions=env.num_actions,
            bootstrap_terminal=settings.bootstrap_terminal,
            **{name: getattr(settings, name) for name in inspect.signature(unfit).parameters},
        )

    return Pieces(make_env, make_agent)


@program.register
def _(settings: TabularSettings, impl: str) -> Program:
    made = experiment(
        *pieces(settings),
        success=success_rule(settings),
        rounds=4000,
        eval_episodes=settings.eval_episodes,
        eval_steps=settings.env.eval_steps,
        impl=impl,
    )
    return Program(made, width=_width(TABLES), num_envs=1)


@hypers.register
def _(settings: TabularSettings) -> Hypers:
    low, high = bucket_bounds(settings)
    edges = tutorial_edges(low, high, settings.num_buckets)
    agent = TabularHypers(**{name: getattr(settings, name) for name in TabularHypers._fields})
    return as_numpy(Hypers((world_numbers(settings.env), edges), agent, _limits(settings)))


def bucket_bounds(settings: TabularSettings) -> tuple[list[Any], list[Any]]:
    """The low and high of each coordinate between which the table divides it."""
    if settings.env.bounds is not None:
        return [low for low, _ in settings.env.bounds], [high for _, high in settings.env.bounds]
    # The tutorial takes two of these from Gymnasium's observation space, which is float32; its own two are not.
    high: list[Any] = [
        np.float32(settings.position_bound),
        settings.velocity_bound,
        np.float32(settings.angle_bound),
        settings.angular_velocity_bound,
    ]
    return [-bound for bound in high], high


@pieces.register
def _(settings: DQNSettings) -> Pieces:
    def make_agent(numbers: DQNHypers, env: Env) -> Agent:
        return dqn(
            numbers,
            network=networks.mlp(settings.hidden, env.num_actions, num_states=env.num_states),
            num_actions=env.num_actions,
            batch_size=settings.batch_size,
            buffer_size=settings.buffer_size,
            replacement=settings.replacement,
            double=settings.double,
            loss=settings.loss,
            epsilon_schedule=settings.epsilon_schedule,
            clip=settings.clip,
        )

    return Pieces(world_env(settings.env), make_agent)


@program.register
def _(settings: DQNSettings, impl: str) -> Program:
    made = experiment(
        *pieces(settings),
        success=success_rule(settings),
        rounds=max(1, 256 // (settings.steps_per_update * settings.num_envs)),
        num_envs=settings.num_envs,
        steps_per_round=settings.steps_per_update,
        warm_up_steps=settings.learning_starts,
        eval_episodes=settings.eval_episodes,
        eval_steps=settings.env.eval_steps,
        impl=impl,
    )
    return Program(made, width=_width(NETWORKS), num_envs=settings.num_envs)


@hypers.register
def _(settings: DQNSettings) -> Hypers:
    per_round = settings.num_envs * settings.steps_per_update
    end = settings.learning_rate if settings.learning_rate_end is None else settings.learning_rate_end
    falls = settings.max_env_steps if settings.learning_rate_decay is None else settings.learning_rate_decay
    updates = max(1, (falls - settings.learning_starts) // per_round)
    given = {name: getattr(settings, name) for name in DQNHypers._fields if hasattr(settings, name)}
    agent = DQNHypers(**{**given, "learning_rate_end": end, "anneal_updates": updates})
    return as_numpy(Hypers(world_numbers(settings.env), agent, _limits(settings)))


def world_env(world: World) -> Callable[[Any], Env]:
    """What makes the environment of a world of ``world_numbers``, which may be traced; the world's own play no part.

    It raises ValueError where a user's function makes no ``Env``.
    """
    options = {name: value for name, value in world.flat().items() if world.is_structure(name)}
    if world.factory is None:
        factory, _ = registered(world.id)
        return lambda numbers: factory(numbers, **options)
    return lambda numbers: worlds.made(world, {**numbers, **options})


def world_numbers(world: World) -> Any:
    """A world's numbers, as what ``world_env`` gives takes them."""
    values = {name: value for name, value in world.flat().items() if not world.is_structure(name)}
    if world.factory is not None:
        return values
    _, params = registered(world.id)
    return params(**values)


def success_rule(settings: Training) -> success.Success:
    """What ends a lane of these settings as solved."""
    if settings.stop == "streak":
        return success.streak()
    if settings.stop == "window":
        return success.window_mean(settings.success_window)
    if settings.stop == "gymnasium" and settings.env.reward_threshold is not None:
        return success.mean_return(100, settings.env.reward_threshold)
    return success.never()


def _limits(settings: Training) -> Limits:
    return Limits(settings.max_episodes, settings.max_env_steps, settings.success_steps, settings.success_streak)


def as_numpy(tree: Hypers) -> Hypers:
    """Every number as the 32-bit scalar that the program is compiled for."""
    import jax

    def leaf(value: Any) -> np.ndarray:
        value = np.asarray(value)
        return value.astype(np.int32 if np.issubdtype(value.dtype, np.integer) else np.float32)

    return jax.tree.map(leaf, tree)
