"""How pictures are dressed: axes, colours, legends, notes; ``save`` writes a PNG or an SVG."""

from __future__ import annotations

import contextlib
import math
import textwrap
from collections.abc import Sequence
from pathlib import Path
from typing import Any, cast

import numpy as np
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.gridspec import SubplotSpec
from matplotlib.lines import Line2D
from matplotlib.ticker import AutoLocator, EngFormatter, MaxNLocator, ScalarFormatter

from jaxq import run_files

#: Settings that have a colour of their own.
MOST_SETTINGS = 8
#: Points of a curve that is drawn over environment steps.
GRID = 200
#: Fewer points than this are marked one by one.
FEW = 30
#: From here on numbers are written with k and M.
LARGE = 10_000
#: Okabe and Ito's colours for every kind of sight, with grey for their yellow, which is too pale for a line.
COLORS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#56B4E9", "#E69F00", "#000000", "#7F7F7F")
#: The mark of a setting that halving stopped at a rung.
STOPPED = "x"
#: From low to high, for every kind of sight.
COLOR_MAP = "viridis"


def save(figure: Figure, path: Path) -> Path:
    """Writes the figure, as its ending says, and returns the path. One that cannot be written leaves the one before."""
    part = run_files.temporary(path)
    try:
        figure.savefig(part, dpi=120, format=path.suffix.lstrip("."))
        part.replace(path)
    except BaseException:
        with contextlib.suppress(OSError):
            part.unlink(missing_ok=True)
        raise
    return path


def figure_of(title: str, x: str, y: str) -> tuple[Figure, Axes]:
    figure = Figure(figsize=(7, 4), layout="constrained")
    axes: Any = figure.subplots()
    dress(axes, title, x, y)
    return figure, axes


def dress(axes: Axes, title: str, x: str, y: str) -> None:
    figure, place = cast(Figure, axes.figure), cast(SubplotSpec, axes.get_subplotspec())
    axes.set_title(textwrap.fill(title, int(8 * figure.get_figwidth() / place.get_gridspec().ncols)))
    axes.set_xlabel(x)
    axes.set_ylabel(y)
    axes.spines[["top", "right"]].set_visible(False)
    axes.grid(alpha=0.25)
    axes.xaxis.set_major_locator(whole())
    axes.xaxis.set_major_formatter(EngFormatter(sep=""))  # 25k for 25000


def measured(axis: Any, values: np.ndarray) -> None:
    """Ticks for the values of a metric, which need not be whole: 0.5, 500, 25k."""
    axis.set_major_locator(AutoLocator())
    large = len(values) and np.abs(values).max() >= LARGE
    axis.set_major_formatter(EngFormatter(sep="") if large else ScalarFormatter(useOffset=False))


def whole() -> MaxNLocator:
    """Ticks at whole numbers. The axis must be longer than 1."""
    return MaxNLocator("auto", steps=[1, 2, 5, 10], integer=True)


def nothing(figure: Figure, text: str, *empty: Axes) -> Figure:
    """Axes without data say why, and have no ticks."""
    for axes in empty:
        axes.set(xticks=[], yticks=[])
        axes.text(0.5, 0.5, text, transform=axes.transAxes, ha="center", va="center", color="0.4")
    return figure


def with_legend(figure: Figure, handles: Sequence[Artist], labels: Sequence[str], note: str = "") -> Figure:
    """One legend below all axes, in as many columns as fit, then with broken labels; the figure grows by its height.
    The lines of the note, its title, are broken where they are longer than the figure is wide.
    """
    if not labels and not note:
        return figure
    width, height = figure.get_size_inches()
    note = "\n".join(textwrap.fill(line, int(14 * width)) for line in note.split("\n"))
    rows = range(1, max(1, len(labels)) + 1)
    tries = [(0, n) for n in rows] + [(letters, len(labels)) for letters in (140, 110, 80, 50)]
    for letters, n in tries:
        texts = [wrapped(label, letters) if letters else label for label in labels]
        legend = figure.legend(
            handles,
            texts,
            loc="outside lower center",
            ncols=max(1, math.ceil(len(labels) / n)),
            frameon=False,
            fontsize="small",
            title=note or None,
            title_fontsize="small",
            borderaxespad=0.2,
        )
        legend.get_title().set_multialignment("center")
        box = legend.get_window_extent()
        if box.width <= 0.97 * width * figure.dpi:
            break
        if (letters, n) != tries[-1]:
            legend.remove()
    for handle in legend.legend_handles:
        if isinstance(handle, Line2D):  # the dot of one among thousands is small
            handle.set_markersize(max(6.0, handle.get_markersize()))
    figure.set_figheight(height + box.height / figure.dpi)
    return figure


def wrapped(label: str, letters: int) -> str:
    """Broken after commas where there are any: a name stays beside its value."""
    glued = label.replace(" ", "\N{NO-BREAK SPACE}").replace(",\N{NO-BREAK SPACE}", ", ")
    return textwrap.fill(glued, letters).replace("\N{NO-BREAK SPACE}", " ")


def marks(points: int) -> dict[str, Any]:
    return {"marker": "o", "markersize": 3.5} if points < FEW else {}
