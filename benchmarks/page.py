"""``docs/benchmarks.md`` and its pictures, from ``benchmarks/results/*.json``.

python -m benchmarks.page
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import matplotlib

from benchmarks import bounds, curves, flatness
from benchmarks.__main__ import RESULTS, judged, times
from jaxq.bench import report, solved
from jaxq.bench.suites import SUITES

DOCS = Path(__file__).parent.parent / "docs"

HEAD = """# Benchmarks

Made by `python -m benchmarks.page` from `benchmarks/results/*.json`, which `make bench` (ours and the limits of the
machine) and `make bench-peers` (the peers too) write. Every contender runs in a process of its own; they take turns,
case after case, and a figure is the median over the turns with half the range beside it. Compilation is not timed, but
for whole commands. A ratio is of two medians, with the smallest and the largest of the turns behind it. Compare figures
within a table only: the next hour, or another machine, gives others. Each section names its machine and its day.

Peers are at our settings; what they have not is said below the table. Ours use all cores. PyTorch and
stable-baselines3 use one where a name says no other number, the tutorial's NumPy loop uses one.
"""


def page(results: Mapping[str, Mapping[str, Any]]) -> str:
    """The text of the page."""
    parts = [HEAD]
    for name, result in results.items():
        result = judged(result)
        parts += [
            f"## {name}: {SUITES[name].summary}",
            f"`python -m benchmarks {name}{' --peers' if _with_peers(result) else ''}`, {result['began'][:10]}; "
            f"{report.machine(result)}; " + _measure(result),
        ]
        trained = solved.table(result)
        if trained or _counts(result):
            parts.append(f"![{name}](benchmarks/{name}.png)")
        first = trained or report.grid(result, result["axis"])
        parts += [table(lines) for lines in (first, report.notes(result)) if lines]
        if trained:
            parts.append(f"{solved.CAPTION[0].upper()}{solved.CAPTION[1:]}.")
        if told := report.remarks(result):
            parts.append("What is not as ours:\n\n" + "\n".join(f"- {line}" for line in told))
        if result["ratios"]:
            if trained:
                parts.append("Trainings solved per second, beside one another:")
            parts.append(table(ratio_rows(result)))
        if flat := flatness.lines(result):
            parts += [table(flat), flatness.caption(result)]
        if bounded := bounds.lines(result):
            parts.append(table(bounded))
        failed = report.errors(result)
        if failed:
            parts.append("Not run:\n\n" + "\n".join(f"- {line}" for line in failed))
        parts.append(versions(result))
    return "\n\n".join(parts) + "\n"


def _measure(result: Mapping[str, Any]) -> str:
    """What the figures of a suite are, and of how much work."""
    seconds = f"{result['seconds']:g} s"
    if solved.table(result):
        return f"a peer trains seed after seed for at least {seconds}." if _with_peers(result) else "one turn."
    shown = "seconds" if result.get("whole") else f"{result['unit']} per second"
    return f"{shown}, median of {result['repeats']} turns" + (f" of at least {seconds}." if result["seconds"] else ".")


def _counts(result: Mapping[str, Any]) -> bool:
    """Whether the cases are numbers, and so make an axis of a picture."""
    return all(row["case"].isdigit() for row in result["rows"])


def _with_peers(result: Mapping[str, Any]) -> bool:
    from benchmarks import beside

    peers = {contender.name for contender in beside.PEERS_OF.get(result["suite"], ())}
    return any(row["contender"] in peers for row in result["rows"])


def table(lines: list[list[str]]) -> str:
    """Rows as a Markdown table, the first row its head."""
    head, *body = ["| " + " | ".join(line) + " |" for line in lines]
    rule = "| --- |" + " ---: |" * (len(lines[0]) - 1)
    return "\n".join([head, rule, *body])


def ratio_rows(result: Mapping[str, Any]) -> list[list[str]]:
    """The ratios as rows: who, against whom, where, how many times, and what it should be."""
    lines = [["", "against", "at", "times", "bar", "goal"]]
    for row in result["ratios"]:
        case = row["case"]
        where = "each at its best" if case is None else report.counted(case)
        where += f" {result['axis']}" if case and case.isdigit() else ""
        wanted = [f"{row[name]:g}" if row[name] else "" for name in ("least", "goal")]
        lines.append([row["ours"], row["other"], where, times(row), *wanted])
    return lines


def versions(result: Mapping[str, Any]) -> str:
    """One line that names the version of everything that ran."""
    kinds: dict[str, list[str]] = {}
    for name, found in result["versions"].items():
        text = ", ".join(f"{package} {version}" for package, version in found.items())
        kinds.setdefault(text or "did not start", []).append(name)
    return "Versions. " + " ".join(f"{'; '.join(names)}: {text}." for text, names in kinds.items())


def picture(result: Mapping[str, Any], path: Path) -> None:
    """Rates over the number of environments or lanes, a line per contender, both axes logarithmic."""
    import matplotlib.pyplot as plt

    figure, axes = plt.subplots(figsize=(8, 5), layout="constrained")
    names = list(dict.fromkeys(row["contender"] for row in result["rows"]))
    for index, name in enumerate(names):
        rows = [row for row in result["rows"] if row["contender"] == name and row["median"]]
        if not rows:
            continue
        style = {"linewidth": 2.5} if name.startswith("jaxq") else {"linewidth": 1.2, "linestyle": "--"}
        color = plt.get_cmap("tab20")(index % 20)
        counts, medians = [int(row["case"]) for row in rows], [row["median"] for row in rows]
        axes.plot(counts, medians, marker="o", markersize=4, label=name, color=color, **style)
        axes.fill_between(
            counts, [min(row["rates"]) for row in rows], [max(row["rates"]) for row in rows], color=color, alpha=0.2
        )
    flatness.ticks(axes, result)
    axes.set(yscale="log", xlabel=result["axis"], ylabel=f"{result['unit']} per second")
    axes.grid(alpha=0.3)
    axes.legend(fontsize=8, loc="center left", bbox_to_anchor=(1, 0.5))
    figure.savefig(path, dpi=110)
    plt.close(figure)


def main() -> None:
    matplotlib.use("Agg")
    results = {path.stem: json.loads(path.read_text()) for path in RESULTS.glob("*.json")}
    results = {name: results[name] for name in SUITES if name in results}
    (DOCS / "benchmarks").mkdir(exist_ok=True)
    for name, result in results.items():
        if solved.table(result):
            draw = curves.picture
        elif _counts(result):
            draw = flatness.picture if flatness.alone(result) else picture
        else:
            continue
        draw(result, DOCS / "benchmarks" / f"{name}.png")
    (DOCS / "benchmarks.md").write_text(page(results))
    print(DOCS / "benchmarks.md")


if __name__ == "__main__":
    main()
