"""Sweeps of a function of the user's own, with the same groups, cores, resume and tables as trainings.

``jaxq.sweep(fn, rate=[0.1, 0.2], seeds=100)`` calls the pure function ``fn(key, hypers) -> pytree`` once per setting
and seed: ``key`` is the lane's typed key, ``hypers`` a NamedTuple of the values by name. Numbers are traced, float32 or
int32, so they share one program; words, truth values and tuples are plain Python, and each combination of them is
compiled once. What it returns stands in ``lanes``, a column per leaf: numbers as they are, arrays as lists. A lane whose
result is not finite is ``diverged``.
"""

from __future__ import annotations

from collections import namedtuple
from collections.abc import Callable, Mapping, Sequence
from typing import Any, ClassVar, NamedTuple

import jax
import jax.numpy as jnp
from pydantic import create_model

from jaxq import plans, prng, programs, worlds
from jaxq.experiment import FINISHED, Log
from jaxq.plans import Plan
from jaxq.programs import Program
from jaxq.settings import Settings, changed, number, structure
from jaxq.types import Array, Clock, Experiment, Hypers, Key

#: Lanes of a group, where the caller does not say.
WIDTH = 4


class FunctionSettings(Settings):
    """One setting of a function's values."""

    function: ClassVar[Callable[..., Any]]
    source: ClassVar[str | None]
    width: ClassVar[int]

    def identity(self) -> Any:
        """The function itself: two may have one name."""
        return type(self).function


class FunctionState(NamedTuple):
    """A lane before and after its only segment."""

    key_words: Array
    clock: Clock
    status: Array
    output: Any


def plan(
    fn: Callable[..., Any],
    *,
    seeds: int = 1,
    root_seed: int = 0,
    prng: str = "threefry",
    method: str | None = None,
    samples: int | None = None,
    settings: Sequence[Mapping[str, Any]] | None = None,
    width: int = WIDTH,
    **values: Any,
) -> Plan:
    """The plan of a function: ``values`` as for ``jaxq.plan``, any name that the function reads. ``width`` lanes run
    together on a core.

    Raises ValueError that names the field, the value and what is allowed.
    """
    if isinstance(width, bool) or not isinstance(width, int) or not 1 <= width <= 2**20:
        raise ValueError(f"width: {width!r} is not allowed: an integer from 1 to {2**20}")
    kind = _kind(fn, width, values, settings)
    known = set(kind.model_fields)

    def settled(**point: Any) -> Settings:
        for name in point:
            if name not in known:
                raise ValueError(f"{name}: is not a value of every setting")
        return changed(kind(), point)

    return plans.make(
        getattr(fn, "__name__", type(fn).__name__).strip("<>"),
        settled,
        values,
        seeds=seeds,
        root_seed=root_seed,
        prng=prng,
        method=method,
        samples=samples,
        settings=settings,
    )


def _kind(fn: Callable[..., Any], width: int, values: Mapping[str, Any], settings: Any) -> type[FunctionSettings]:
    """A record with a field per value; its defaults are the first values."""
    fields: dict[str, Any] = {}
    firsts = {**dict((settings or [{}])[0]), **values}
    for name, value in firsts.items():
        first = value[0] if isinstance(value, list) and value else value
        first = first.min if isinstance(first, plans.Range) else first
        several = value if isinstance(value, list) else [value]
        real = any(isinstance(one, float) or isinstance(getattr(one, "min", None), float) for one in several)
        traced = isinstance(first, (int, float)) and not isinstance(first, bool)
        annotation = (float if real else int) if traced else tuple if isinstance(first, tuple) else type(first)
        fields[name] = (annotation, (number if traced else structure)(first, ""))
    made: Any = create_model("Values", __base__=FunctionSettings, **fields)
    made.function, made.width, made.source = staticmethod(fn), width, worlds.source_of(fn)
    return made  # type: ignore[no-any-return]


@programs.hypers.register
def _(settings: FunctionSettings) -> Hypers:
    values = {name: value for name, value in settings.flat().items() if not settings.is_structure(name)}
    return programs.as_numpy(Hypers((), values, programs.NO_LIMITS))


@programs.program.register
def _(settings: FunctionSettings, impl: str) -> Program:
    record: Any = namedtuple("Hypers", list(type(settings).model_fields))  # noqa: PYI024
    fixed = {name: value for name, value in settings.flat().items() if settings.is_structure(name)}
    fn = type(settings).function

    def call(words: Array, hypers: Hypers) -> Any:
        return fn(prng.wrap(words, impl), record(**fixed, **hypers.agent))

    def log() -> Log:
        none = jnp.full((1,), jnp.nan)
        return Log(jnp.zeros((1, 1, 1), bool), jnp.zeros((1, 1, 1)), none, none, jnp.zeros(()))

    def init(key: Key, hypers: Hypers) -> tuple[FunctionState, Log]:
        words, zero = jax.random.key_data(key), jnp.zeros((), jnp.int32)
        shapes = jax.eval_shape(call, words, hypers)
        clock = Clock(zero, zero, zero, jnp.ones((), jnp.float32))
        empty = Log(*(leaf[:0] if leaf.ndim else leaf for leaf in log()))
        output = jax.tree.map(lambda leaf: jnp.zeros(leaf.shape, leaf.dtype), shapes)
        return FunctionState(words, clock, zero, output), empty

    def advance(state: FunctionState, hypers: Hypers) -> tuple[FunctionState, Log]:
        clock = state.clock._replace(live=jnp.zeros((), jnp.float32))
        return state._replace(clock=clock, status=state.status * 0 + FINISHED, output=call(state.key_words, hypers)), log()

    def evaluate(key: Key, policy: Any, hypers: Hypers) -> Array:
        return jnp.zeros((0,))

    made = Experiment(init, advance, evaluate, policy=lambda state, hypers: state.output)
    return Program(made, width=type(settings).width, num_envs=1)
