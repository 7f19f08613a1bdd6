"""``jaxq bench``: our own suites, from the installed package."""

from __future__ import annotations

import argparse
import json
import math
import sys
import time
from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any

from rich.console import Console
from rich.progress import (
    BarColumn,
    Progress,
    ProgressColumn,
    Task,
    TextColumn,
    TimeElapsedColumn,
    TimeRemainingColumn,
)
from rich.text import Text

from jaxq import flags
from jaxq.bench import report, solved
from jaxq.bench.contest import Contender, contest
from jaxq.bench.suites import SUITES, Suite, groups
from jaxq.suggest import nearest


def arguments(parser: argparse.ArgumentParser) -> None:
    """The flags that ``jaxq bench`` and ``python -m benchmarks`` share."""
    together = "; ".join(f"{group} is all of {group}-*" for group in groups())
    known = f"{', '.join(SUITES)}; {together}; all when none is named"
    parser.add_argument("suites", nargs="*", metavar="SUITE", help=known)
    parser.add_argument("--repeats", type=_count, help="turns of each contender (a suite has its own default)")
    parser.add_argument("--seconds", type=_seconds, help="least time of a turn (a suite has its own default)")
    parser.add_argument(
        "--cases", nargs="+", metavar="CASE", help="only these: numbers of environments or lanes, settings"
    )
    parser.add_argument("--json", action="store_true", help="print the results as one JSON object")
    parser.add_argument("--quiet", action="store_true", help="no progress")


def read(parser: argparse.ArgumentParser, words: Sequence[str], name: str) -> tuple[argparse.Namespace, list[Suite]]:
    """The options, and the suites they name; raises UsageError for a suite or a case that there is not as well."""
    options = flags.read(parser, words, name)
    try:
        suites = chosen(options.suites)
        check(options.cases, suites)
    except ValueError as error:
        raise flags.UsageError(str(error)) from None
    return options, suites


def chosen(names: Sequence[str]) -> list[Suite]:
    """The suites of these names, each once, all when there is none; a group's name stands for all of its suites.

    Raises ValueError for an unknown name, with the nearest.
    """
    together = groups()
    for name in names:
        if name not in SUITES and name not in together:
            raise ValueError(f"suite {name!r} is unknown{nearest(name, [*SUITES, *together])}")
    found = [one for name in names or SUITES for one in together.get(name, [name])]
    return [SUITES[name] for name in dict.fromkeys(found)]


def check(cases: Sequence[str] | None, suites: Sequence[Suite]) -> None:
    """Raises ValueError for a case that one of these suites does not have."""
    for suite in suites:
        known = dict.fromkeys(case for contender in suite.contenders for case in contender.cases)
        unknown = [case for case in cases or () if case not in known]
        if unknown:
            raise ValueError(f"cases: {suite.name} has no {' '.join(unknown)}; known: {', '.join(known)}")


def run(
    suites: Sequence[Suite],
    options: argparse.Namespace,
    extra: Callable[[Suite], Sequence[Contender]] = lambda suite: (),
    on_result: Callable[[dict[str, Any]], None] = lambda result: None,
) -> dict[str, Any]:
    """Runs the suites as the options say, each with ``extra`` contenders beside ours; results by suite.

    Tables go to stdout as they come, or with ``--json`` one object at the end, or when interrupted; progress goes to
    stderr. ``on_result`` is called for every suite as it ends.
    """
    results: dict[str, Any] = {}
    try:
        _run(suites, options, extra, on_result, results)
    finally:
        if options.json and results:
            print(json.dumps(results), flush=True)
    return results


def _run(
    suites: Sequence[Suite],
    options: argparse.Namespace,
    extra: Callable[[Suite], Sequence[Contender]],
    on_result: Callable[[dict[str, Any]], None],
    results: dict[str, Any],
) -> None:
    """``run``, whose results are filled in as they come."""
    for suite in suites:
        contenders = [*suite.contenders, *extra(suite)]
        if options.cases:
            contenders = [_only(contender, options.cases) for contender in contenders]
        with _Bar(suite.name, options.quiet) as bar:
            result = contest(
                [contender for contender in contenders if contender.cases],
                repeats=options.repeats or suite.repeats,
                seconds=suite.seconds if options.seconds is None else options.seconds,
                on_turn=bar.turn,
            )
        results[suite.name] = {
            "suite": suite.name,
            "unit": suite.unit,
            "axis": suite.axis,
            "whole": suite.whole,
            **result,
        }
        if options.json:
            _tell_errors(results[suite.name])
        else:
            show(results[suite.name], suite)
        on_result(results[suite.name])


def show(result: dict[str, Any], suite: Suite) -> None:
    """A suite's table on stdout, and what could not run on stderr."""
    print(f"{suite.name}: {suite.summary}")
    trained = solved.table(result)
    shown = f"{'seconds' if suite.whole else f'{suite.unit}/s'}, median of {result['repeats']}"
    print(f"{solved.CAPTION if trained else shown}; {report.machine(result)}")
    print(report.text(trained or report.grid(result, suite.axis)), end="\n\n")
    if told := report.notes(result):
        print(report.text(told), end="\n\n")
    for line in report.remarks(result):
        print(line)
    sys.stdout.flush()
    _tell_errors(result)


def _tell_errors(result: dict[str, Any]) -> None:
    for line in report.errors(result):
        print(f"not run: {line}", file=sys.stderr)


def _only(contender: Contender, cases: Sequence[str]) -> Contender:
    return replace(contender, cases=[case for case in contender.cases if case in cases])


def _count(text: str) -> int:
    if not text.isdigit() or not 1 <= int(text) <= 1000:
        raise argparse.ArgumentTypeError(f"{text} is not allowed: a whole number from 1 to 1000")
    return int(text)


def _seconds(text: str) -> float:
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if not 0 <= value <= 3600:
        raise argparse.ArgumentTypeError(f"{text} is not allowed: a number from 0 to 3600")
    return value


class _Turn(ProgressColumn):
    """How long the turn under way has lasted, and how long it will at least."""

    def render(self, task: Task) -> Text:
        began, least = task.fields["began"], task.fields["least"]
        if began is None:
            return Text("")
        of = f" of at least {least:.0f}" if least else ""
        return Text(f"{time.monotonic() - began:.0f}{of} s")


class _Bar:
    """Turns done, the turn under way and time left, on stderr where that is a terminal; elsewhere nothing until the
    table."""

    def __init__(self, name: str, quiet: bool):
        console = Console(stderr=True)
        columns = (TextColumn("{task.description}"), BarColumn(), _Turn(), TimeElapsedColumn(), TimeRemainingColumn())
        self.bar = Progress(
            *columns,
            console=console,
            disable=quiet or not console.is_terminal,
            transient=True,
            speed_estimate_period=math.inf,  # a turn may last for minutes
        )
        self.task = self.bar.add_task(name, total=None, began=None, least=0.0)
        self.name = name

    def __enter__(self) -> _Bar:
        self.bar.start()
        return self

    def __exit__(self, *error: object) -> None:
        self.bar.stop()

    def turn(self, done: int, total: int, what: str, least: float) -> None:
        self.bar.update(
            self.task,
            completed=done,
            total=total,
            description=f"{self.name}: {what}",
            began=time.monotonic(),
            least=least,
        )
