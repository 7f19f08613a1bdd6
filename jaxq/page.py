"""The report of a sweep: ``report.md`` and its pictures, each as PNG and SVG."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa

from jaxq import pictures, run_files, stats, summaries
from jaxq.drawing import draw
from jaxq.outcome import Outcome
from jaxq.presets import Training
from jaxq.settings import shown
from jaxq.summaries import Row

#: Settings that the table of the report shows, and of these those that are compared in pairs with the best.
BEST, COMPARED = 20, 5
#: Pairs of axes that get a heat map.
PAIRS = 15
#: In so few settings axes are tied even where no value comes twice.
FEW_TIED = 5


def write(outcome: Outcome, path: Path, drawn: Callable[[str], None] = lambda name: None) -> Path:
    """Writes the report of a run directory and returns its path; ``drawn`` is told of each picture before it is made.

    Raises OSError for what cannot be written.
    """
    folder = path / run_files.PICTURES
    folder.mkdir(exist_ok=True)

    def picture(name: str, kind: str, title: str, **options: Any) -> str:
        drawn(name)
        try:
            figure = draw(outcome, kind, **options)
        except ValueError as error:
            return f"{title}: {error}.\n"
        for ending in ("png", "svg"):
            pictures.save(figure, folder / f"{name}.{ending}")
        return f"![{title}]({run_files.PICTURES}/{name}.png)\n"

    text = "\n".join(_sections(outcome, picture))
    run_files.replace(path / run_files.REPORT, text.encode())
    return path / run_files.REPORT


def _sections(outcome: Outcome, picture: Callable[..., str]) -> Iterator[str]:
    summary, varied = outcome.summary(), outcome.varied
    yield f"# {outcome.spec['preset']}: {_count(len(summary), 'setting')}\n"
    yield from _what_ran(outcome, summary)
    if (outputs := summaries.outputs(outcome.lanes)) is not None:  # of a function of the user's own
        yield "## Results\n"
        yield _table(summary[:1000], list(summary[0]) if summary else [])
        if outputs:
            yield picture("spread", "spread", "spread of the seeds")
            yield from _hyperparameters(outcome, picture, outputs[0], outputs[0])
        return
    seeds = max(row["seeds"] for row in summary)
    yield "## Settings\n"
    yield from _settings(summary, varied, ranked=seeds > 1)
    if seeds > 1 and len(summary) > 1:
        yield from _pairs(outcome, summary)
    yield "## Learning\n"
    yield picture("curves", "curves", "learning curves")
    if any(row["solved"] is not None for row in summary):
        yield picture("survival", "survival", "unsolved seeds over environment steps")
    yield picture("spread", "spread", "spread of the seeds")
    metric, name = _metric(outcome)
    if metric != "eval_return":
        yield picture("spread-steps", "spread", f"spread of the seeds: {name}", metric=metric)
    yield from _hyperparameters(outcome, picture, metric, name)
    yield from _agent(outcome, picture)


def _hyperparameters(outcome: Outcome, picture: Callable[..., str], metric: str, name: str) -> Iterator[str]:
    """A picture per axis and per pair of axes, of those that are tied to each other the first."""
    if not outcome.varied:
        return
    yield "## Hyperparameters\n"
    tied = tied_axes(outcome.spec["settings"], outcome.varied)
    for first in dict.fromkeys(tied.values()):
        others = ", ".join(axis for axis, to in tied.items() if to == first)
        yield f"Each value of {first} goes with one of {others}: {first} stands for all of them in the pictures.\n"
    axes = [axis for axis in outcome.varied if axis not in tied]
    for i, axis in enumerate(axes):
        yield picture(f"sensitivity-{i}", "sensitivity", f"{name} by {axis}", axis=axis, metric=metric)
    pairs = list(itertools.combinations(axes, 2))
    for i, (x, y) in enumerate(pairs[:PAIRS]):
        yield picture(f"pair-{i}", "heat_map", f"{name} by {x} and {y}", x=x, y=y, metric=metric)
    if len(pairs) > PAIRS:
        yield f"{PAIRS} of {len(pairs)} pairs; `Outcome.plot('heat_map', x=..., y=...)` draws any.\n"


def tied_axes(settings: Sequence[Sequence[Any]], varied: Sequence[str]) -> dict[str, str]:
    """The axes whose values stand one to one with those of an earlier one, and which that is. settings [n, axes].

    Values of their own in each of many settings, as ranges have them, are tied to nothing.

    >>> tied_axes([[1, "a", 5], [1, "a", 6], [2, "b", 5]], ["x", "y", "z"])
    {'y': 'x'}
    """
    columns = [list(map(str, column)) for column in zip(*settings, strict=True)]
    tied: dict[str, str] = {}
    for (i, one), (j, other) in itertools.combinations(enumerate(columns), 2):
        pairs, distinct = len(set(zip(one, other, strict=True))), len(set(one))
        alone = distinct == len(settings) > FEW_TIED
        if pairs == distinct == len(set(other)) and not alone and varied[i] not in tied:
            tied.setdefault(varied[j], varied[i])
    return tied


def _metric(outcome: Outcome) -> tuple[str, str]:
    """What hyperparameters are judged by: the greedy return or, where most lanes are solved, how long that took."""
    status = outcome.lanes["status"].to_pylist()
    if 2 * status.count("solved") > len(status):
        return "solved_at_step", "environment steps until solved"
    return "eval_return", "greedy return"


def _what_ran(outcome: Outcome, summary: list[Row]) -> Iterator[str]:
    spec, held = outcome.spec, outcome.store.manifest
    lanes = outcome.lanes
    statuses = lanes["status"].to_pylist() if "status" in lanes.column_names else []
    told = ", ".join(f"{statuses.count(name)} {name}" for name in dict.fromkeys(statuses))
    yield f"{_count(len(lanes), 'training')}: {told or 'none yet'}."
    yield f"Key family {spec['prng']}, root seed {spec['root_seed']}.\n"
    if not outcome.complete:
        yield "The sweep is not complete: lanes are missing below.\n"
    if "versions" in held:
        versions = ", ".join(f"{name} {version}" for name, version in held["versions"].items())
        yield f"Made on {held['cpu']} ({held['device']}) with {versions}.\n"
    for rung in held.get("rungs", []):
        yield _rung(rung, lanes)
    for one in held.get("mismatches", []):
        yield f"- Resumed otherwise: {one['what']} was {one['was']}, became {one['is']}."
    if held.get("rungs") or held.get("mismatches"):
        yield ""


def _rung(rung: Row, lanes: pa.Table) -> str:
    """What a rung decided, and how many trainings it really stopped: the others had ended before."""
    kept, others = len(rung["kept"]), len(rung["stopped"])
    stopped = lanes["stopped_at_rung"].to_pylist().count(rung["rung"])
    told = (
        f"- Rung {rung['rung']}, at {rung['fraction']:.3g} of each training: {kept} of {kept + others} settings went on"
    )
    if others and not stopped:
        return f"{told}, but it came too late to stop any training: all of the other settings had ended."
    return f"{told}, {_count(stopped, 'training')} of the others {'was' if stopped == 1 else 'were'} stopped."


def _settings(summary: list[Row], varied: list[str], ranked: bool) -> Iterator[str]:
    names = {
        "solved": 2,
        "reached": 2,
        "median_env_steps": 0,
        "final_return": 1,
        "eval_return": 1,
        "area_under_curve": 1,
    }
    rows = summaries.ranked(summary) if ranked else summary
    table = [
        {"setting": row["config"]}
        | {name: shown(row[name]) for name in varied}
        | {"seeds": row["seeds"]}
        | {name: _interval(row, name, digits) for name, digits in names.items()}
        | {"median": _value(row["eval_median"], 1), "mean": _value(row["eval_mean"], 1)}
        | {"diverged": row["diverged"], "stopped": row["stopped"]}
        for row in rows[:BEST]
    ]
    stopped = sum(row["stopped"] > 0 for row in summary)
    if ranked and len(summary) > BEST:
        which = "that came furthest, of these those with" if stopped else "with"
        yield f"The {BEST} of {len(summary)} settings {which} the greatest greedy return.\n"
    if not ranked:
        yield "One seed each: values without intervals, in the order of the sweep. One seed ranks no settings.\n"
    yield _table(table, list(table[0]))
    if stopped:
        yield (
            f"{stopped} of {len(summary)} settings were stopped at a rung: they show what they had come to then, rank"
            " after those that went to the end, those that came further first, and have crosses in the pictures.\n"
        )
    yield (
        "solved: share of seeds that the stop rule ended, of those that no rung stopped; reached: share whose greedy"
        " return is at the environment's threshold (Wilson intervals); median_env_steps: Kaplan-Meier median until"
        " solved, where a seed that reached max_env_steps or was stopped at a rung is censored, and one that diverged,"
        " or reached max_episodes first, is later than all; final_return (training, last 50 episodes), eval_return"
        " (greedy) and area_under_curve (mean training return over all steps): interquartile means with 95 % bootstrap"
        " intervals; median and mean: of the greedy return.\n"
    )


def _pairs(outcome: Outcome, summary: list[Row]) -> Iterator[str]:
    """The best setting against the next ones; of halved sweeps those that went to the end."""
    ended = [row for row in summary if row["eval_return"] is not None and not row["stopped"]]
    ranked = [row["config"] for row in summaries.ranked(ended)]
    if len(ranked) < 2:
        return
    config, seed, returns = (
        outcome.lanes[name].to_numpy(zero_copy_only=False) for name in ("config", "seed", "eval_return")
    )

    def of(setting: int) -> dict[int, float]:
        mine = (config == setting) & np.isfinite(returns.astype(float))
        return dict(zip(seed[mine].tolist(), returns[mine].tolist(), strict=True))

    best, rows = of(ranked[0]), []
    for other in ranked[1 : 1 + COMPARED]:
        theirs = of(other)
        common = sorted(set(best) & set(theirs))
        difference = stats.paired_difference([best[s] for s in common], [theirs[s] for s in common])
        better = stats.probability_of_improvement(list(best.values()), list(theirs.values()))
        rows.append(
            {
                "setting": other,
                "probability that the best does better": _interval(better._asdict(), "value", 2),
                "mean difference on common seeds": _interval(difference._asdict(), "value", 1),
            }
        )
    yield f"Setting {ranked[0]} against those that follow it:\n"
    yield _table(rows, list(rows[0]))


def _agent(outcome: Outcome, picture: Callable[..., str]) -> Iterator[str]:
    rows = [
        row
        for row in outcome.lanes.select(["config", "seed", "status", "eval_return"]).to_pylist()
        if row["eval_return"] is not None
    ]
    if not rows:
        return
    best = max(rows, key=lambda row: (row["status"] != "stopped", row["eval_return"]))
    config, seed = best["config"], best["seed"]
    try:
        outcome.policy(config, seed)
        if not isinstance(outcome.settings(config), Training):
            return
    except ValueError as error:
        yield f"## A trained agent\n\nNone is drawn: {error}.\n"
        return
    yield f"## A trained agent\n\nSetting {config}, seed {seed}, with a greedy return of {best['eval_return']:.1f}.\n"
    for kind, title in (
        ("action_values", "action values over pole angle and angular velocity"),
        ("greedy_map", "the greedy action over the same plane"),
        ("overestimation", "the largest action value beside the return that followed"),
    ):
        yield picture(kind.replace("_", "-"), kind, title, config=config, seed=seed)


def _table(rows: list[Row], names: list[str]) -> str:
    lines = ["| " + " | ".join(names) + " |", "| " + " | ".join("---:" for _ in names) + " |"]
    lines += ["| " + " | ".join("-" if row[name] is None else str(row[name]) for name in names) + " |" for row in rows]
    return "\n".join(lines) + "\n"


def _interval(row: Any, name: str, digits: int) -> str:
    low, high = (row["low"], row["high"]) if name == "value" else (row[f"{name}_low"], row[f"{name}_high"])
    if row[name] is None or (low is None and high is None):
        return _value(row[name], digits)
    ends = ("?" if end is None else f"{end:.{digits}f}" for end in (low, high))
    return f"{row[name]:.{digits}f} [{', '.join(ends)}]"


def _value(value: float | None, digits: int) -> str:
    return "-" if value is None else f"{value:.{digits}f}"


def _count(number: int, thing: str) -> str:
    return f"{number} {thing}{'' if number == 1 else 's'}"
