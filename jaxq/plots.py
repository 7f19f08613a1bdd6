"""Pictures as matplotlib figures, drawn off screen; ``save`` writes a PNG."""

from __future__ import annotations

import contextlib
import textwrap
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import EngFormatter, MaxNLocator

from jaxq import run_files
from jaxq.tables import Row

WINDOW = 50
GRID = 200
#: Fewer points than this are marked: a line through one point is invisible.
FEW = 30
#: Okabe and Ito's colours, which the colour-blind can tell apart; as many settings are drawn.
COLORS = ("#0072B2", "#E69F00", "#009E73", "#CC79A7", "#56B4E9", "#D55E00", "#000000", "#B8A800")
#: Of a legend in a small font: characters of a line as wide as the picture of a sweep, and inches of its height.
LINE_CHARACTERS, LINE_INCHES = 130, 0.19


def q_values(max_q: np.ndarray) -> Figure:
    """The tutorial's first picture: the value bootstrapped from, at every training step. max_q [updates]."""
    figure, axes = _figure("Q-values over training steps", "training step", "Q-value")
    max_q = np.where(np.isfinite(max_q), max_q, np.nan)
    if np.isnan(max_q).all():
        _nothing(axes, "no finite value")
        return figure
    steps = np.arange(1, len(max_q) + 1)
    axes.plot(steps, max_q, linewidth=0.4, color=COLORS[0], alpha=0.5, label="each step", **_marks(max_q))
    if len(max_q) >= WINDOW:
        width = max(WINDOW, len(max_q) // GRID)
        smooth = np.convolve(max_q, np.ones(width) / width, mode="valid")
        if np.isfinite(smooth).any():
            axes.plot(steps[width - 1 :], smooth, color=COLORS[0], label=f"mean of {width}")
            axes.legend(frameon=False)
    axes.set_xlim(0, len(max_q) + 1)
    return figure


def episode_lengths(lengths: np.ndarray, *, success_at: float | None = None) -> Figure:
    """The tutorial's second picture: how long each training episode lasted, with the mean of the last 50."""
    figure, axes = _figure("Successful steps over training episodes", "training episode", "steps")
    if not len(lengths):
        _nothing(axes, "no episode ended")
        return figure
    episodes = np.arange(1, len(lengths) + 1)
    axes.plot(episodes, lengths, linewidth=0.7, color=COLORS[0], alpha=0.6, label="each episode", **_marks(lengths))
    if len(lengths) >= WINDOW:
        mean = np.convolve(lengths, np.ones(WINDOW) / WINDOW, mode="valid")
        axes.plot(episodes[WINDOW - 1 :], mean, color=COLORS[1], label=f"mean of {WINDOW}")
    if success_at is not None:
        axes.axhline(success_at, color="0.5", linestyle="--", linewidth=0.8, label="success")
    axes.set_xlim(0, len(lengths) + 1)
    axes.set_ylim(bottom=0)
    axes.legend(frameon=False)
    return figure


def learning_curves(lanes: Sequence[Row], curves: Sequence[Row], labels: dict[int, str]) -> Figure:
    """A sweep's picture: per setting the median training return with its quartiles, and the share of solved lanes,
    over environment steps. A lane that ended keeps its last return.

    As many settings as there are colours, those of highest return; the axis ends where 98 of 100 lanes have ended, and
    the legend has the shares in the end. Both are said in the picture where they leave something out.
    """
    by_config, curves_of = _grouped(lanes), _grouped(curves)
    means = {c: np.mean([row["final_return"] or 0.0 for row in rows]) for c, rows in by_config.items()}
    shown = sorted(sorted(by_config, key=lambda c: -means[c])[: len(COLORS)])
    names = {config: _name(labels[config], by_config[config]) for config in shown}
    columns = max(1, LINE_CHARACTERS // (max(map(len, names.values()), default=0) + 8))
    lines = [textwrap.fill(name, LINE_CHARACTERS, subsequent_indent="    ") for name in names.values()]
    rows_of_legend = -(-len(lines) // columns) * max((1 + line.count("\n") for line in lines), default=1) + 1
    figure = Figure(figsize=(11, 4.2 + LINE_INCHES * rows_of_legend), layout="constrained")
    left, right = figure.subplots(1, 2)
    ended = np.array([row["env_steps"] for row in lanes] or [1])
    end = np.percentile(ended, 98, method="higher")
    steps = "environment steps" + (" (some lanes run on to the right)" if ended.max() > end else "")
    _dress(left, "return of training episodes", steps, "return (median, quartiles)")
    _dress(right, "share of lanes solved", steps, "share")
    right.set_ylim(-0.03, 1.03)
    left.set_xlim(0, end)
    right.set_xlim(0, end)
    grid = np.linspace(0, end, GRID)
    handles = []
    for config, color in zip(shown, COLORS, strict=False):
        rows = by_config[config]
        values = _on_grid(curves_of.get(config, []), grid)
        inside = np.isfinite(values).any(axis=0)
        low, middle, high = np.nanpercentile(values[:, inside], [25, 50, 75], axis=0) if inside.any() else [[]] * 3
        left.fill_between(grid[inside], low, high, color=color, alpha=0.2, linewidth=0)
        handles += left.plot(grid[inside], middle, color=color, **_marks(grid[inside]))
        if _looks_for_success(rows):
            times = np.sort([row["solved_at_step"] for row in rows if row["solved_at_step"] is not None])
            right.step(grid, np.searchsorted(times, grid, side="right") / len(rows), where="post", color=color)
    if not left.has_data() or not np.isfinite(left.dataLim.get_points()).all():
        _nothing(left, "no episode ended")
    if not right.has_data():
        _nothing(right, "no setting ends by success")
    dropped = len(by_config) - len(shown)
    title = f"{len(shown)} of {len(by_config)} settings, those of highest return" if dropped else None
    place: dict[str, Any] = {"loc": "outside lower center", "ncols": columns, "title": title}
    figure.legend(handles, lines, frameon=False, fontsize="small", title_fontsize="small", **place)
    return figure


def save(figure: Figure, path: Path) -> Path:
    """Writes the figure, whole or not at all, and returns the path. Raises OSError."""
    temporary = run_files.temporary(path)
    try:
        figure.savefig(temporary, dpi=120, format="png")
        temporary.replace(path)
    except OSError:
        with contextlib.suppress(OSError):
            temporary.unlink()
        raise
    return path


def _name(label: str, rows: Sequence[Row]) -> str:
    """A setting in the legend: what varied, and the share of its lanes that is solved in the end."""
    if not _looks_for_success(rows):
        return label
    return f"{label}: {sum(row['status'] == 'solved' for row in rows) / len(rows):.2f} solved"


def _looks_for_success(rows: Sequence[Row]) -> bool:
    return rows[0].get("success_window") != 0


def _grouped(rows: Sequence[Row]) -> dict[int, list[Row]]:
    groups: dict[int, list[Row]] = {}
    for row in rows:
        groups.setdefault(row["config"], []).append(row)
    return groups


def _on_grid(rows: Sequence[Row], grid: np.ndarray) -> np.ndarray:
    """Each lane's latest training return at each point of the grid, NaN before its first, [lanes, points]."""
    by_seed: dict[int, list[tuple[int, float]]] = {}
    for row in rows:
        if row["train_return"] is not None:
            by_seed.setdefault(row["seed"], []).append((row["env_steps"], row["train_return"]))
    values = np.full((len(by_seed), len(grid)), np.nan)
    for i, points in enumerate(by_seed.values()):
        steps, returns = np.array(sorted(points)).T
        latest = np.searchsorted(steps, grid, side="right") - 1
        values[i] = np.where(latest < 0, np.nan, returns[latest])
    return values


def _marks(points: np.ndarray) -> dict[str, Any]:
    return {"marker": "o", "markersize": 3} if np.isfinite(points).sum() < FEW else {}


def _nothing(axes: Axes, why: str) -> None:
    """An empty picture says why it is, and has no numbers that mean nothing."""
    axes.text(0.5, 0.5, why, transform=axes.transAxes, ha="center", va="center", color="0.4")
    axes.set_xticks([])
    axes.set_yticks([])


def _figure(title: str, x: str, y: str) -> tuple[Figure, Axes]:
    figure = Figure(figsize=(7, 4), layout="constrained")
    axes: Any = figure.subplots()
    _dress(axes, title, x, y)
    return figure, axes


def _dress(axes: Axes, title: str, x: str, y: str) -> None:
    """Title and labels; the x axis counts something, so its ticks are whole numbers."""
    axes.set_title(title)
    axes.set_xlabel(x)
    axes.set_ylabel(y)
    axes.spines[["top", "right"]].set_visible(False)
    axes.grid(alpha=0.25)
    axes.xaxis.set_major_locator(MaxNLocator("auto", integer=True, steps=[1, 2, 2.5, 5, 10]))
    axes.xaxis.set_major_formatter(EngFormatter(sep=""))  # 25k for 25000
