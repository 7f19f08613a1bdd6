"""Our suites beside the limits of the machine and, with ``--peers``, beside the peers.

    python -m benchmarks [SUITE ...] [--peers]

Prints a table of each suite, its ratios and how flat it is, and keeps them in ``benchmarks/results/SUITE.json``, from
which ``python -m benchmarks.page`` makes ``docs/benchmarks.md``.
"""

from __future__ import annotations

import json
import os
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from benchmarks import beside, bounds, flatness
from jaxq import flags, streams
from jaxq.bench import command, contest, report, solved
from jaxq.bench.suites import Suite

RESULTS = Path(__file__).parent / "results"


def figure(row: dict[str, Any]) -> float:
    """What is compared of a row: its median, or of trainings until they were solved the solved ones per second."""
    trained = solved.trainings(row)
    if trained is None:
        return row["median"]
    return sum(at is not None for at in trained.solved_at_s) / sum(trained.seconds)


def ratios(result: dict[str, Any]) -> list[dict[str, Any]]:
    """The ratios of a suite's result, each with its bar and goal, and those of its turns; None where there
    is none, with what is ``missing``."""

    def row_of(name: str, case: str | None) -> dict[str, Any] | None:
        """A contender's row of that case, of its best where that is None."""
        rows = [row for row in result["rows"] if row["contender"] == name and row["median"]]
        return max((row for row in rows if case in (None, row["case"])), key=lambda row: row["median"], default=None)

    made = []
    for bar in beside.BARS:
        if bar.suite != result["suite"] or not any(row["contender"] == bar.other for row in result["rows"]):
            continue
        ours, other = row_of(bar.ours, bar.case), row_of(bar.other, bar.case)
        ratio, turns, missing = None, None, "no figure"
        if ours and other:
            ratio, missing = (figure(ours) / figure(other), None) if figure(other) else (None, "the other solved none")
            if ratio and solved.trainings(ours) is None:
                turns = [mine / theirs for mine, theirs in zip(ours["rates"], other["rates"], strict=False)]
        made.append({**vars(bar), "ratio": ratio, "turns": turns, "missing": missing})
    return made


def times(row: dict[str, Any]) -> str:
    """A ratio with the smallest and the largest of those of the turns, as text."""
    if row["ratio"] is None:
        return row["missing"]
    turns = row["turns"] or ()
    spread = f" [{report.digits(min(turns))}, {report.digits(max(turns))}]" if len(turns) > 1 else ""
    return f"{report.digits(row['ratio'])}{spread}"


def judged(result: dict[str, Any]) -> dict[str, Any]:
    """A suite's result with its ratios, how flat it is and what is bounded."""
    return {
        **result,
        "ratios": ratios(result),
        "flatness": flatness.flatness(result),
        "bounds": bounds.bounds(result),
    }


def sentence(row: dict[str, Any]) -> str:
    """A ratio as a line of text."""
    where = "each at its best" if row["case"] is None else f"at {report.counted(row['case'])}"
    if row["ratio"] is None:
        return f"{row['ours']} / {row['other']}, {where}: {times(row)}"
    wanted = [f"bar {row['least']:g}"] if row["least"] else []
    wanted += [f"goal {row['goal']:g}"] if row["goal"] else []
    return f"{row['ours']} / {row['other']}, {where}: {times(row)}" + (f" ({', '.join(wanted)})" if wanted else "")


def main(words: Sequence[str] | None = None) -> int:
    parser = flags.Parser(prog="python -m benchmarks", description=(__doc__ or "").splitlines()[0], allow_abbrev=False)
    command.arguments(parser)
    parser.add_argument("--peers", action="store_true", help="the peers too, each in its environment (make peers)")
    # The contenders that a dotted name finds are found from here, wherever this is run.
    root = str(Path(__file__).parent.parent)
    os.environ["PYTHONPATH"] = os.pathsep.join(filter(None, [root, os.environ.get("PYTHONPATH", "")]))
    try:
        options, suites = command.read(parser, sys.argv[1:] if words is None else words, "python -m benchmarks")
    except flags.UsageError as error:
        print(f"python -m benchmarks: error: {error}", file=sys.stderr)
        return 2
    whole = options.cases is options.repeats is options.seconds is None
    ours = {contender.name for suite in suites for contender in suite.contenders}
    failed = []

    def extra(suite: Suite) -> list[contest.Contender]:
        return [*beside.LIMITS.get(suite.name, ()), *(beside.PEERS_OF.get(suite.name, ()) if options.peers else ())]

    def keep(result: dict[str, Any]) -> None:
        result = judged(result)
        told = [*map(sentence, result["ratios"]), *(flatness.sentence(row, result) for row in result["flatness"])]
        for line in [*told, *map(bounds.sentence, result["bounds"])]:
            print(line, file=sys.stderr if options.json else sys.stdout, flush=True)
        if any(row["error"] and row["contender"] in ours for row in result["rows"]):
            failed.append(result["suite"])
            print("not kept: one of ours failed", file=sys.stderr)
        elif whole:
            RESULTS.mkdir(exist_ok=True)
            path = RESULTS / f"{result['suite']}.json"
            made = path.with_suffix(".tmp")
            made.write_text(json.dumps(result, indent=1) + "\n")
            made.replace(path)
            print(path, file=sys.stderr)
        else:
            print("not kept: only whole suites are, without --cases, --repeats and --seconds", file=sys.stderr)

    try:
        with streams.guarded():
            command.run(suites, options, extra, keep)
    except KeyboardInterrupt:
        print(f"interrupted{'; suites that ended are kept' if whole else ''}", file=sys.stderr)
        return 130
    except streams.StdoutError as error:
        print(f"python -m benchmarks: error: {error}", file=sys.stderr)
        return 1
    return 1 if failed else 0


if __name__ == "__main__":
    sys.exit(main())
