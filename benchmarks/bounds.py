"""What whole commands should not exceed or fall short of on this machine, one by one."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

SECONDS, USEFUL = "seconds", "useful_share"
#: In words: notes are of the last turn.
WORDS = {SECONDS: "seconds, the median", USEFUL: "share of the slots' time that is useful while lanes wait, last turn"}

EMPTY, FULL = "compile cache empty", "compile cache full"


@dataclass(frozen=True)
class Bound:
    """A contender's seconds in a case, or a note of its last run of it, and what it should be at most or at least."""

    suite: str
    contender: str
    case: str
    quantity: str = SECONDS
    most: float | None = None
    least: float | None = None


BOUNDS = [
    Bound("sweep", FULL, "article-q, 1 seed", most=3),
    Bound("sweep", EMPTY, "article-q, 1024 seeds", most=20),
    Bound("sweep", FULL, "article-q, 1024 seeds", most=20),
    Bound("sweep", FULL, "article-q, 1024 seeds", USEFUL, least=0.9),
    Bound("sweep", FULL, "dqn, 64 settings, 16 seeds", USEFUL, least=0.9),
]


def bounds(result: Mapping[str, Any]) -> list[dict[str, Any]]:
    """The bounds of a suite's result with their values; None where there is no figure."""
    rows = {(row["contender"], row["case"]): row for row in result["rows"]}
    made = []
    for bound in BOUNDS:
        if bound.suite == result["suite"]:
            row = rows.get((bound.contender, bound.case), {})
            seconds = 1 / row["median"] if row.get("median") else None
            value = seconds if bound.quantity == SECONDS else (row.get("notes") or {}).get(bound.quantity)
            made.append({**vars(bound), "value": value})
    return made


def wanted(row: Mapping[str, Any]) -> str:
    """What the value should be, in words."""
    return f"at most {row['most']:g}" if row["most"] is not None else f"at least {row['least']:g}"


def sentence(row: Mapping[str, Any]) -> str:
    """A bound as a line of text."""
    return f"{row['case']}, {row['contender']}, {WORDS[row['quantity']]}: {_value(row)} (bar {wanted(row)})"


def lines(result: Mapping[str, Any]) -> list[list[str]]:
    """The rows of a table; empty where nothing is bounded."""
    told = [["", "", "quantity", "value", "bar"]]
    for row in result.get("bounds", []):
        told.append([row["case"], row["contender"], WORDS[row["quantity"]], _value(row), wanted(row)])
    return told if len(told) > 1 else []


def _value(row: Mapping[str, Any]) -> str:
    return "no figure" if row["value"] is None else f"{row['value']:.3g}"
