"""Pictures as matplotlib figures, drawn off screen; ``save`` writes a PNG or an SVG."""

from jaxq.pictures.axes import heat_map, sensitivity
from jaxq.pictures.curves import learning_curves
from jaxq.pictures.dress import save
from jaxq.pictures.policy import action_values, greedy_map, overestimation
from jaxq.pictures.spread import spread
from jaxq.pictures.survival import survival
from jaxq.pictures.training import episode_lengths, q_values

__all__ = [
    "action_values",
    "episode_lengths",
    "greedy_map",
    "heat_map",
    "learning_curves",
    "overestimation",
    "q_values",
    "save",
    "sensitivity",
    "spread",
    "survival",
]
