"""What a person reads at the end of a run: the table per setting, and the final Q-table."""

from __future__ import annotations

import io
import json
from collections.abc import Sequence
from typing import Any

import numpy as np
from rich import box
from rich.console import Console
from rich.table import Table

from jaxq import settings, summaries
from jaxq.summaries import Row

#: The characters of a table's lines, which a terminal may lack.
LINES = "─"
#: Settings that a table shows; of more the best so many.
MOST = 40


def print_json(outcome: Any) -> None:
    """Prints a sweep as one JSON object, a row at a time: lanes, summary, timing."""
    print('{"lanes": [', end="")
    for i, batch in enumerate(outcome.lanes.to_batches(max_chunksize=1000)):
        rows = batch.to_pylist()
        print((", " if i and rows else "") + ", ".join(json.dumps(row) for row in rows), end="")
    print(f'], "summary": {json.dumps(outcome.summary())}, "timing": {json.dumps(outcome.timing.rows())}}}')


def settings_table(summary: Sequence[Row], varied: Sequence[str], *, color: bool = False, plain: bool = False) -> str:
    """One line of text per setting: seeds, solved share, times to success, returns, each with its 95 % interval.

    ``plain`` draws the lines in ASCII.
    """
    table = Table(box=box.ASCII2 if plain else box.SIMPLE_HEAD, pad_edge=False)
    shown, left_out = _best_of(summary)
    columns = _COLUMNS if summary and "eval_return" in summary[0] else _of_outputs(summary, varied)
    headings = [*varied, "seeds", *columns]
    headings += [name for name in ("diverged", "stopped") if any(row.get(name) for row in summary)]
    for heading in headings:
        table.add_column(heading, justify="right")
    for row in shown:
        cells = [settings.shown(row[name]) for name in varied]  # as --json has them: rounded, two may look alike
        cells += [str(row["seeds"]), *(_interval(row, *column) for column in columns.values())]
        table.add_row(*cells, *(str(row[name]) for name in headings[len(cells) :]))
    table.caption = (
        "solved: share of seeds that the stop rule ended, of those that no rung stopped; reached: whose greedy return"
        " is at the environment's threshold; episodes, env steps: Kaplan-Meier medians until solved; final return:"
        " training, last 50 episodes; returns are interquartile means; brackets: 95 % intervals"
        if columns is _COLUMNS
        else "interquartile means; brackets: 95 % intervals"
    )
    if left_out:
        table.caption = f"{len(shown)} of {len(summary)} settings, the best by greedy return. {table.caption}"
    table.caption_justify = "left"
    return _text(table, color)


def _text(table: Table, color: bool = False) -> str:
    # Both sizes: with the width alone rich takes 80 where the terminal calls itself dumb.
    console = Console(file=io.StringIO(), width=200, height=100, force_terminal=color)
    with console.capture() as text:
        console.print(table)
    return "\n".join(line.rstrip() for line in text.get().splitlines()).strip("\n")


#: The columns of a training's table: which value of the summary, and with how many digits.
_COLUMNS = {
    "solved": ("solved", 2),
    "reached": ("reached", 2),
    "episodes": ("median_episodes", 0),
    "env steps": ("median_env_steps", 0),
    "final return": ("final_return", 1),
    "greedy return": ("eval_return", 1),
}


def _of_outputs(summary: Sequence[Row], varied: Sequence[str]) -> dict[str, tuple[str, int]]:
    """The columns of a function's table: every number that it returned."""
    known = {"config", "seeds", "diverged", *varied}
    return {name: (name, 4) for name in (summary[0] if summary else {}) if name not in known and _is_value(name)}


def _is_value(name: str) -> bool:
    return not name.endswith(("_low", "_high"))


def _best_of(summary: Sequence[Row]) -> tuple[list[Row], bool]:
    """At most ``MOST`` rows, and whether some were left out."""
    if len(summary) <= MOST or "eval_return" not in summary[0]:
        return list(summary), False
    return summaries.ranked(summary)[:MOST], True


def rows_table(rows: Sequence[Row], *, words: Sequence[str] = (), plain: bool = False) -> str:
    """Rows as text, a column per name; ``words`` are the columns that begin on the left."""
    table = Table(box=box.ASCII2 if plain else box.SIMPLE_HEAD, pad_edge=False)
    for name in rows[0]:
        table.add_column(name, justify="left" if name in words else "right")
    for row in rows:
        table.add_row(
            *(f"{value:.6g}" if isinstance(value, float) else settings.shown(value) for value in row.values())
        )
    return _text(table)


def q_table(values: np.ndarray, shape: Sequence[int]) -> str:
    """A table of action values [S, A] in the shape of its states, as text."""
    with np.printoptions(precision=4, suppress=True):
        return str(values.reshape(*shape, values.shape[-1]))


def _interval(row: Row, name: str, digits: int) -> str:
    value, low, high = row[name], row[f"{name}_low"], row[f"{name}_high"]
    if value is None:
        return "-"
    if low is None and high is None:
        return f"{value:.{digits}f}"
    ends = ("?" if end is None else f"{end:.{digits}f}" for end in (low, high))  # beyond what was watched
    return f"{value:.{digits}f} [{', '.join(ends)}]"
