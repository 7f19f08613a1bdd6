"""Our suites beside the limits of the machine and, with ``--peers``, beside the peers.

    python -m benchmarks [SUITE ...] [--peers]

Prints a table of each suite, its ratios and how flat it is, and keeps them in ``benchmarks/results/SUITE.json``, from
which ``python -m benchmarks.page`` makes ``docs/benchmarks.md``.
"""

from __future__ import annotations

import argparse
import json
import os
import sys
from pathlib import Path
from typing import Any

from benchmarks import beside, flatness
from jaxq.bench import command, contest, report
from jaxq.bench.suites import Suite

RESULTS = Path(__file__).parent / "results"


def ratios(result: dict[str, Any]) -> list[dict[str, Any]]:
    """The ratios of a suite's result, each with its bar and goal; None where a contender has no figure."""
    found = {(row["contender"], row["case"]): row["median"] for row in result["rows"]}
    made = []
    for bar in beside.BARS:
        if bar.suite != result["suite"] or not any(name == bar.other for name, _ in found):
            continue
        if bar.case is None:
            ours, other = contest.best(result, bar.ours), contest.best(result, bar.other)
        else:
            ours, other = found.get((bar.ours, bar.case)), found.get((bar.other, bar.case))
        ratio = ours / other if ours and other else None
        made.append({**vars(bar), "ratio": ratio})
    return made


def sentence(row: dict[str, Any]) -> str:
    """A ratio as a line of text."""
    where = "each at its best" if row["case"] is None else f"at {report.counted(row['case'])}"
    if row["ratio"] is None:
        return f"{row['ours']} / {row['other']}, {where}: no figure"
    wanted = [f"bar {row['least']:g}"] if row["least"] else []
    wanted += [f"goal {row['goal']:g}"] if row["goal"] else []
    return f"{row['ours']} / {row['other']}, {where}: {row['ratio']:.3g}" + (
        f" ({', '.join(wanted)})" if wanted else ""
    )


def main() -> int:
    parser = argparse.ArgumentParser(prog="python -m benchmarks", description=(__doc__ or "").splitlines()[0])
    command.arguments(parser)
    parser.add_argument("--peers", action="store_true", help="the peers too, each in its environment (make peers)")
    options = parser.parse_args()
    # The contenders that a dotted name finds are found from here, wherever this is run.
    root = str(Path(__file__).parent.parent)
    os.environ["PYTHONPATH"] = os.pathsep.join(filter(None, [root, os.environ.get("PYTHONPATH", "")]))

    def extra(suite: Suite) -> list[contest.Contender]:
        return [*beside.LIMITS.get(suite.name, ()), *(beside.PEERS_OF.get(suite.name, ()) if options.peers else ())]

    try:
        results = command.run(options, extra)
    except ValueError as error:
        parser.error(str(error))
    RESULTS.mkdir(exist_ok=True)
    for name, result in results.items():
        result["ratios"] = ratios(result)
        result["flatness"] = flatness.flatness(result)
        told = [*map(sentence, result["ratios"]), *(flatness.sentence(row, result) for row in result["flatness"])]
        for line in told:
            print(line, file=sys.stderr if options.json else sys.stdout)
        path = RESULTS / f"{name}.json"
        path.write_text(json.dumps(result, indent=1) + "\n")
        print(path, file=sys.stderr)
    return 0


if __name__ == "__main__":
    sys.exit(main())
