"""The three tables of a sweep, lanes, curves and episodes, as Arrow tables. A value that does not exist is null, never
NaN.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import lru_cache
from typing import Any, get_args, get_origin

import numpy as np
import pyarrow as pa

from jaxq import stats
from jaxq.presets import Training
from jaxq.saved_policy import flatten
from jaxq.settings import Settings, shown
from jaxq.tally import Curve, Result

#: Finished training episodes that ``final_return`` averages.
LAST_EPISODES = 50

#: What became of a lane, after the hyperparameters.
OUTCOMES = {
    "status": pa.string(),
    "episodes": pa.int64(),
    "env_steps": pa.int64(),
    "updates": pa.int64(),
    "solved_at_episode": pa.int64(),
    "solved_at_step": pa.int64(),
    "diverged_at_step": pa.int64(),
    "stopped_at_rung": pa.int64(),
    "final_return": pa.float64(),
    "eval_return": pa.float64(),
    "area_under_curve": pa.float64(),
}
KEY = {"config": pa.int64(), "seed": pa.int64()}
_COUNTS = ("env_steps", "episodes", "updates")
CURVES = pa.schema(KEY | {name: pa.int64() if name in _COUNTS else pa.float64() for name in Curve._fields})
EPISODES = pa.schema(
    KEY
    | {"episode": pa.int64(), "env_steps": pa.int64(), "length": pa.int64(), "return": pa.float64()}
    | {"max_q": pa.float64()}
)


def lanes_schema(settings: Settings) -> pa.Schema:
    """The columns of ``lanes``: every hyperparameter by name, then what became of the lane."""
    hyperparameters = {name: _type(info.annotation) for name, info in settings.fields().items()}
    return pa.schema(KEY | hyperparameters | OUTCOMES)


def lanes(results: Sequence[Result], settings: Sequence[Settings], rung: int | None = None) -> pa.Table:
    """A row per lane that ended; ``settings[config]`` are its hyperparameters. ``rung``: they were stopped there.

    Lanes of a function have what it returned in the place of what became of a training, a column per leaf.
    """
    if not isinstance(settings[results[0].lane.config], Training):
        return _outputs(results, settings)
    rows = []
    for result in results:
        done = result.episodes.total[-LAST_EPISODES:]
        solved, diverged = result.status == "solved", result.status == "diverged"
        episodes = len(result.episodes.total)
        known = np.isfinite(result.curve.train_return)
        rows.append(
            {
                "config": result.lane.config,
                "seed": result.lane.seed,
                **_columns(settings[result.lane.config]),
                "status": result.status,
                "episodes": episodes,
                "env_steps": result.env_steps,
                "updates": result.updates,
                "solved_at_episode": episodes if solved else None,
                "solved_at_step": result.env_steps if solved else None,
                "diverged_at_step": result.env_steps if diverged else None,
                "stopped_at_rung": rung,
                "final_return": _number(done.mean()) if done.size else None,
                "eval_return": None if result.eval_returns is None else _number(result.eval_returns.mean(dtype=float)),
                "area_under_curve": stats.area_under_curve(
                    result.curve.env_steps[known], result.curve.train_return[known], result.env_steps
                ),
            }
        )
    return pa.Table.from_pylist(rows, lanes_schema(settings[0]))


def _outputs(results: Sequence[Result], settings: Sequence[Settings]) -> pa.Table:
    rows = []
    for result in results:
        key = {"config": result.lane.config, "seed": result.lane.seed}
        output = {name: _output(value) for name, value in flatten(result.policy, "result").items()}
        rows.append({**key, **_columns(settings[result.lane.config]), "status": result.status, **output})
    names = dict.fromkeys(name for row in rows for name in row)  # structures may return other things
    return pa.table({name: pa.array([row.get(name) for row in rows]) for name in names})


def _output(value: np.ndarray) -> Any:
    """A leaf as a cell; what is not finite is null."""
    if value.dtype.kind == "f":
        value = np.where(np.isfinite(value), value.astype(object), None)  # type: ignore[call-overload]
    return value.tolist()


def curves(results: Sequence[Result]) -> pa.Table:
    """A row per lane and segment; a lane that was evaluated at its end has that return in its last row."""
    columns = [_lane_columns(results, [len(result.curve.env_steps) for result in results])]
    for name in Curve._fields:
        parts = [getattr(result.curve, name) for result in results]
        if name == "eval_return":
            parts = [_with_last(part, result) for part, result in zip(parts, results, strict=True)]
        columns.append([_array(np.concatenate(parts), CURVES.field(name).type)])
    return pa.Table.from_arrays([column for group in columns for column in group], schema=CURVES)


def episodes(results: Sequence[Result]) -> pa.Table:
    """A row per finished training episode; ``episode`` counts from 0."""
    counts = [len(result.episodes.length) for result in results]
    columns = [*_lane_columns(results, counts), pa.array(np.concatenate([np.arange(n) for n in counts]))]
    for name in ("env_steps", "length", "total", "max_q"):
        kind = EPISODES.field("return" if name == "total" else name).type
        columns.append(_array(np.concatenate([getattr(result.episodes, name) for result in results]), kind))
    return pa.Table.from_arrays(columns, schema=EPISODES)


def with_order(kind: str, columns: Sequence[str]) -> list[str]:
    """The columns, with those that ``in_order`` sorts by."""
    time = {"lanes": [], "curves": ["env_steps"], "episodes": ["episode"]}[kind]
    return list(dict.fromkeys(["config", "seed", *time, *columns]))


def in_order(table: pa.Table) -> pa.Table:
    """Sorted by setting and seed, and in the order of time within a lane."""
    time = [
        name for name in ("episode", "env_steps") if name in table.column_names and "status" not in table.schema.names
    ]
    return table.sort_by([(name, "ascending") for name in ("config", "seed", *time[:1])])


def _lane_columns(results: Sequence[Result], counts: Sequence[int]) -> list[pa.Array]:
    return [
        pa.array(np.repeat(np.array([which(result) for result in results], np.int64), counts))
        for which in (lambda result: result.lane.config, lambda result: result.lane.seed)
    ]


def _with_last(returns: np.ndarray, result: Result) -> np.ndarray:
    if len(returns) and result.eval_returns is not None:
        returns = returns.copy()
        returns[-1] = result.eval_returns.mean(dtype=float)
    return returns


def _array(values: np.ndarray, kind: pa.DataType) -> pa.Array:
    if pa.types.is_integer(kind):
        return pa.array(values.astype(np.int64), kind)
    values = values.astype(float)
    return pa.array(values, kind, mask=~np.isfinite(values))


@lru_cache(maxsize=1024)
def _columns(settings: Settings) -> dict[str, Any]:
    """Every hyperparameter by name. Many lanes share one setting."""
    return {
        name: shown(value) if isinstance(value, tuple) else value.item() if isinstance(value, np.generic) else value
        for name, value in settings.flat().items()
    }


def _type(annotation: Any) -> pa.DataType:
    """The column that holds a hyperparameter of this kind."""
    kinds = {annotation} if get_origin(annotation) is tuple else set(get_args(annotation)) or {annotation}
    for kind, column in ((bool, pa.bool_()), (int, pa.int64()), (float, pa.float64())):
        if kinds <= {kind, type(None)}:
            return column
    return pa.string()  # names, and layer sizes as 128,128


def _number(value: Any) -> float | None:
    value = float(value)
    return value if np.isfinite(value) else None
