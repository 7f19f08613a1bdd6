"""``jaxq verify``: whether this installation computes what it says, on this machine."""

from __future__ import annotations

import argparse
import json
import platform
import sys
from collections.abc import Sequence
from typing import Any

from jaxq import cpu, exits, verify
from jaxq.flags import Once, UsageError, whole
from jaxq.machine import processor

#: Columns of the table that are words.
WORDS = ("check",)
#: Characters of a check's name that fit.
NAME = 34


def arguments(parser: argparse.ArgumentParser) -> None:
    """The flags of the command."""
    known = "; ".join(f"{name}: {what}" for name, what in verify.GROUPS.items())
    parser.add_argument("only", nargs="*", metavar="GROUP", help=f"{known}; all when none is named")
    parser.add_argument(
        *("--cases",),
        action=Once,
        type=whole,
        default=verify.CASES,
        help=f"random states of each environment, and a measure of the rest (default {verify.CASES})",
        metavar="N",
    )
    parser.add_argument(
        *("--against",),
        action=Once,
        default=None,
        help="another environment of Gymnasium's to compare ours with, as phys2d/CartPole-v1",
        metavar="ID",
    )
    parser.add_argument("--json", action="store_true", help="print one JSON object")
    parser.add_argument("--quiet", action="store_true", help="no progress and no talk")


def run(options: argparse.Namespace) -> int:
    """Runs the checks and prints a line each; returns the exit status, 1 where one is off. Raises UsageError."""
    cpu.tune()
    from rich.console import Console
    from rich.progress import (
        BarColumn,
        Progress,
        TaskProgressColumn,
        TextColumn,
        TimeElapsedColumn,
        TimeRemainingColumn,
    )

    show = not options.quiet and sys.stderr.isatty()
    columns = (TextColumn("{task.description:40.40}"), BarColumn(), TaskProgressColumn())
    times = (TimeElapsedColumn(), TimeRemainingColumn())
    bar = Progress(*columns, *times, console=Console(stderr=True), transient=True, disable=not show)
    task = bar.add_task("verifying", total=None)
    try:
        with bar:
            found = verify.run(
                options.only,
                cases=options.cases,
                against=options.against,
                told=lambda done, total, name: bar.update(task, completed=done, total=total, description=name),
            )
    except ValueError as error:
        raise UsageError(str(error)) from None
    off = [one for one in found if not one.ok]
    versions = {"python": platform.python_version(), **verify.versions()}
    if options.json:
        rows = [one._asdict() for one in found]
        print(json.dumps({"ok": not off, "versions": versions, "processor": processor(), "checks": rows}))
    else:
        print(", ".join(f"{name} {version}" for name, version in versions.items()) + f"; {processor()}")
        for group in dict.fromkeys(one.group for one in found):
            print(_table(group, [one for one in found if one.group == group]))
        for one in off:
            print(f"OFF: {one.group}, {one.name}: {one.detail or f'{one.error:.3g} is above {one.allowed:.3g}'}")
        if any(one.decided for one in found):
            print("rounded: Gymnasium's own step is as far off from a state some ulps away")
        print(f"{len(found)} checks, {len(off)} off")
    return exits.FAILED if off else exits.OK


def _table(group: str, found: Sequence[verify.Check]) -> str:
    """What a group is compared with, and a line for each of its checks."""
    from jaxq import report
    from jaxq.streams import encodes

    rows: list[dict[str, Any]] = [
        {
            "check": one.name if len(one.name) <= NAME else f"{one.name[: NAME - 3]}...",
            "cases": one.cases,
            "rounded": one.decided or "",
            "error": "-" if one.error is None else f"{one.error:.2g}",
            "allowed": "-" if one.allowed is None else f"{one.allowed:.2g}",
            "": "ok" if one.ok else "OFF",
        }
        for one in found
    ]
    against = "; ".join(dict.fromkeys(one.against for one in found))
    table = report.rows_table(rows, words=WORDS, plain=not encodes(sys.stdout, report.LINES))
    return f"\n{group}, against {against}\n{table}"
