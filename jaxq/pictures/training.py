"""The tutorial's two pictures of one training: its action values and its episodes."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from jaxq.pictures.dress import COLORS, GRID, figure_of, marks, nothing, whole, with_legend

WINDOW = 50


def q_values(max_q: np.ndarray) -> Figure:
    """The tutorial's first picture: the value bootstrapped from, at every training step. max_q [updates].

    Values that go over many decades, as those of a training that diverges, have a logarithmic scale.
    """
    figure, axes = figure_of("Q-values over training steps", "training step", "Q-value")
    x, y = _points(max_q)
    finite = np.isfinite(y)
    if not finite.any():
        return nothing(figure, "no update with a finite value" if len(y) else "no updates", axes)
    y[~finite] = np.nan
    sizes = np.abs(y[finite])
    if sizes.max() > 1e4 * max(1.0, np.percentile(sizes, 25, method="lower")):
        axes.set_yscale("symlog", linthresh=1, linscale=math.log10(sizes.max()) / 8)
        locator: Any = axes.yaxis.get_major_locator()
        locator.set_params(numticks=9)
    axes.plot(x, y, linewidth=0.4, color=COLORS[0], alpha=0.5, label="each step", **marks(int(finite.sum())))
    _draw_mean(axes, x, y, max(WINDOW, len(y) // GRID), COLORS[0])
    gone = ~finite & (x > x[finite][0])
    if gone.any():
        first = x[gone][0]
        axes.axvline(first, color=COLORS[1], linestyle="--", linewidth=0.9, label=f"not finite from step {first}")
    axes.set_xlim(0, 1.02 * len(y) + 1)
    if np.ptp(y[finite]) == 0:
        around = max(1.0, 0.1 * sizes[0])
        axes.set_ylim(y[finite][0] - around, y[finite][0] + around)
    return with_legend(figure, *axes.get_legend_handles_labels())


def episode_lengths(lengths: np.ndarray, *, success_at: float | None = None) -> Figure:
    """The tutorial's second picture: how long each training episode lasted, with the mean of the last 50."""
    figure, axes = figure_of("Successful steps over training episodes", "training episode", "steps per episode")
    if not len(lengths):
        return nothing(figure, "no finished episode", axes)
    x, y = _points(lengths)
    axes.plot(x, y, linewidth=0.7, color=COLORS[0], alpha=0.6, label="each episode", **marks(len(y)))
    _draw_mean(axes, x, y, WINDOW, COLORS[1])
    if success_at is not None:
        axes.axhline(success_at, color="0.5", linestyle="--", linewidth=0.8, label=f"success: {success_at:g} steps")
    axes.set_xlim(0, 1.02 * len(y) + 1)
    axes.set_ylim(bottom=0)
    axes.yaxis.set_major_locator(whole())
    return with_legend(figure, *axes.get_legend_handles_labels())


def _points(values: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Their numbers, counted from 1, and the values, in an array of their own."""
    return np.arange(1, len(values) + 1), np.array(values, float)


def _draw_mean(axes: Axes, x: np.ndarray, y: np.ndarray, width: int, color: str) -> None:
    """The mean of the last ``width`` values, where there are so many and all are finite."""
    if len(y) < width:
        return
    mean = np.convolve(y, np.ones(width) / width, mode="valid")
    if known := int(np.isfinite(mean).sum()):
        axes.plot(x[width - 1 :], mean, color=color, label=f"mean of {width}", **marks(known))
