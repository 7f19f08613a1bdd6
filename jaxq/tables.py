"""Rows of the three tables, lanes, curves and episodes, and the summary per setting. A value that does not exist is
None, never NaN.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from functools import lru_cache
from typing import Any

import numpy as np

from jaxq import stats
from jaxq.presets import Settings
from jaxq.tally import Curve, Result

Row = dict[str, Any]

#: Finished training episodes that ``final_return`` averages.
LAST_EPISODES = 50


def lane_row(result: Result, settings: Settings) -> Row:
    """One row per lane: every hyperparameter by name, then what became of it."""
    last = result.episodes.total[-LAST_EPISODES:]
    solved, diverged = result.status == "solved", result.status == "diverged"
    episodes = len(result.episodes.total)
    return {
        "config": result.lane.config,
        "seed": result.lane.seed,
        **_columns(settings),
        "status": result.status,
        "episodes": episodes,
        "env_steps": result.env_steps,
        "updates": result.updates,
        "solved_at_episode": episodes if solved else None,
        "solved_at_step": result.env_steps if solved else None,
        "diverged_at_step": result.env_steps if diverged else None,
        "stopped_at_rung": None,
        "final_return": _number(last.mean()) if last.size else None,
        "eval_return": None if result.eval_returns is None else _number(result.eval_returns.mean()),
    }


@lru_cache(maxsize=1024)
def _columns(settings: Settings) -> Row:
    """Every hyperparameter by name. Many lanes share one setting."""
    return {name: _plain(value) for name, value in settings.model_dump().items()}


def curve_rows(result: Result) -> list[Row]:
    """One row per lane and segment."""
    counts = (column.astype(int).tolist() for column in result.curve[:3])
    names = ("config", "seed", *Curve._fields, "eval_return")
    key = result.lane.config, result.lane.seed
    rows: list[Row] = [
        dict(zip(names, (*key, *values, None), strict=True))
        for values in zip(*counts, *map(_numbers, result.curve[3:]), strict=True)
    ]
    if rows and result.eval_returns is not None:
        rows[-1]["eval_return"] = _number(result.eval_returns.mean())
    return rows


def episode_rows(result: Result) -> list[Row]:
    """One row per finished episode; ``episode`` counts from 0."""
    key = {"config": result.lane.config, "seed": result.lane.seed}
    return [
        {
            **key,
            "episode": i,
            "env_steps": int(steps),
            "length": int(length),
            "return": _number(total),
            "max_q": _number(max_q),
        }
        for i, (steps, length, total, max_q) in enumerate(zip(*result.episodes, strict=True))
    ]


def summary(lanes: Iterable[Row], varied: Sequence[str]) -> list[Row]:
    """One row per setting, in the order of ``config``: what varied, and statistics over its seeds.

    Diverged lanes are counted, take part in the solved share and in the times to success, and have no return.
    """
    by_config: dict[int, list[Row]] = {}
    for row in lanes:
        by_config.setdefault(row["config"], []).append(row)
    return [_setting(config, rows, varied) for config, rows in sorted(by_config.items())]


def _setting(config: int, rows: list[Row], varied: Sequence[str]) -> Row:
    one = len(rows) == 1
    successes = sum(row["status"] == "solved" for row in rows)
    solved = stats.Estimate(float(successes), None, None) if one else stats.share(successes, len(rows))
    if rows[0].get("success_window") == 0:  # nobody looks for success: none is not a share of 0
        solved = stats.Estimate(None, None, None)
    kept = [row for row in rows if row["status"] != "diverged"]
    final = stats.interquartile_mean([row["final_return"] for row in kept if row["final_return"] is not None])
    greedy = stats.interquartile_mean([row["eval_return"] for row in kept if row["eval_return"] is not None])
    return {
        "config": config,
        **{name: rows[0][name] for name in varied},
        "seeds": len(rows),
        "solved": solved.value,
        "solved_low": solved.low,
        "solved_high": solved.high,
        "median_episodes": stats.median_time([row["solved_at_episode"] for row in rows]),
        "median_env_steps": stats.median_time([row["solved_at_step"] for row in rows]),
        "final_return": final.value,
        "final_return_low": final.low,
        "final_return_high": final.high,
        "eval_return": greedy.value,
        "eval_return_low": greedy.low,
        "eval_return_high": greedy.high,
        "diverged": sum(row["status"] == "diverged" for row in rows),
    }


def _number(value: Any) -> float | None:
    value = float(value)
    return value if math.isfinite(value) else None


def _numbers(column: np.ndarray) -> list[float | None]:
    values: list[float | None] = column.tolist()
    for i in np.flatnonzero(~np.isfinite(column)).tolist():
        values[i] = None
    return values


def _plain(value: Any) -> Any:
    """A structural value as what JSON and Parquet hold."""
    if isinstance(value, tuple):
        return ",".join(str(part) for part in value)
    return value.item() if isinstance(value, np.generic) else value
