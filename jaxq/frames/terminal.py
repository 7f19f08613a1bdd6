"""A frame of an episode for a terminal: the world's picture in half blocks, two pixels to a character, and text."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import groupby

import numpy as np
from PIL import Image
from rich.color import Color
from rich.console import Group, RenderableType
from rich.segment import Segment, Segments
from rich.style import Style
from rich.text import Text

from jaxq.frames.panel import Moment, Scale

#: The upper half of a character is ink, the lower one paper: its two colours are two pixels.
BLOCK = "▀"
#: Of a bar.
FULL, EMPTY = "█", "░"
#: A picture of fewer lines says nothing.
FEWEST_LINES = 4


def half_blocks(picture: np.ndarray) -> Segments:
    """A picture in characters. Shapes: picture [2 h, w, 3] uint8 -> h lines of w characters."""
    segments = []
    for upper, lower in zip(picture[::2].tolist(), picture[1::2].tolist(), strict=True):
        for (above, below), run in groupby(zip(map(tuple, upper), map(tuple, lower), strict=True)):
            style = Style(color=Color.from_rgb(*above), bgcolor=Color.from_rgb(*below))
            segments.append(Segment(BLOCK * len(list(run)), style))
        segments.append(Segment.line())
    return Segments(segments)


def screen(
    picture: np.ndarray | None, moment: Moment, scale: Scale, words: Sequence[str], size: tuple[int, int]
) -> RenderableType:
    """What a terminal of ``size`` (columns, lines) shows: a line of words, the picture as large as there is room, and a
    bar for each action. ``words`` are a title and the names of the actions. Shapes: picture [h, w, 3] or None.
    """
    title, *names = words
    columns, lines = size
    note = f"  {moment.note}" if moment.note else ""
    episode = f"  {moment.episode}" if moment.episode else ""
    shown: list[RenderableType] = [
        Text(f"{title}  step {moment.step}  return {moment.total:.6g}{note}{episode}", no_wrap=True, overflow="crop")
    ]
    room = lines - 2 - len(names)
    if picture is not None and room >= FEWEST_LINES:
        factor = min(columns / picture.shape[1], 2 * room / picture.shape[0])
        width, height = int(picture.shape[1] * factor), 2 * max(1, int(picture.shape[0] * factor / 2))
        shown.append(half_blocks(np.asarray(Image.fromarray(picture).resize((width, height), Image.Resampling.BOX))))
    widest = max(1, *(len(name) for name in names))
    length = max(1, min(40, columns - widest - 14))
    for i, name in enumerate(names):
        value = None if moment.values is None else float(moment.values[i])
        part = np.nan if value is None else scale.part(value)
        full = round(length * max(0.0, min(1.0, part))) if np.isfinite(part) else 0
        told = "" if value is None else f"{value:.4g}"
        line = f"{name or i!s:>{widest}} {FULL * full}{EMPTY * (length - full)} {told}"
        style = "bold blue" if i == moment.action else ""
        shown.append(Text(line, style, no_wrap=True, overflow="crop"))
    return Group(*shown)
