"""The summary of a sweep: a row per setting, with statistics over its seeds."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import pyarrow as pa

from jaxq import stats
from jaxq.settings import NO_LIMIT
from jaxq.stats import Estimate
from jaxq.suggest import nearest

Row = dict[str, Any]
NONE = Estimate(None, None, None)


def summary(lanes: pa.Table, varied: Sequence[str], threshold: float | None = None) -> list[Row]:
    """One row per setting, in the order of ``config``: what varied, and statistics over its seeds, each with the ends
    of its 95 % interval as ``_low`` and ``_high``, which are None with one seed.

    ``solved`` is the share of lanes that the stop rule ended, of those that no rung stopped, since of these nobody
    knows, and None where a rung stopped all; ``reached`` the share of lanes whose greedy return is at least
    ``threshold``; ``median_episodes`` and ``median_env_steps`` are Kaplan-Meier medians of the time until solved;
    ``final_return`` (training), ``eval_return`` (greedy) and ``area_under_curve`` are interquartile means. Diverged
    lanes are counted, take part in the shares and times, and have no return. ``stopped`` lanes have the returns that
    they had then, at ``stopped_at_rung``, which is None for a setting that went to the end.
    """
    if not len(lanes):
        return []
    if outputs(lanes) is not None:
        return _of_outputs(lanes, varied)
    columns = {name: lanes[name] for name in lanes.column_names}
    config = columns["config"].to_numpy()
    order = np.argsort(config, kind="stable")
    settings, begins = np.unique(config[order], return_index=True)
    data = {name: _values(columns[name]) for name in _READ}
    rows = []
    for setting, picked in zip(settings.tolist(), np.split(order, begins[1:]), strict=True):
        mine = {name: values[picked] for name, values in data.items()}
        first = {name: columns[name][int(picked[0])].as_py() for name in varied}
        rows.append({"config": setting, **first, **_setting(mine, threshold)})
    return rows


def _of_outputs(lanes: pa.Table, varied: Sequence[str]) -> list[Row]:
    """Of a function's lanes: the interquartile mean of each number that it returned."""
    config = lanes["config"].to_numpy()
    rows = []
    for setting in np.unique(config).tolist():
        mine = lanes.filter(pa.array(config == setting))
        row: Row = {"config": setting, **{name: mine[name][0].as_py() for name in varied}, "seeds": len(mine)}
        for name in outputs(lanes) or ():
            row |= _named(name, stats.interquartile_mean(_values(mine[name].drop_null()).tolist()))
        rows.append(row | {"diverged": mine["status"].to_pylist().count("diverged")})
    return rows


def outputs(lanes: pa.Table) -> list[str] | None:
    """The numbers that a function of the user's own returned, by name; None for lanes of trainings."""
    names = lanes.column_names
    if "stopped_at_rung" in names or "status" not in names:
        return None
    return [name for name in names[names.index("status") + 1 :] if is_number(lanes[name].type)]


def is_number(kind: pa.DataType) -> bool:
    """Whether a column holds a number, or a truth value, per row."""
    return bool(pa.types.is_integer(kind) or pa.types.is_floating(kind) or pa.types.is_boolean(kind))


def best(rows: Sequence[Row], metric: str | None = None) -> Row:
    """The row of the setting whose ``metric`` is greatest, by default the greedy return, or the first number that a
    function returned; of equals, and with halving, see ``ranked``.

    Raises ValueError where a setting has one seed, which ranks nothing, and where no setting has the metric.
    """
    if any(row["seeds"] == 1 for row in rows):
        raise ValueError("seeds: one seed ranks no settings; train at least two")
    metrics = metrics_of(rows)
    if not metrics:
        raise ValueError("metric: no setting has a number to be ranked by")
    metric = metrics[0] if metric is None else metric
    if metric not in metrics:
        raise ValueError(f"metric: {metric!r} is no column of the summary{nearest(str(metric), metrics)}")
    first = ranked(rows, metric)[0]
    if first[metric] is None:
        raise ValueError(f"metric: no setting has {metric}")
    return first


def metrics_of(rows: Sequence[Row]) -> list[str]:
    """What the settings of a summary can be ranked by, the default first."""
    if not rows:
        return []
    names = list(rows[0])
    found = [name for name in names[names.index("seeds") + 1 :] if not name.endswith(("_low", "_high"))]
    found = [name for name in found if name not in ("diverged", "stopped", "stopped_at_rung")]
    return sorted(found, key=lambda name: name != "eval_return")


def ranked(rows: Sequence[Row], metric: str = "eval_return") -> list[Row]:
    """The rows from the best to the worst by ``metric``; of equals, as where every middle half ends at 500, those of
    greater mean come first, then those that were solved sooner, then those that come first.

    Returns after unequal trainings do not compare: settings that went to the end come before those that halving
    stopped, and of these the ones that came further. A setting without the metric comes last.
    """

    def worth(row: Row) -> tuple[bool, float, float, float, float, int]:
        value, rung = row[metric], row.get("stopped_at_rung")
        mean, steps = row.get("eval_mean"), row.get("median_env_steps")
        return (
            value is None,
            -np.inf if rung is None else -rung,
            0.0 if value is None else -value,
            np.inf if mean is None else -mean,
            np.inf if steps is None else steps,
            row["config"],
        )

    return sorted(rows, key=worth)


_READ = (
    "status",
    "stop",
    "episodes",
    "env_steps",
    "max_episodes",
    "max_env_steps",
    "stopped_at_rung",
    "solved_at_episode",
    "solved_at_step",
    "final_return",
    "eval_return",
    "area_under_curve",
)


def _setting(mine: dict[str, np.ndarray], threshold: float | None) -> Row:
    seeds, status = len(mine["status"]), mine["status"]
    looks = mine["stop"][0] != "none"  # nobody looks for success: none is not a share of 0
    kept = status != "diverged"
    returns = mine["eval_return"][kept & np.isfinite(mine["eval_return"])]
    row: Row = {"seeds": seeds}
    watched = status != "stopped"  # of the others nobody knows whether they would have been solved
    row |= _named("solved", _share(status[watched] == "solved") if looks and watched.any() else NONE)
    row |= _named("reached", NONE if threshold is None else _share(mine["eval_return"] >= threshold))
    row |= _named("median_episodes", _time(mine, "solved_at_episode", "episodes", "max_episodes") if looks else NONE)
    row |= _named("median_env_steps", _time(mine, "solved_at_step", "env_steps", "max_env_steps") if looks else NONE)
    for name in ("final_return", "eval_return", "area_under_curve"):
        values = mine[name][kept]
        row |= _named(name, stats.interquartile_mean(values[np.isfinite(values)].tolist()))
    row["eval_median"] = float(np.median(returns)) if len(returns) else None
    row["eval_mean"] = float(np.mean(returns)) if len(returns) else None
    row["diverged"], row["stopped"] = int((status == "diverged").sum()), int((~watched).sum())
    row["stopped_at_rung"] = None if watched.all() else int(mine["stopped_at_rung"][~watched].max())
    return row


def _share(which: np.ndarray) -> Estimate:
    if len(which) == 1:
        return Estimate(float(which[0]), None, None)
    return stats.share(int(which.sum()), len(which))


def _time(mine: dict[str, np.ndarray], at: str, clock: str, limit: str) -> Estimate:
    times, observed = time_to_success(mine, at, clock, limit)
    return stats.kaplan_meier_median(times.tolist(), observed.tolist())


def time_to_success(mine: dict[str, np.ndarray], at: str, clock: str, limit: str) -> tuple[np.ndarray, np.ndarray]:
    """When each lane was solved, or until when it was watched, and whether it was solved.

    A lane that reached the limit of this clock, or was stopped by halving, was watched until then. One that ended for
    another reason, the other clock's limit or a divergence, would never have been solved: it counts as later than all.
    Bad policies have short episodes, so a lane that runs out of episodes does so after few steps; to call that a
    censored time would make bad settings look quick.
    """
    observed = mine["status"] == "solved"
    watched = (mine[clock] >= np.minimum(mine[limit], NO_LIMIT)) | (mine["status"] == "stopped")
    times = np.where(observed, mine[at], np.where(watched, mine[clock], np.inf))
    return times.astype(float), observed


def _named(name: str, estimate: Estimate) -> Row:
    return {name: estimate.value, f"{name}_low": estimate.low, f"{name}_high": estimate.high}


def _values(column: pa.ChunkedArray) -> np.ndarray:
    """Numbers as float64 with NaN for null; words as they are."""
    if pa.types.is_string(column.type):
        return np.asarray(column.to_pylist(), object)
    return column.cast(pa.float64()).to_numpy()
