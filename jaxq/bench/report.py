"""A contest's result as a table for people."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

PREFIXES = ((1e9, "G"), (1e6, "M"), (1e3, "k"), (1, ""))


#: Notes that are not in the table: ``solved`` and ``remarks`` show theirs, slots say which cases are too few lanes.
APART = ("trainings", "differs", "slots")


def rate(value: float | None, unit: str = "") -> str:
    """A rate with three digits, such as "12.3 M updates/s"; a dash where there is none."""
    if not value:
        return "-"
    factor, prefix = next(((f, p) for f, p in PREFIXES if value >= f), PREFIXES[-1])
    scaled = value / factor
    digits = 0 if scaled >= 99.95 else 1 if scaled >= 9.995 else 2
    words = (f"{scaled:.{digits}f}", prefix, f"{unit}/s" if unit else "")
    return " ".join(word for word in words if word)


def digits(value: float) -> str:
    """A number with three digits, whole from 100 on: "0.123", "1,234"."""
    return f"{value:,.0f}" if abs(value) >= 99.95 else f"{value:.3g}"


def grid(result: Mapping[str, Any], axis: str) -> list[list[str]]:
    """Rows of a table: a row per case, a column per contender, medians, and the spread in per cent of the median."""
    names = list(dict.fromkeys(row["contender"] for row in result["rows"]))
    order = list(dict.fromkeys(row["case"] for row in result["rows"]))
    found = {(row["contender"], row["case"]): row for row in result["rows"]}
    lines = [[axis, *names]]
    for case in order:
        cells = (_cell(found.get((name, case)), result.get("whole", False)) for name in names)
        lines.append([counted(case), *cells])
    return lines


def counted(case: str) -> str:
    """A case as text: a number in groups of three digits, a name as it is."""
    return f"{int(case):,}" if case.isdigit() else case


def _cell(row: Mapping[str, Any] | None, whole: bool) -> str:
    if row is None:
        return ""
    if row["error"]:
        return "error"
    if not row["median"]:
        return "-"
    shown = f"{1 / row['median']:.2f} s" if whole else rate(row["median"])
    return f"{shown} (±{50 * row['spread']:.0f} %)"


def notes(result: Mapping[str, Any]) -> list[list[str]]:
    """Rows of a table of the numbers that contenders told of their last bout; empty when none did."""
    told = []
    for row in result["rows"]:
        numbers = {name: value for name, value in (row.get("notes") or {}).items() if name not in APART}
        if numbers:
            told.append((row, numbers))
    names = list(dict.fromkeys(name for _, numbers in told for name in numbers))
    lines = [["notes", *names]]
    for row, numbers in told:
        cells = ("" if numbers.get(name) is None else f"{numbers[name]:,}" for name in names)
        lines.append([f"{row['case']}, {row['contender']}", *cells])
    return lines if told else []


def remarks(result: Mapping[str, Any]) -> list[str]:
    """What contenders said of how their work is another than ours, ``differs`` in their notes: a line per difference
    with all who said it."""
    told: dict[str, dict[str, None]] = {}
    for row in result["rows"]:
        if differs := (row.get("notes") or {}).get("differs"):
            told.setdefault(differs, {})[row["contender"]] = None
    return [f"{'; '.join(names)}: {differs}." for differs, names in told.items()]


def errors(result: Mapping[str, Any]) -> list[str]:
    """A line per contender and reason that kept it from running."""
    reasons = {(row["contender"], row["error"]) for row in result["rows"] if row["error"]}
    return [f"{name}: {reason}" for name, reason in sorted(reasons)]


def text(lines: list[list[str]]) -> str:
    """The rows of a table in columns, the first to the left, the others to the right."""
    widths = [max(len(line[i]) for line in lines) for i in range(len(lines[0]))]
    shown = []
    for line in lines:
        cells = [
            line[0].ljust(widths[0]),
            *(cell.rjust(width) for cell, width in zip(line[1:], widths[1:], strict=True)),
        ]
        shown.append("  ".join(cells).rstrip())
    return "\n".join(shown)


def machine(result: Mapping[str, Any]) -> str:
    """What it was measured on: the processor, its cores and, where a contender ran on one, the accelerator."""
    here = result["machine"]
    found = {(row["device"], row["contender"]) for row in result["rows"] if row.get("device")}
    devices = sorted({device for device, _ in found})
    on = [f"{', '.join(sorted(name for at, name in found if at == device))} on {device}" for device in devices]
    return "; ".join([f"{here['cpu']}, {here['cores']} cores, {here['system']}", *on])
