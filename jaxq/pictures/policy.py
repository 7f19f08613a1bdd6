"""A trained agent on CartPole: its action values and actions over the pole's plane, and what it promises beside what
follows.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from matplotlib.colors import ListedColormap
from matplotlib.figure import Figure

from jaxq.pictures.dress import COLOR_MAP, COLORS, FEW, nothing, with_legend

QValues = Callable[[np.ndarray], np.ndarray]
#: Points of the plane along each side.
SIDE = 161
#: More points than this are drawn as a density.
FEW_POINTS = 2000
AT_REST, NOT_FINITE = "the cart at rest in the middle", "action values that are not finite"


def action_values(q: QValues, angle: float, angular_velocity: float) -> Figure:
    """The value of each action, and right less left, over pole angle [rad] and angular velocity [rad/s], the cart at
    rest in the middle. ``q`` maps observations [n, 4] to values [n, 2]; the plane goes to minus and plus both bounds.
    """
    values, extent = _plane(q, angle, angular_velocity)
    figure = Figure(figsize=(13, 4), layout="constrained")
    panels: Any = figure.subplots(1, 3, sharey=True)
    if not np.isfinite(values).all():
        return nothing(figure, NOT_FINITE, *panels)
    low, high = float(values.min()), float(values.max())
    room = 0.0 if high > low else max(1e-3, 0.1 * abs(low))  # one value has one colour in both panels
    for a, name in enumerate(("left", "right")):
        look = {"cmap": COLOR_MAP, "vmin": low - room, "vmax": high + room}
        shown = _image(panels[a], values[..., a], extent, look, f"value of a push to the {name}")
    figure.colorbar(shown, ax=panels[:2], label="action value")
    difference = values[..., 1] - values[..., 0]
    most = float(np.abs(difference).max()) or 1.0
    look = {"cmap": "PuOr", "vmin": -most, "vmax": most}
    shown = _image(panels[2], difference, extent, look, "right less left")
    if difference.min() < 0 < difference.max():
        panels[2].contour(difference, levels=[0], extent=extent, colors="black", linewidths=0.8)
    figure.colorbar(shown, ax=panels[2], label="difference")
    panels[0].set_ylabel("angular velocity [rad/s]")
    return with_legend(figure, [], [], AT_REST)


def greedy_map(q: QValues, angle: float, angular_velocity: float) -> Figure:
    """The action of larger value over the plane of ``action_values``."""
    values, extent = _plane(q, angle, angular_velocity)
    figure = Figure(figsize=(6, 4.5), layout="constrained")
    axes: Any = figure.subplots()
    if not np.isfinite(values).all():
        return nothing(figure, NOT_FINITE, axes)
    look = {"cmap": ListedColormap([COLORS[4], COLORS[5]]), "vmin": 0, "vmax": 1}
    _image(axes, values.argmax(axis=-1), extent, look, "the greedy action")
    axes.set_ylabel("angular velocity [rad/s]")
    handles = [axes.plot([], [], "s", color=COLORS[i], markersize=10)[0] for i in (4, 5)]
    return with_legend(figure, handles, ["push left", "push right"], AT_REST)


def overestimation(predicted: np.ndarray, followed: np.ndarray) -> Figure:
    """The largest action value at states of greedy episodes beside the discounted return that followed, both [n]: what
    lies above the diagonal is promised and not kept.

    Van Hasselt, Guez and Silver, *Deep Reinforcement Learning with Double Q-learning*, 2016.
    """
    figure = Figure(figsize=(6, 5), layout="constrained")
    axes: Any = figure.subplots()
    axes.set(title="promised and kept", xlabel="discounted return that followed", ylabel="largest action value")
    axes.spines[["top", "right"]].set_visible(False)
    known = np.isfinite(predicted) & np.isfinite(followed)
    predicted, followed = predicted[known], followed[known]
    if not len(predicted):
        return nothing(figure, "no state with a finite value", axes)
    low, high = min(predicted.min(), followed.min()), max(predicted.max(), followed.max())
    room = 0.05 * (high - low) or 1.0
    ends = [low - room, high + room]
    if len(predicted) > FEW_POINTS:
        shown = axes.hexbin(
            followed, predicted, gridsize=45, bins="log", cmap=COLOR_MAP, extent=(*ends, *ends), mincnt=1
        )
        figure.colorbar(shown, ax=axes, label="states")
    else:
        size = 4 if len(predicted) > FEW else 9
        axes.plot(followed, predicted, ".", color=COLORS[0], markersize=size, alpha=0.6)
    line = axes.plot(ends, ends, color="0.3", linestyle="--", linewidth=1)
    axes.set(xlim=ends, ylim=ends)
    bias = float((predicted - followed).mean())
    kind = "too high" if bias > 0 else "too low"
    states = f"{len(predicted)} state" + "s" * (len(predicted) > 1)
    note = f"over {states} the values are {f'{abs(bias):.3g} {kind}' if bias else 'right'} on average"
    return with_legend(figure, line, ["as promised"], note)


def _plane(q: QValues, angle: float, angular_velocity: float) -> tuple[np.ndarray, tuple[float, float, float, float]]:
    """Action values over the plane, [SIDE angular velocities, SIDE angles, A], and the plane's edges."""
    theta, speed = np.linspace(-angle, angle, SIDE), np.linspace(-angular_velocity, angular_velocity, SIDE)
    points = np.zeros((SIDE, SIDE, 4), np.float32)
    points[..., 2], points[..., 3] = theta[None, :], speed[:, None]
    values = np.asarray(q(points.reshape(-1, 4)), float)
    return values.reshape(SIDE, SIDE, -1), (-angle, angle, -angular_velocity, angular_velocity)


def _image(axes: Any, values: np.ndarray, extent: Any, look: dict[str, Any], title: str) -> Any:
    axes.set(title=title, xlabel="pole angle [rad]")
    return axes.imshow(values, origin="lower", aspect="auto", extent=extent, **look)
