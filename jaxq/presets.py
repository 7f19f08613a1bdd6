"""Presets: every hyperparameter of the learners with its default, its range and its help, in one place.

A *number* is traced, so a sweep over it shares one compiled program; a *structure* changes a shape or the program, so
each distinct combination is compiled once. Imports no jax: the command line answers ``--help`` from here.
"""

from __future__ import annotations

import inspect
import math
from dataclasses import dataclass
from typing import Any, Literal

from pydantic import SerializeAsAny, model_validator

from jaxq import worlds
from jaxq.settings import NO_LIMIT, Settings, changed, number, structure
from jaxq.suggest import nearest
from jaxq.table_parts import StepSizeBy, Target, TraceKind, unfit
from jaxq.worlds import World

Probability = {"ge": 0.0, "le": 1.0}
Scale = {"ge": 1e-6, "le": 1e6}
#: Whole numbers up to here are exact in float32.
EXACT = 2**24


class Training(Settings):
    """What every learner's training has: a world, an end, a rule of success, an evaluation."""

    env: SerializeAsAny[World] = structure(worlds.CartPole(), "environment")
    max_episodes: int = number(NO_LIMIT, "episodes after which a lane ends", ge=1, le=NO_LIMIT)
    max_env_steps: int = number(NO_LIMIT, "env steps after which a lane ends", ge=1, le=NO_LIMIT)
    stop: Literal["streak", "window", "gymnasium", "none"] = structure(
        "none",
        "what ends a lane as solved: a streak of long episodes, the mean length of a window of them, Gymnasium's mean"
        " return of 100 episodes at the environment's threshold, or nothing",
    )
    success_steps: float = number(
        450.0,
        "streak: 0-based step that an episode must reach; window: mean length that must be passed",
        ge=0,
        le=EXACT,
    )
    success_streak: int = number(50, "streak: solved after more than this many in a row", ge=0, le=NO_LIMIT)
    success_window: int = structure(50, "window: so many last episodes", ge=1, le=10_000)
    eval_episodes: int = structure(10, "whole greedy episodes of an evaluation", ge=1, le=100_000)
    eval_every: int = number(
        0, "env steps between two evaluations while training; 0 evaluates at the end alone", ge=0, le=NO_LIMIT
    )

    @model_validator(mode="after")
    def _has_threshold(self) -> Training:
        if self.stop == "gymnasium" and self.env.reward_threshold is None:
            raise ValueError(f"stop: gymnasium is not allowed: {self.env} has no reward threshold")
        return self


#: Fields that say between which bounds a table divides CartPole's observations; other worlds say so themselves.
CARTPOLE_BOUNDS = ("position_bound", "velocity_bound", "angle_bound", "angular_velocity_bound")


class TabularSettings(Training):
    """A learner with a table, on CartPole discretised under the tutorial's names, and on other environments; its parts
    are those of ``table_parts``."""

    epsilon_min: float = number(0.01, "least exploration rate", **Probability)
    epsilon_max: float = number(1.0, "greatest exploration rate", **Probability)
    alpha_min: float = number(0.1, "least step size", **Probability)
    alpha_max: float = number(0.5, "greatest step size", **Probability)
    decay_coeff: float = number(25.0, "episodes before epsilon and alpha start to fall", gt=0)
    gamma: float = number(0.99, "discount", **Probability)
    initial_value: float = number(0.0, "value of every cell at the start; a high one is optimism", ge=-1e6, le=1e6)
    trace_decay: float = number(0.0, "lambda: how much of what follows reaches back, with traces", **Probability)
    visit_power: float = number(
        1.0, "with step_size visits the step size is alpha_max / visits^this, at least alpha_min", **Probability
    )
    position_bound: float = number(4.8, "m: positions are bucketed between minus and plus this", **Scale)
    velocity_bound: float = number(0.5, "m/s: likewise for velocities", **Scale)
    angle_bound: float = number(2 * 12 * 2 * math.pi / 360, "rad: likewise for pole angles", **Scale)
    angular_velocity_bound: float = number(math.radians(50), "rad/s: likewise for pole velocities", **Scale)
    num_buckets: tuple[int, ...] = structure(
        (1, 1, 6, 3), "buckets per coordinate, as 1,1,6,3; other environments have other ones"
    )
    target: Target = structure(
        "greedy", "what a transition bootstraps from: the greedy value, the next action's, or the expected one"
    )
    double: bool = structure(False, "two tables: one selects or learns, the other values")
    n_steps: int = structure(1, "rewards before the bootstrap", ge=1, le=1000)
    traces: TraceKind = structure("none", "eligibility traces")
    offline: bool = structure(False, "gather increments in traces and apply them where the episode is cut")
    planning_steps: int = structure(0, "updates from a learned model after each step (Dyna-Q)", ge=0, le=1000)
    model_outcomes: int = structure(1, "last outcomes that the model keeps of each state and action", ge=1, le=1000)
    step_size: StepSizeBy = structure("episodes", "what step sizes follow: the tutorial's episodes, or a cell's visits")
    bootstrap_terminal: bool = structure(False, "bootstrap through the terminal state, as the tutorial's update does")

    @model_validator(mode="after")
    def _together(self) -> TabularSettings:
        parts = inspect.signature(unfit).parameters
        if wrong := unfit(**{name: getattr(self, name) for name in parts}):
            raise ValueError(wrong)
        return self

    @model_validator(mode="after")
    def _ordered(self) -> TabularSettings:
        for low, high in (("epsilon_min", "epsilon_max"), ("alpha_min", "alpha_max")):
            if getattr(self, low) > getattr(self, high):
                raise ValueError(f"{low}: {getattr(self, low)} must not be above {high} ({getattr(self, high)})")
        if len(self.num_buckets) != (wanted := 4 if self.env.bounds is None else len(self.env.bounds)):
            few = "few" if len(self.num_buckets) < wanted else "many"
            shown = ",".join(map(str, self.num_buckets))
            raise ValueError(f"num_buckets: {shown} is not allowed: too {few} values, {self.env} has {wanted}")
        if min(self.num_buckets) < 1 or math.prod(self.num_buckets) > 2**20:
            raise ValueError(f"num_buckets: {self.num_buckets} must each be at least 1 and multiply to at most 2^20")
        return self


class DQNSettings(Training):
    """Deep Q-learning on CartPole."""

    learning_rate: float = number(1e-4, "step size of the optimiser at the first update", gt=0)
    learning_rate_end: float | None = number(
        None, "step size after learning_rate_decay, linear between; the same if unset", ge=0
    )
    learning_rate_decay: int | None = number(
        None, "env steps over which the step size falls; max_env_steps if unset", ge=1, le=NO_LIMIT
    )
    gamma: float = number(0.99, "discount", **Probability)
    tau: float = number(0.005, "share of the online network that a target update takes", **Probability)
    target_period: int = number(1, "updates between two target updates", ge=1, le=NO_LIMIT)
    epsilon_start: float = number(0.9, "exploration rate at step 0", **Probability)
    epsilon_end: float = number(0.05, "exploration rate in the end", **Probability)
    epsilon_decay: float = number(1000.0, "env steps: scale (exponential) or length (linear) of its fall", gt=0)
    weight_decay: float = number(0.01, "decoupled weight decay of AdamW", ge=0)
    huber_delta: float = number(1.0, "TD error beyond which the Huber loss is linear", gt=0)
    clip_at: float = number(100.0, "bound of the gradient's values or of its global norm", gt=0)
    hidden: tuple[int, ...] = structure((128, 128), "units of the hidden layers, as 128,128; none for a linear network")
    batch_size: int = structure(128, "transitions of a minibatch", ge=1, le=2**20)
    buffer_size: int = structure(10_000, "transitions that the replay keeps", ge=1, le=2**24)
    learning_starts: int = structure(128, "transitions stored when updates start", ge=1, le=2**24)
    num_envs: int = structure(1, "environments of a lane", ge=1, le=2**16)
    steps_per_update: int = structure(1, "steps of each environment between two updates", ge=1, le=2**16)
    double: bool = structure(False, "the online network selects, the target network values")
    loss: Literal["huber", "squared"] = structure("huber", "loss of the TD error")
    epsilon_schedule: Literal["exponential", "linear"] = structure("exponential", "shape of epsilon's fall")
    clip: Literal["value", "norm", "none"] = structure("value", "how the gradient is clipped")
    replacement: bool = structure(False, "draw minibatches with replacement")

    @model_validator(mode="after")
    def _fits(self) -> DQNSettings:
        if not all(1 <= units <= 2**16 for units in self.hidden):
            raise ValueError(f"hidden: {self.hidden} must each be from 1 to {2**16}")
        if self.learning_starts > self.buffer_size:
            raise ValueError(
                f"learning_starts: {self.learning_starts} must not be above buffer_size ({self.buffer_size})"
            )
        if self.batch_size > self.buffer_size:
            raise ValueError(f"batch_size: {self.batch_size} must not be above buffer_size ({self.buffer_size})")
        if not self.replacement and self.batch_size > self.learning_starts:
            raise ValueError(
                f"batch_size: {self.batch_size} must not be above learning_starts ({self.learning_starts})"
                " when drawn without replacement"
            )
        if self.num_envs * self.steps_per_update > self.buffer_size:
            raise ValueError(
                f"num_envs x steps_per_update: {self.num_envs * self.steps_per_update} must not be above"
                f" buffer_size ({self.buffer_size})"
            )
        return self


@dataclass(frozen=True)
class Preset:
    """A name for settings that belong together; the instance holds the defaults."""

    name: str
    summary: str
    settings: Training
    prng: str = "pcg4d"


_TUTORIAL_Q: dict[str, Any] = {"max_episodes": 5000, "stop": "streak"}
#: Discretised, CartPole has many outcomes of one action: planning with the last of them needs step sizes that fall.
_DYNA: dict[str, Any] = {"step_size": "visits", "visit_power": 0.6, "alpha_max": 1.0, "alpha_min": 0.0}
_MONTE_CARLO: dict[str, Any] = {
    "traces": "accumulating",
    "trace_decay": 1.0,
    "offline": True,
    "step_size": "visits",
    "alpha_max": 1.0,
    "alpha_min": 0.0,
}


def _table(name: str, summary: str, **parts: Any) -> Preset:
    return Preset(name, summary, TabularSettings(**_TUTORIAL_Q, **parts))


_PRESETS = (
    Preset(
        "article-q",
        "the tutorial's table, at its own settings and semantics",
        TabularSettings(**_TUTORIAL_Q, bootstrap_terminal=True),
    ),
    Preset("q-learning", "the same, with no bootstrap after a termination", TabularSettings(**_TUTORIAL_Q)),
    _table("sarsa", "the value of the action that is taken next", target="sarsa"),
    _table("expected-sarsa", "the expected value of the policy that acts", target="expected"),
    _table("double-q-learning", "two tables: one selects, the other values", double=True),
    _table("n-step-q-learning", "four rewards before the bootstrap", n_steps=4),
    _table("q-lambda", "Watkins's Q(lambda), replacing traces", traces="replacing", trace_decay=0.5),
    _table("sarsa-lambda", "SARSA(lambda), replacing traces", target="sarsa", traces="replacing", trace_decay=0.5),
    _table("dyna-q", "Q-learning with five updates from a learned model after each step", planning_steps=5, **_DYNA),
    _table("monte-carlo", "the mean of all returns, learned where an episode ends", target="sarsa", **_MONTE_CARLO),
    Preset(
        "article-dqn",
        "the tutorial's DQN, at its own settings",
        DQNSettings(max_episodes=600, max_env_steps=300_000, stop="window"),
    ),
    Preset(
        "dqn",
        "double DQN with the settings that benchmarks/tuning found",
        DQNSettings(
            learning_rate=1.5e-3,
            learning_rate_end=1e-5,
            gamma=0.988,
            tau=0.0065,
            epsilon_start=1.0,
            epsilon_decay=42_000,
            weight_decay=0.0,
            max_env_steps=200_000,
            stop="gymnasium",
            eval_episodes=100,
            hidden=(120, 84),
            buffer_size=50_000,
            learning_starts=1000,
            steps_per_update=4,
            double=True,
            loss="squared",
            epsilon_schedule="linear",
            clip="none",
        ),
    ),
)


def presets() -> tuple[Preset, ...]:
    """All presets, in the order in which they are listed."""
    return _PRESETS


def listed() -> str:
    """A line per preset: its name and what it is."""
    width = max(len(p.name) for p in _PRESETS) + 2
    return "\n".join(f"  {p.name:{width}}{p.summary}" for p in _PRESETS)


def preset(name: str) -> Preset:
    """The preset of that name. Raises ValueError for an unknown one, with the nearest."""
    for candidate in _PRESETS:
        if candidate.name == name:
            return candidate
    raise ValueError(f"preset: {name!r} is unknown{nearest(str(name), [p.name for p in _PRESETS])}")


def settle(base: Preset, **overrides: Any) -> Any:
    """The preset's settings with some replaced; ``env`` is a world's name or the user's own function of numbers, and
    ``env.length`` one of its numbers. Where that has no reward threshold, a preset's own stop rule that needs one gives
    way to none.

    Raises ValueError that names the field, the value and what is allowed.
    """
    settings = base.settings
    env = worlds.world(overrides.pop("env", settings.env))
    known = [*type(settings).model_fields, *(f"env.{name}" for name in type(env).model_fields)]
    for name in overrides:
        if name not in known:
            raise ValueError(f"{name}: {base.name} has no such setting{nearest(name, known)}")
    numbers = {name.removeprefix("env."): overrides.pop(name) for name in list(overrides) if name.startswith("env.")}
    return changed(settings, {**_suited(settings, env, overrides), "env": changed(env, numbers, prefix="env.")})


def _suited(settings: Training, env: World, overrides: dict[str, Any]) -> dict[str, Any]:
    """The overrides, with what a preset for CartPole must be otherwise in another environment."""
    suited: dict[str, Any] = {}
    known = env.factory is None and env.id != worlds.CartPole.id
    if known and settings.stop in ("streak", "window"):  # how long an episode is tells of success in CartPole alone
        suited["stop"] = "gymnasium" if env.reward_threshold is not None else "none"
    if settings.stop == "gymnasium" and env.reward_threshold is None:
        suited["stop"] = "none"
    if isinstance(settings, TabularSettings) and env.bounds is not None:
        suited["num_buckets"] = env.buckets or (10,) * len(env.bounds)
        for name in CARTPOLE_BOUNDS:
            if overrides.get(name, kept := getattr(settings, name)) != kept:
                raise ValueError(f"{name}: {overrides[name]} is not allowed: {env} has bounds of its own")
    return {**suited, **overrides}
