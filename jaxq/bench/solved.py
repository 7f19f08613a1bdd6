"""What a contest tells of trainings until they were solved: their table, and the curves of a picture.

A row's notes then hold ``trainings``: ``together``, how many seeds ran at once; ``seconds``, of each such group; and of
every training, group by group, ``env_steps`` and ``solved``.

A training that reached its limit without success is none that succeeds later: limits count episodes too, which are
short where a policy is bad, so it is left in the denominator and counts as later than all others, and is not taken out
where it ended, as an estimate for independent censoring would.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

from jaxq import stats
from jaxq.bench import report
from jaxq.stats import Estimate

#: What stands in the columns of the table.
CAPTION = (
    "medians until solved, where a seed that was not solved is later than all others; mean wall-clock seconds per seed,"
    " solved or not; intervals of 95 %. Of seeds that ran together each has its share, by env steps, of the seconds"
)


class Trainings(NamedTuple):
    """The trainings of one contender in one case; lists of one length, None where a training was not solved."""

    seconds: list[float]  # that it took, solved or not
    solved_at_s: list[float | None]
    solved_at_step: list[float | None]


def trainings(row: Mapping[str, Any]) -> Trainings | None:
    """The trainings of a contest's row; None when it has none."""
    told = (row.get("notes") or {}).get("trainings")
    if not told:
        return None
    steps, width = told["env_steps"], told["together"]
    groups = [sum(steps[first : first + width]) for first in range(0, len(steps), width)]
    seconds = [told["seconds"][i // width] * count / groups[i // width] for i, count in enumerate(steps)]
    return Trainings(seconds, _where(told["solved"], seconds), _where(told["solved"], steps))


def _where(solved: Sequence[bool], values: Sequence[float]) -> list[float | None]:
    return [value if won else None for won, value in zip(solved, values, strict=True)]


def table(result: Mapping[str, Any]) -> list[list[str]]:
    """Rows of a table, one per case and contender; empty when the result is not of such trainings."""
    columns = ("seeds", "solved", "env steps until solved", "seconds until solved", "seconds per seed")
    lines = [["contender", result["axis"], *columns]]
    order = list(dict.fromkeys(row["case"] for row in result["rows"]))
    for row in sorted(result["rows"], key=lambda row: order.index(row["case"])):
        found = trainings(row)
        cells = ["", "not run", "", "", ""] if found is None else _cells(found)
        lines.append([row["contender"], row["case"], *cells])
    return lines if any(map(trainings, result["rows"])) else []


def _cells(found: Trainings) -> list[str]:
    won = [step for step in found.solved_at_step if step is not None]
    share = stats.share(len(won), len(found.seconds))
    return [
        f"{len(found.seconds):,}",
        _estimate(Estimate(*(None if end is None else 100 * end for end in share)), " %"),
        _estimate(stats.time_to_success(found.solved_at_step)),
        _estimate(stats.time_to_success(found.solved_at_s)),
        _estimate(stats.mean(found.seconds)),
    ]


def _estimate(estimate: Estimate, unit: str = "") -> str:
    """A value with its interval: "12.3 [10.1, 15]", with a dash for an end, or a value, that is not known."""
    value, *ends = (_digits(part) for part in estimate)
    known = estimate.low is not None or estimate.high is not None
    return f"{value}{unit if estimate.value is not None else ''}" + (f" [{', '.join(ends)}]" if known else "")


def _digits(value: float | None) -> str:
    return "-" if value is None else report.digits(value)


def curve(times: Sequence[float | None]) -> tuple[list[float], list[float]]:
    """The share of all trainings that were solved by then, as the corners of steps: times, and shares from there on.

    >>> curve([30, 10, None, 20])
    ([10, 20, 30], [0.25, 0.5, 0.75])
    """
    at = sorted(time for time in times if time is not None)
    return at, [(i + 1) / len(times) for i in range(len(at))]
