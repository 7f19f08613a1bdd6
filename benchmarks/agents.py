"""The table of ``docs/agents.md``: every tabular preset on the discretised CartPole, by ``jaxq sweep``.

    python -m benchmarks.agents [--seeds 64]

Runs ``jaxq sweep PRESET --seeds N --json`` for each and writes the rows between the marks of the page.
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from jaxq.machine import processor
from jaxq.presets import TabularSettings, preset, presets
from jaxq.settings import shown

PAGE = Path(__file__).parent.parent / "docs" / "agents.md"
BEGIN, END = "<!-- begin: python -m benchmarks.agents -->", "<!-- end -->"
#: What the presets are told apart from.
BASE = "q-learning"


def names() -> list[str]:
    """The presets with a table."""
    return [p.name for p in presets() if isinstance(p.settings, TabularSettings)]


def parts(name: str) -> str:
    """What a preset has otherwise than ``BASE``, as flags."""
    base, own = preset(BASE).settings.flat(), preset(name).settings.flat()
    flags = [f"--{key.replace('_', '-')} {shown(own[key])}" for key in own if own[key] != base[key]]
    return f"`{' '.join(flags)}`" if flags else ""


def sweep(name: str, seeds: int) -> dict[str, Any]:
    """The only row of a sweep's summary, with the seconds of its run."""
    words = [
        "sweep",
        name,
        "--seeds",
        str(seeds),
        "--json",
        "--no-progress",
        "--out",
        f"runs/agents-{name}",
        "--overwrite",
    ]
    done = subprocess.run([sys.executable, "-m", "jaxq", *words], stdout=subprocess.PIPE, check=True)
    told = json.loads(done.stdout)
    return {**told["summary"][0], **told["timing"]}


def between(row: Mapping[str, Any], field: str, digits: int = 0) -> str:
    """A value with its interval."""
    if row[field] is None:
        return "-"
    ends = [row[f"{field}_{end}"] for end in ("low", "high")]
    low, high = ("-" if end is None else f"{end:,.{digits}f}" for end in ends)
    return f"{row[field]:,.{digits}f} [{low}, {high}]"


def table(rows: Mapping[str, Mapping[str, Any]]) -> str:
    """The Markdown of what the sweeps gave."""
    lines = [
        "| preset | beside `q-learning` | solved | episodes until then | env steps until then | greedy return, end |",
        "| --- | --- | --- | --- | --- | --- |",
    ]
    for name, row in rows.items():
        cells = [
            f"`{name}`",
            parts(name),
            between(row, "solved", 2),
            between(row, "median_episodes"),
            between(row, "median_env_steps"),
            between(row, "eval_return"),
        ]
        lines.append(f"| {' | '.join(cells)} |")
    return "\n".join(lines)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seeds", type=int, default=64)
    seeds = parser.parse_args().seeds
    rows = {}
    for name in names():
        rows[name] = sweep(name, seeds)
        print(f"{name}: solved {between(rows[name], 'solved', 2)}, {rows[name]['run_s']:.1f} s", file=sys.stderr)
    about = f"`jaxq sweep PRESET --seeds {seeds}`, on an {processor()}; brackets are 95 % intervals."
    head, _, rest = PAGE.read_text().partition(BEGIN)
    _, _, tail = rest.partition(END)
    PAGE.write_text(f"{head}{BEGIN}\n{about}\n\n{table(rows)}\n{END}{tail}")


if __name__ == "__main__":
    main()
