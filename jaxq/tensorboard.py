"""A lane as TensorBoard's event files, with the tags that CleanRL made common."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np

from jaxq.settings import shown
from jaxq.tally import Result

#: Columns of a lane's curve by their tags.
TAGS = {
    "losses/td_loss": "loss",
    "losses/q_values": "max_q",
    "charts/epsilon": "epsilon",
    "eval/episodic_return": "eval_return",
}


def write(folder: Path, result: Result, settings: Any) -> None:
    """Writes one lane's episodes and curve, by its environment steps, and its hyperparameters beside its results.

    An episode's return and length stand at its last step (``charts/episodic_return``, ``charts/episodic_length``).
    """
    import tensorboardX

    with tensorboardX.SummaryWriter(str(folder), flush_secs=3600) as writer:
        for step, length, total in zip(*result.episodes[:3], strict=True):
            writer.add_scalar("charts/episodic_return", float(total), int(step))
            writer.add_scalar("charts/episodic_length", int(length), int(step))
        curve = result.curve
        for tag, name in TAGS.items():
            for step, value in zip(curve.env_steps, getattr(curve, name), strict=True):
                if math.isfinite(value):
                    writer.add_scalar(tag, float(value), int(step))
        if result.eval_returns is not None:
            writer.add_scalar("eval/episodic_return", float(np.mean(result.eval_returns)), result.env_steps)
        words = {name: shown(value) for name, value in settings.flat().items()}
        writer.add_text("hyperparameters", "\n".join(f"    {name} = {value}" for name, value in words.items()))
