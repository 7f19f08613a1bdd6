"""The picture of the trainings that a contest told of: the share of seeds that were solved by then."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from matplotlib.ticker import EngFormatter, MaxNLocator

from jaxq.bench import solved
from jaxq.pictures.dress import COLORS

#: What the left panels show of a seed.
SECONDS = "seconds of a seed, its share where seeds run together"


def picture(result: Mapping[str, Any], path: Path) -> None:
    """A row of axes per setting, over the seconds of a seed and over its environment steps; a line per contender.

    A line starts where nothing is solved, and keeps its last share to the edge.
    """
    import matplotlib.pyplot as plt

    found = [(row["case"], row["contender"], solved.trainings(row)) for row in result["rows"]]
    cases: dict[str, dict[str, solved.Trainings]] = {}
    for case, name, one in found:
        if one is not None:
            cases.setdefault(case, {})[name] = one
    figure, grid = plt.subplots(len(cases), 2, figsize=(11, 3 * len(cases)), layout="constrained", squeeze=False)
    for (case, contenders), (left, right) in zip(cases.items(), grid, strict=True):
        for axes, times, label in (
            (left, {name: one.solved_at_s for name, one in contenders.items()}, SECONDS),
            (right, {name: one.solved_at_step for name, one in contenders.items()}, "environment steps"),
        ):
            axes.set(xlabel=label, ylabel="share of seeds solved", ylim=(0, 1.03), title=case)
            axes.grid(alpha=0.3)
            _lines(axes, times, log=axes is left)
        right.legend(fontsize=8, loc="center left", bbox_to_anchor=(1, 0.5))
    figure.savefig(path, dpi=110)
    plt.close(figure)


def _lines(axes: Any, times: Mapping[str, Sequence[float | None]], *, log: bool) -> None:
    """The steps of each contender, all to the same edge."""
    known = [time for each in times.values() for time in each if time is not None]
    first, last = (min(known), max(known)) if known else (1.0, 1.0)
    start, edge = (first / 2, last * 2) if log else (0.0, last * 1.05)
    for index, (name, each) in enumerate(times.items()):
        at, share = solved.curve(each)
        ours = name.startswith("jaxq")
        axes.step(
            [start, *at, edge],
            [0.0, *share, share[-1] if share else 0.0],
            where="post",
            label=f"{name} ({len(each):,} seed{'s' * (len(each) != 1)})",
            color=COLORS[index % len(COLORS)],
            linestyle="-" if ours else "--",
            linewidth=2.0 if ours else 1.4,
        )
    axes.set(xscale="log" if log else "linear", xlim=(start, edge))
    if not log:
        axes.xaxis.set_major_locator(MaxNLocator(5))
        axes.xaxis.set_major_formatter(EngFormatter())
