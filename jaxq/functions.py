"""Sweeps of a function of the user's own, with the same groups, cores, resume and tables as trainings.

``jaxq.sweep(fn, rate=[0.1, 0.2], seeds=100)`` calls the pure function ``fn(key, hypers) -> pytree`` once per setting
and seed: ``key`` is the lane's typed key, ``hypers`` a NamedTuple of the values by name. Numbers are traced, float32 or
int32, so they share one program; words, truth values and tuples are plain Python, and each combination of them is
compiled once. What it returns stands in ``lanes``, a column per leaf: numbers as they are, arrays as lists. A lane
whose result is not finite is ``diverged``.
"""

from __future__ import annotations

import keyword
from collections import namedtuple
from collections.abc import Callable, Mapping, Sequence
from typing import Any, ClassVar, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from pydantic import create_model

from jaxq import plans, prng, programs, sources
from jaxq.axes import Range
from jaxq.experiment import Log
from jaxq.plans import Plan
from jaxq.programs import Program
from jaxq.requests import axis, whole
from jaxq.rounds import FINISHED
from jaxq.settings import Settings, changed, number, structure
from jaxq.types import Array, Clock, Experiment, Hypers, Key

#: Lanes of a group, where the caller does not say.
WIDTH = 4
#: Columns of the tables that are no value's and no result's.
COLUMNS = ("config", "seed", "seeds", "status", "diverged")


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
    seed: int = 0,
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
    whole("width", width, 1, 2**20)
    values, settings = _plain({name: axis(value) for name, value in values.items()}), _plain(settings)
    kind = _kind(fn, width, values, settings)
    defaults = kind.model_construct()

    def settled(**point: Any) -> Settings:
        return changed(defaults, point)

    return plans.make(
        getattr(fn, "__name__", type(fn).__name__).strip("<>"),
        settled,
        values,
        seeds=seeds,
        seed=seed,
        prng=prng,
        method=method,
        samples=samples,
        settings=settings,
    )


def _plain(value: Any) -> Any:
    """With Python's numbers where NumPy's stand."""
    if isinstance(value, dict):
        return {name: _plain(one) for name, one in value.items()}
    if isinstance(value, (list, tuple)):
        plain = map(_plain, value)
        return list(plain) if isinstance(value, list) else tuple(plain)
    return value.item() if isinstance(value, np.generic) else value


def _kind(fn: Callable[..., Any], width: int, values: Mapping[str, Any], settings: Any) -> type[FunctionSettings]:
    """A record with a field per value; its defaults are the first values."""
    several = {name: [found] if isinstance(found, Range) else found for name, found in values.items()}
    listed = [one for one in settings if isinstance(one, dict)] if isinstance(settings, (list, tuple)) else []
    for name in dict.fromkeys(name for one in listed for name in one):
        if name not in several and not all(name in one for one in listed):
            raise ValueError(f"{name}: is not a value of every setting")
        several[name] = [*several.get(name, []), *(one[name] for one in listed if name in one)]
    fields: dict[str, Any] = {}
    for name, found in several.items():
        if not name.isidentifier() or keyword.iskeyword(name) or name.startswith("_"):
            raise ValueError(f"{name}: is not allowed as the name of a value")
        if name in COLUMNS or hasattr(FunctionSettings, name):
            raise ValueError(f"{name}: is not allowed as the name of a value: it has another meaning")
        flat = [end for one in found for end in ((one.min, one.max) if isinstance(one, Range) else (one,))]
        annotation = _annotation(name, flat)
        default = (number if annotation in (int, float) else structure)(flat[0] if flat else None, "")
        fields[name] = (annotation, default)
    made: Any = create_model("Values", __base__=FunctionSettings, **fields)
    made.function, made.width, made.source = staticmethod(fn), width, sources.digest(fn)
    return made  # type: ignore[no-any-return]


def _annotation(name: str, values: list[Any]) -> Any:
    """The type of a field that holds all of these values; int and float are traced."""
    kinds = {type(value) for value in values}
    if strange := [value for value in values if not isinstance(value, (bool, int, float, str, tuple, type(None)))]:
        raise ValueError(f"{name}: {strange[0]!r} is not allowed: a number, a truth value, a word or a tuple")
    if {int, float} <= kinds:
        kinds -= {int}
    if len(kinds - {type(None)}) > 1:
        raise ValueError(f"{name}: {', '.join(map(str, values))} are not of one kind")
    kind = next(iter(kinds - {type(None)}), type(None))
    return kind | None if type(None) in kinds else kind


@programs.hypers.register
def _(settings: FunctionSettings) -> Hypers:
    values = {name: value for name, value in settings.flat().items() if not settings.is_structure(name)}
    return programs.as_numpy(Hypers((), values, programs.NO_LIMITS))


@programs.program.register
def _(settings: FunctionSettings, impl: str) -> Program:
    record: Any = namedtuple("Hypers", [*type(settings).model_fields])  # type: ignore[misc]
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
        _check_output(shapes, record._fields)
        clock = Clock(zero, zero, zero, jnp.ones((), jnp.float32))
        empty = Log(*(leaf[:0] if leaf.ndim else leaf for leaf in log()))
        output = jax.tree.map(lambda leaf: jnp.zeros(leaf.shape, leaf.dtype), shapes)
        return FunctionState(words, clock, zero, output), empty

    def advance(state: FunctionState, hypers: Hypers) -> tuple[FunctionState, Log]:
        clock = state.clock._replace(live=jnp.zeros((), jnp.float32))
        return state._replace(
            clock=clock, status=state.status * 0 + FINISHED, output=call(state.key_words, hypers)
        ), log()

    def evaluate(key: Key, policy: Any, hypers: Hypers) -> Array:
        return jnp.zeros((0,))

    made = Experiment(init, advance, evaluate, policy=lambda state, hypers: state.output)
    return Program(made, width=type(settings).width, num_envs=1)


def _check_output(shapes: Any, values: Sequence[str]) -> None:
    """Raises ValueError for a result that no table can hold."""
    leaves = jax.tree.leaves(shapes)
    if not leaves:
        raise ValueError("the function returns nothing: a tree of arrays is needed")
    for leaf in leaves:
        if not any(jnp.issubdtype(leaf.dtype, kind) for kind in (jnp.bool_, jnp.integer, jnp.floating)):
            raise ValueError(f"the function returns an array of {leaf.dtype}: real numbers or truth values are needed")
    alone = ("result",) if shapes is leaves[0] else ()
    names = shapes if isinstance(shapes, dict) else getattr(shapes, "_fields", alone)
    for name in names:
        if name in (*COLUMNS, *values):
            raise ValueError(f"{name}: is returned by the function, but a column of this name is there already")
