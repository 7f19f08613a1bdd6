"""Presets and their settings: every hyperparameter with its default, its range and its help, in one place.

A *number* is traced, so a sweep over it shares one compiled program; a *structure* changes a shape or the program, so
each distinct combination is compiled once. Imports no jax: the command line answers ``--help`` from here.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any, Literal

from pydantic import BaseModel, ConfigDict, Field, ValidationError, model_validator

from jaxq.suggest import nearest

#: More than any run makes. The int32 counters go past a limit by less than a round, which is a buffer at most (2^24).
NO_LIMIT = 2_000_000_000

Probability = {"ge": 0.0, "le": 1.0}
Scale = {"ge": 1e-6, "le": 1e6}


def number(default: Any, help: str, **allowed: Any) -> Any:
    """A field that is traced."""
    return Field(default, description=help, json_schema_extra={"structure": False}, **allowed)


def structure(default: Any, help: str, **allowed: Any) -> Any:
    """A field that shapes the program."""
    return Field(default, description=help, json_schema_extra={"structure": True}, **allowed)


class Settings(BaseModel):
    """One setting of every hyperparameter; validated, frozen, finite."""

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)

    @classmethod
    def is_structure(cls, name: str) -> bool:
        """Whether the field shapes the program."""
        extra = cls.model_fields[name].json_schema_extra
        return isinstance(extra, dict) and bool(extra["structure"])

    def structural(self) -> tuple[tuple[str, Any], ...]:
        """The fields that shape the program, a key for grouping settings by program."""
        return tuple((name, getattr(self, name)) for name in type(self).model_fields if self.is_structure(name))

    @model_validator(mode="after")
    def _float32(self) -> Settings:
        """Numbers are float32 in the program: too large is infinite there, too small is 0."""
        for name in type(self).model_fields:
            value = getattr(self, name)
            if isinstance(value, float) and value != 0 and not 1e-37 < abs(value) < 1e38:
                zero = "" if any(hasattr(rule, "gt") for rule in type(self).model_fields[name].metadata) else "0, or "
                raise ValueError(f"{name}: {value} is not allowed: {zero}a size from 1e-37 to 1e38")
        return self


class TabularSettings(Settings):
    """Tabular Q-learning on the discretised CartPole, under the tutorial's names."""

    epsilon_min: float = number(0.01, "least exploration rate", **Probability)
    epsilon_max: float = number(1.0, "greatest exploration rate", **Probability)
    alpha_min: float = number(0.1, "least step size", **Probability)
    alpha_max: float = number(0.5, "greatest step size", **Probability)
    decay_coeff: float = number(25.0, "episodes before epsilon and alpha start to fall", gt=0)
    gamma: float = number(0.99, "discount", **Probability)
    initial_value: float = number(0.0, "value of every cell of the table at the start", ge=-1e6, le=1e6)
    max_episodes: int = number(5000, "episodes after which a lane ends", ge=1, le=NO_LIMIT)
    max_steps: int = number(500, "steps after which an episode is truncated", ge=1, le=NO_LIMIT)
    success_steps: int = number(450, "0-based step an episode must reach to count as a success", ge=0, le=NO_LIMIT)
    success_streak: int = number(50, "solved after more than this many successes in a row", ge=0, le=NO_LIMIT)
    position_bound: float = number(4.8, "m: positions are bucketed between minus and plus this", **Scale)
    velocity_bound: float = number(0.5, "m/s: likewise for velocities", **Scale)
    angle_bound: float = number(2 * 12 * 2 * math.pi / 360, "rad: likewise for pole angles", **Scale)
    angular_velocity_bound: float = number(math.radians(50), "rad/s: likewise for pole velocities", **Scale)
    num_buckets: tuple[int, int, int, int] = structure((1, 1, 6, 3), "buckets per coordinate, as 1,1,6,3")
    bootstrap_terminal: bool = structure(False, "bootstrap through the terminal state, as the tutorial's update does")

    @model_validator(mode="after")
    def _ordered(self) -> TabularSettings:
        for low, high in (("epsilon_min", "epsilon_max"), ("alpha_min", "alpha_max")):
            if getattr(self, low) > getattr(self, high):
                raise ValueError(f"{low}: {getattr(self, low)} must not be above {high} ({getattr(self, high)})")
        if min(self.num_buckets) < 1 or math.prod(self.num_buckets) > 2**20:
            raise ValueError(f"num_buckets: {self.num_buckets} must each be at least 1 and multiply to at most 2^20")
        return self


class DQNSettings(Settings):
    """Deep Q-learning on CartPole."""

    learning_rate: float = number(1e-4, "step size of the optimiser at the first update", gt=0)
    learning_rate_end: float | None = number(
        None, "step size at max_env_steps, linear between; the same if unset", ge=0
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
    max_episodes: int = number(600, "episodes after which a lane ends", ge=1, le=NO_LIMIT)
    max_env_steps: int = number(300_000, "env steps after which a lane ends", ge=1, le=NO_LIMIT)
    success_steps: float = number(450.0, "solved when the mean episode length of the window is above this", ge=0)
    success_window: int = structure(50, "episodes of that window; 0 never ends a lane early", ge=0, le=10_000)
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
    settings: Settings
    prng: str = "pcg4d"


_PRESETS = (
    Preset(
        "article-q", "the tutorial's table, at its own settings and semantics", TabularSettings(bootstrap_terminal=True)
    ),
    Preset("q-learning", "the same, with no bootstrap after a termination", TabularSettings()),
    Preset("article-dqn", "the tutorial's DQN, at its own settings", DQNSettings()),
    Preset(
        "dqn",
        "DQN with settings that hold up",
        DQNSettings(
            learning_rate=1e-3,
            learning_rate_end=5e-5,
            tau=1.0,
            target_period=50,
            epsilon_start=1.0,
            epsilon_decay=50_000,
            weight_decay=0.0,
            max_episodes=NO_LIMIT,
            max_env_steps=200_000,
            success_window=0,
            hidden=(120, 84),
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


def preset(name: str) -> Preset:
    """The preset of that name. Raises ValueError for an unknown one, with the nearest."""
    for candidate in _PRESETS:
        if candidate.name == name:
            return candidate
    raise ValueError(f"preset: {name!r} is unknown{nearest(name, [p.name for p in _PRESETS])}")


def settle(base: Preset, **overrides: Any) -> Settings:
    """The preset's settings with some replaced.

    Raises ValueError that names the field, the value and what is allowed.
    """
    kind = type(base.settings)
    for name in overrides:
        if name not in kind.model_fields:
            raise ValueError(f"{name}: {base.name} has no such setting{nearest(name, list(kind.model_fields))}")
    try:
        return kind.model_validate({**base.settings.model_dump(), **overrides})
    except ValidationError as error:
        raise ValueError(_one_line(error)) from None


#: pydantic's words for these would not say what is allowed.
_ALLOWED = {
    "missing": "too few values",
    "too_long": "too many values",
    "bool_parsing": "true or false",
    "int_parsing": "a whole number",
    "int_from_float": "a whole number",
    "float_parsing": "a number",
}


def _one_line(error: ValidationError) -> str:
    first = error.errors(include_url=False)[0]
    if not first["loc"]:
        return first["msg"].removeprefix("Value error, ")
    where = str(first["loc"][0])  # of a tuple pydantic names the part as well, or the first that is not there
    value = first["input"]
    shown = ",".join(map(str, value)) if isinstance(value, tuple) else value if str(value).strip() else repr(value)
    message = _ALLOWED.get(first["type"]) or f"{first['msg'][0].lower()}{first['msg'][1:]}"
    return f"{where}: {shown} is not allowed: {message}"
