"""What should not change along a suite's axis: the smallest figure over the largest, 1 where nothing changes."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from jaxq.bench import report

#: What is compared: medians, medians divided by their case, or a note of that name.
RATE, SHARE, MEMORY = "rate", "rate / case", "first_peak_mib"

CAPTION = (
    "Smallest over largest is 1 where nothing changes along the axis; cases that are too few for all cores do not"
    " count."
)
OF_MEMORY = " Memory is the peak of a case's first bout, fewer lanes before more."


@dataclass(frozen=True)
class Flat:
    """A quantity of a contender over its cases; ``least`` and ``goal`` as in ``beside.Bar``.

    Cases smaller than the ``slots`` in their notes do not count: they leave cores idle.
    """

    suite: str
    contender: str
    quantity: str = RATE
    least: float | None = None
    goal: float | None = None


FLAT = [
    Flat("dqn", "jaxq", least=0.75, goal=0.85),
    Flat("scaling-lanes", "jaxq, article-q", goal=0.9),
    Flat("scaling-lanes", "jaxq, article-dqn", goal=0.9),
    Flat("scaling-lanes", "jaxq, article-q", MEMORY, goal=0.9),
    Flat("scaling-lanes", "jaxq, article-dqn", MEMORY, goal=0.9),
    Flat("scaling-replay", "jaxq", least=0.9),
    Flat("scaling-cores", "jaxq, article-q", SHARE),
    Flat("scaling-cores", "jaxq, article-dqn", SHARE),
]


def flatness(result: Mapping[str, Any]) -> list[dict[str, Any]]:
    """How flat a suite's result is where it should be: each Flat with its first and last case and its value.

    The value is None where fewer than two cases have a figure.
    """
    made = []
    for flat in FLAT:
        if flat.suite == result["suite"]:
            found = {case: value for case, (value, counts) in figures(result, flat).items() if counts}
            over = {"first": min(found, default=None), "last": max(found, default=None)}
            value = min(found.values()) / max(found.values()) if len(found) > 1 else None
            made.append({**vars(flat), **over, "flat": value})
    return made


def figures(result: Mapping[str, Any], flat: Flat) -> dict[int, tuple[float, bool]]:
    """The quantity in each case that has one, and whether that case counts."""
    found = {}
    for row in result["rows"]:
        if row["contender"] != flat.contender or not row["median"]:
            continue
        case, notes = int(row["case"]), row.get("notes", {})
        value = {RATE: row["median"], SHARE: row["median"] / case}.get(flat.quantity, notes.get(flat.quantity))
        if value:
            found[case] = value, case >= notes.get("slots", 0)
    return found


def named(quantity: str, result: Mapping[str, Any]) -> str:
    """The quantity in words."""
    rate = f"{result['unit']} per second"
    return {RATE: rate, SHARE: f"{rate} / {result['axis']}", MEMORY: "peak memory, MiB"}[quantity]


def sentence(row: Mapping[str, Any], result: Mapping[str, Any]) -> str:
    """A flatness as a line of text."""
    what = f"{row['contender']}, {named(row['quantity'], result)}, smallest over largest"
    if row["flat"] is None:
        return f"{what}: no figure"
    wanted = [f"{word} {row[key]:g}" for word, key in (("bar", "least"), ("goal", "goal")) if row[key]]
    return f"{what}, {row['first']:,} to {row['last']:,} {result['axis']}: {row['flat']:.3g}" + (
        f" ({', '.join(wanted)})" if wanted else ""
    )


def lines(result: Mapping[str, Any]) -> list[list[str]]:
    """The rows of a table; empty where nothing should be flat."""
    told = [["", "what should be flat", "over", "smallest over largest", "bar", "goal"]]
    for row in result.get("flatness", []):
        over = "" if row["first"] is None else f"{row['first']:,} to {row['last']:,} {result['axis']}"
        value = "no figure" if row["flat"] is None else f"{row['flat']:.3g}"
        wanted = [f"{row[key]:g}" if row[key] else "" for key in ("least", "goal")]
        told.append([row["contender"], named(row["quantity"], result), over, value, *wanted])
    return told if len(told) > 1 else []


def caption(result: Mapping[str, Any]) -> str:
    """What stands below the table."""
    return CAPTION + (OF_MEMORY if any(row["quantity"] == MEMORY for row in result["flatness"]) else "")


def alone(result: Mapping[str, Any]) -> bool:
    """Whether a suite is about flatness alone: every contender should be flat."""
    return {row["contender"] for row in result["rows"]} <= {
        flat.contender for flat in FLAT if flat.suite == result["suite"]
    }


def picture(result: Mapping[str, Any], path: Path) -> None:
    """A panel per quantity: rates as shares of the contender's largest, memory as it is, from 0 up."""
    import matplotlib.pyplot as plt

    flats = [flat for flat in FLAT if flat.suite == result["suite"]]
    panels = list(dict.fromkeys(flat.quantity for flat in flats))
    figure, grid = plt.subplots(1, len(panels), figsize=(6 * len(panels), 4.5), layout="constrained", squeeze=False)
    for axes, quantity in zip(grid[0], panels, strict=True):
        drawn = [(flat, found) for flat in flats if flat.quantity == quantity and (found := figures(result, flat))]
        for flat, found in drawn:
            _line(axes, result, flat, found)
        if not all(counts for _, found in drawn for _, counts in found.values()):
            axes.plot([], [], "o", color="grey", fillstyle="none", label=f"too few {result['axis']} for all cores")
        ticks(axes, result)
        what = named(quantity, result)
        axes.set(xlabel=result["axis"], ylabel=what if quantity == MEMORY else f"{what}, share of the largest")
        axes.set_ylim(0, 1.1 * axes.get_ylim()[1] if quantity == MEMORY else 1.1)
        wanted = {flat.least or flat.goal for flat in flats if flat.quantity == quantity} - {None}
        for level in wanted if quantity != MEMORY else ():
            axes.axhline(level, color="grey", linewidth=1, linestyle=":")
        axes.grid(alpha=0.3)
        axes.legend(fontsize=8, loc="lower right")
    figure.savefig(path, dpi=110)
    plt.close(figure)


def ticks(axes: Any, result: Mapping[str, Any]) -> None:
    """A logarithmic axis of cases with a tick at each."""
    cases = sorted({int(row["case"]) for row in result["rows"]})
    axes.set_xscale("log", base=2)
    axes.set_xticks(cases, [f"{case:,}" for case in cases])
    axes.minorticks_off()


def _line(axes: Any, result: Mapping[str, Any], flat: Flat, found: Mapping[int, tuple[float, bool]]) -> None:
    """One contender in one panel; a case that does not count has an open marker."""
    largest = max(value for value, _ in found.values())
    scale = 1.0 if flat.quantity == MEMORY else largest
    shown = [value / scale for value, _ in found.values()]
    label = flat.contender if flat.quantity == MEMORY else f"{flat.contender}, 1.0 = {report.rate(largest)}"
    (line,) = axes.plot(list(found), shown, label=label, linewidth=2)
    axes.plot(list(found), shown, "o", color=line.get_color(), fillstyle="none")
    counting = {case: value / scale for case, (value, counts) in found.items() if counts}
    axes.plot(list(counting), list(counting.values()), "o", color=line.get_color())
    if flat.quantity != MEMORY:  # memory has one figure per case
        rows = [row for row in result["rows"] if row["contender"] == flat.contender and int(row["case"]) in found]
        low, high = (
            [edge(row["rates"]) / row["median"] * at for row, at in zip(rows, shown, strict=True)]
            for edge in (min, max)
        )
        axes.fill_between(list(found), low, high, color=line.get_color(), alpha=0.2)
