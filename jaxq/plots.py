"""Pictures as matplotlib figures, drawn off screen; ``save`` writes a PNG."""

from __future__ import annotations

import contextlib
import math
import textwrap
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import EngFormatter, MaxNLocator

from jaxq import run_files
from jaxq.tables import Row

WINDOW = 50
MOST_SETTINGS = 8
GRID = 200
#: Fewer points than this are marked one by one.
FEW = 30
#: The axes of a sweep are cut when the longest lane ran more than this many times as long as 98 of 100.
MUCH_LONGER = 1.5
#: Okabe and Ito's colours for every kind of sight, with grey for their yellow, which is too pale for a line.
COLORS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#56B4E9", "#E69F00", "#000000", "#7F7F7F")


def q_values(max_q: np.ndarray) -> Figure:
    """The tutorial's first picture: the value bootstrapped from, at every training step. max_q [updates].

    Values that go over many decades, as those of a training that diverges, have a logarithmic scale.
    """
    figure, axes = _figure("Q-values over training steps", "training step", "Q-value")
    x, y = _points(max_q)
    finite = np.isfinite(y)
    if not finite.any():
        return _nothing(figure, "no update with a finite value" if len(y) else "no updates", axes)
    y[~finite] = np.nan
    sizes = np.abs(y[finite])
    if sizes.max() > 1e4 * max(1.0, np.percentile(sizes, 25, method="lower")):
        axes.set_yscale("symlog", linthresh=1, linscale=math.log10(sizes.max()) / 8)
        locator: Any = axes.yaxis.get_major_locator()
        locator.set_params(numticks=9)
    axes.plot(x, y, linewidth=0.4, color=COLORS[0], alpha=0.5, label="each step", **_marks(int(finite.sum())))
    _draw_mean(axes, x, y, max(WINDOW, len(y) // GRID), COLORS[0])
    gone = ~finite & (x > x[finite][0])
    if gone.any():
        first = x[gone][0]
        axes.axvline(first, color=COLORS[1], linestyle="--", linewidth=0.9, label=f"not finite from step {first}")
    axes.set_xlim(0, 1.02 * len(y) + 1)
    if np.ptp(y[finite]) == 0:
        around = max(1.0, 0.1 * sizes[0])
        axes.set_ylim(y[finite][0] - around, y[finite][0] + around)
    return _with_legend(figure, *axes.get_legend_handles_labels())


def episode_lengths(lengths: np.ndarray, *, success_at: float | None = None) -> Figure:
    """The tutorial's second picture: how long each training episode lasted, with the mean of the last 50."""
    figure, axes = _figure("Successful steps over training episodes", "training episode", "steps per episode")
    if not len(lengths):
        return _nothing(figure, "no finished episode", axes)
    x, y = _points(lengths)
    axes.plot(x, y, linewidth=0.7, color=COLORS[0], alpha=0.6, label="each episode", **_marks(len(y)))
    _draw_mean(axes, x, y, WINDOW, COLORS[1])
    if success_at is not None:
        axes.axhline(success_at, color="0.5", linestyle="--", linewidth=0.8, label=f"success: {success_at:g} steps")
    axes.set_xlim(0, 1.02 * len(y) + 1)
    axes.set_ylim(bottom=0)
    axes.yaxis.set_major_locator(_whole())
    return _with_legend(figure, *axes.get_legend_handles_labels())


def learning_curves(lanes: Sequence[Row], curves: Sequence[Row], labels: dict[int, str]) -> Figure:
    """A sweep's picture: per setting the median training return with its quartiles, and the share of solved lanes,
    over environment steps. A lane's curve begins at its first point, and a lane that ended keeps its last return. At
    most eight settings, those of highest return. When a few lanes ran much longer than the rest the axes end where 98
    of 100 have ended, and the final share stands at the edge where it is another. What is left out is said above the
    legend.
    """
    figure = Figure(figsize=(11, 4), layout="constrained")
    left, right = figure.subplots(1, 2)
    by_config = _grouped(lanes)
    means = {c: np.mean([_finite(row["final_return"]) or 0.0 for row in rows]) for c, rows in by_config.items()}
    shown = sorted(sorted(means, key=lambda c: (-means[c], c))[:MOST_SETTINGS])
    ends = [row["env_steps"] for c in shown for row in by_config[c]]
    counts = {len(by_config[c]) for c in shown}
    of = f"{n} lane{'s' * (n > 1)}" if len(counts) == 1 and (n := max(counts)) else "the setting's lanes"
    statistic = "return per episode" if counts == {1} else f"return: median, quartiles of {of}"
    _dress(left, "return of training episodes", "environment steps", statistic)
    _dress(right, "share of lanes solved", "environment steps", f"share of {of}")
    if not shown:
        return _nothing(figure, "no lanes", left, right)
    last = int(np.percentile(ends, 98, method="inverted_cdf"))
    last = max(1, last if max(ends) > MUCH_LONGER * last else max(ends))
    grid = np.linspace(0, last, GRID)
    right.set_ylim(-0.03, 1.03)
    curves_of = _grouped(curves)
    handles, rises = [], []
    for i, config in enumerate(shown):
        look: dict[str, Any] = {"color": COLORS[i], "linestyle": (0, (4, 2)) if i % 2 else "-"}
        values = _on_grid(curves_of.get(config, []), grid)
        known = np.isfinite(values).any(axis=0)
        if known.any():
            low, middle, high = np.nanpercentile(values[:, known], [25, 50, 75], axis=0)
            left.plot(grid[known], middle, **look, **(_marks(1) if known.sum() == 1 else {}))
            left.fill_between(grid[known], low, high, color=COLORS[i], alpha=0.15, linewidth=0)
        rows = by_config[config]
        handles += right.plot([], [], **look)
        if rows[0].get("success_window") == 0:  # nobody looks for success
            continue
        times = np.sort([row["solved_at_step"] for row in rows if row["solved_at_step"] is not None])
        solved = np.searchsorted(times, grid, side="right") / len(rows)
        right.step(grid, solved, where="post", **look)
        if f"{solved[-1]:.2f}" != f"{len(times) / len(rows):.2f}":
            rises.append((len(times) / len(rows), float(solved[-1]), COLORS[i]))
    if not left.lines:
        _nothing(figure, "no finished episode", left)
    if len(right.lines) == len(shown):  # their keys in the legend alone
        _nothing(figure, "no setting looks for success", right)
    for axes in (left, right):
        axes.set_xlim(-0.03 * last, 1.02 * last)
    _mark_rises(right, last, rises)
    notes = _notes([by_config[c] for c in shown], len(by_config), last, bool(rises))
    return _with_legend(figure, handles, [labels[c] for c in shown], notes)


def save(figure: Figure, path: Path) -> Path:
    """Writes the figure and returns the path. A picture that cannot be written leaves the one before it."""
    part = run_files.temporary(path)
    try:
        figure.savefig(part, dpi=120, format="png")
        part.replace(path)
    except BaseException:
        with contextlib.suppress(OSError):
            part.unlink(missing_ok=True)
        raise
    return path


def _grouped(rows: Sequence[Row]) -> dict[int, list[Row]]:
    groups: dict[int, list[Row]] = {}
    for row in rows:
        groups.setdefault(row["config"], []).append(row)
    return groups


def _finite(value: float | None) -> float | None:
    return value if value is not None and math.isfinite(value) else None


def _on_grid(rows: Sequence[Row], grid: np.ndarray) -> np.ndarray:
    """Each lane's latest training return at each point of the grid, NaN before its first, [lanes, points].

    Not a line between the points: the median of lanes half way up and half way down would dip where none does.
    """
    by_seed: dict[int, list[tuple[int, float]]] = {}
    for row in rows:
        if (value := _finite(row["train_return"])) is not None:
            by_seed.setdefault(row["seed"], []).append((row["env_steps"], value))
    values = np.full((len(by_seed), len(grid)), np.nan)
    for i, points in enumerate(by_seed.values()):
        steps, returns = np.array(sorted(points), float).T
        latest = np.searchsorted(steps, grid, side="right") - 1
        values[i] = np.where(latest < 0, np.nan, returns[latest])
    return values


def _notes(shown: Sequence[Sequence[Row]], settings: int, last: int, rises: bool) -> str:
    """What the picture of a sweep does not show."""
    notes = []
    lanes = [row for rows in shown for row in rows]
    if settings > len(shown):
        notes.append(f"{len(shown)} of {settings} settings, those of highest return")
    if (longest := max(row["env_steps"] for row in lanes)) > last:
        ended = sum(row["env_steps"] <= last for row in lanes)
        note = f"the axes end where {ended} of {len(lanes)} lanes have ended; the longest ran "
        note += EngFormatter(places=1, sep="")(longest) + " steps"
        notes.append(note + ("; numbers at the edge: final shares" if rises else ""))
    if diverged := sum(row["status"] == "diverged" for row in lanes):
        notes.append(f"{diverged} of {len(lanes)} lanes diverged and keep their last return")
    return "\n".join(notes)


def _mark_rises(axes: Axes, last: int, rises: Sequence[tuple[float, float, str]]) -> None:
    """The final shares that differ from what is drawn up to ``last``, beside the axes. No number lies on another, and
    one that several settings share is grey.
    """
    colors: dict[str, set[str]] = {}
    for final, drawn, color in rises:
        axes.plot([last, 1.05 * last], [drawn, final], color=color, linestyle=":", clip_on=False)
        axes.plot(1.05 * last, final, color=color, marker="o", markersize=3.5, clip_on=False)
        colors.setdefault(f"{final:.2f}", set()).add(color)
    gap, at = 0.055, np.inf
    for below, text in reversed(list(enumerate(sorted(colors)))):
        at = max(min(float(text), at - gap), gap * below)
        color = colors[text].pop() if len(colors[text]) == 1 else "0.2"
        axes.text(1.065 * last, at, text, color=color, fontsize="small", va="center")


def _points(values: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Their numbers, counted from 1, and the values, in an array of their own."""
    return np.arange(1, len(values) + 1), np.array(values, float)


def _draw_mean(axes: Axes, x: np.ndarray, y: np.ndarray, width: int, color: str) -> None:
    """The mean of the last ``width`` values, where there are so many and all are finite."""
    if len(y) < width:
        return
    mean = np.convolve(y, np.ones(width) / width, mode="valid")
    if known := int(np.isfinite(mean).sum()):
        axes.plot(x[width - 1 :], mean, color=color, label=f"mean of {width}", **_marks(known))


def _marks(points: int) -> dict[str, Any]:
    return {"marker": "o", "markersize": 3.5} if points < FEW else {}


def _figure(title: str, x: str, y: str) -> tuple[Figure, Axes]:
    figure = Figure(figsize=(7, 4), layout="constrained")
    axes: Any = figure.subplots()
    _dress(axes, title, x, y)
    return figure, axes


def _dress(axes: Axes, title: str, x: str, y: str) -> None:
    axes.set_title(title)
    axes.set_xlabel(x)
    axes.set_ylabel(y)
    axes.spines[["top", "right"]].set_visible(False)
    axes.grid(alpha=0.25)
    axes.xaxis.set_major_locator(_whole())
    axes.xaxis.set_major_formatter(EngFormatter(sep=""))  # 25k for 25000


def _whole() -> MaxNLocator:
    """Ticks at whole numbers. The axis must be longer than 1."""
    return MaxNLocator("auto", steps=[1, 2, 5, 10], integer=True)


def _nothing(figure: Figure, text: str, *empty: Axes) -> Figure:
    """Axes without data say why, and have no ticks."""
    for axes in empty:
        axes.set(xticks=[], yticks=[])
        axes.text(0.5, 0.5, text, transform=axes.transAxes, ha="center", va="center", color="0.4")
    return figure


def _with_legend(figure: Figure, handles: Sequence[Artist], labels: Sequence[str], note: str = "") -> Figure:
    """One legend below all axes, in as many columns as fit, then with broken labels; the figure grows by its height."""
    width, height = figure.get_size_inches()
    rows = range(1, len(labels) + 1)
    tries = [(0, n) for n in rows] + [(letters, len(labels)) for letters in (140, 110, 80, 50)]
    for letters, n in tries:
        texts = [_wrapped(label, letters) if letters else label for label in labels]
        legend = figure.legend(
            handles,
            texts,
            loc="outside lower center",
            ncols=math.ceil(len(labels) / n),
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
    figure.set_figheight(height + box.height / figure.dpi)
    return figure


def _wrapped(label: str, letters: int) -> str:
    """Broken after commas where there are any: a name stays beside its value."""
    glued = label.replace(" ", "\N{NO-BREAK SPACE}").replace(",\N{NO-BREAK SPACE}", ", ")
    return textwrap.fill(glued, letters).replace("\N{NO-BREAK SPACE}", " ")
