"""What a person reads at the end of a run: the table per setting, and the final Q-table."""

from __future__ import annotations

import io
from collections.abc import Sequence

import numpy as np
from rich import box
from rich.console import Console
from rich.table import Table

from jaxq.tables import Row

#: The characters of a table's lines, which a terminal may lack.
LINES = "─"


def settings_table(summary: Sequence[Row], varied: Sequence[str], *, color: bool = False, plain: bool = False) -> str:
    """One line of text per setting: seeds, solved share, times to success, returns, each with its 95 % interval.

    ``plain`` draws the lines in ASCII.
    """
    table = Table(box=box.ASCII2 if plain else box.SIMPLE_HEAD, pad_edge=False)
    headings = [*varied, "seeds", "solved", "episodes", "env steps", "final return", "greedy return"]
    if any(row["diverged"] for row in summary):
        headings.append("diverged")
    for heading in headings:
        table.add_column(heading, justify="right")
    for row in summary:
        cells = [str(row[name]) for name in varied]  # as --json has them: rounded, two may look alike
        cells += [
            str(row["seeds"]),
            _interval(row, "solved", 2),
            _cell(row["median_episodes"]),
            _cell(row["median_env_steps"]),
            _interval(row, "final_return", 1),
            _interval(row, "eval_return", 1),
        ]
        if "diverged" in headings:
            cells.append(str(row["diverged"]))
        table.add_row(*cells)
    table.caption = (
        "solved: share of seeds; episodes, env steps: medians to success over all seeds; final return: training, last"
        " 50 episodes; returns are interquartile means; brackets: 95 % intervals"
    )
    table.caption_justify = "left"
    # Both sizes: with the width alone rich takes 80 where the terminal calls itself dumb.
    console = Console(file=io.StringIO(), width=200, height=100, force_terminal=color)
    with console.capture() as text:
        console.print(table)
    return "\n".join(line.rstrip() for line in text.get().splitlines()).strip("\n")


def q_table(values: np.ndarray, num_buckets: Sequence[int]) -> str:
    """A table of action values in the shape of its buckets, as text."""
    with np.printoptions(precision=4, suppress=True):
        return str(values.reshape(*num_buckets, -1))


def _interval(row: Row, name: str, digits: int) -> str:
    value, low, high = row[name], row[f"{name}_low"], row[f"{name}_high"]
    if value is None:
        return "-"
    if low is None:
        return f"{value:.{digits}f}"
    return f"{value:.{digits}f} [{low:.{digits}f}, {high:.{digits}f}]"


def _cell(value: object) -> str:
    if value is None:
        return "-"
    return f"{value:g}" if isinstance(value, float) and abs(value) < 1e6 else str(value)
