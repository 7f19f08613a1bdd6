"""A canvas in units of the world, smooth at its edges: drawn larger and then reduced."""

from __future__ import annotations

from collections.abc import Sequence
from functools import cache
from typing import Any

import numpy as np
from PIL import Image, ImageDraw, ImageFont

Point = tuple[float, float]
Color = tuple[int, int, int]

#: How much larger a picture is drawn than it is.
SMOOTH = 2

PAPER: Color = (250, 250, 247)
INK: Color = (45, 48, 56)
FAINT: Color = (206, 208, 206)
BLUE: Color = (0, 114, 178)
ORANGE: Color = (213, 94, 0)
GREEN: Color = (0, 158, 115)
YELLOW: Color = (240, 200, 60)
PINK: Color = (204, 121, 167)
SKY: Color = (190, 222, 240)
WATER: Color = (58, 92, 132)
HOLLOW: Color = (232, 232, 226)
#: All of them.
COLORS = (PAPER, INK, FAINT, BLUE, ORANGE, GREEN, YELLOW, PINK, SKY, WATER, HOLLOW)


@cache
def font(size: float) -> Any:
    """The font of all words, so high."""
    return ImageFont.load_default(size)


class Canvas:
    """A picture of ``size`` (width, height) pixels that shows the box ``low`` .. ``high`` of the world, y upwards."""

    def __init__(self, size: tuple[int, int], low: Point, high: Point) -> None:
        self.size = size
        self._low, self._high = low, high
        self._scale = SMOOTH * min(size[0] / (high[0] - low[0]), size[1] / (high[1] - low[1]))
        self._image = Image.new("RGB", (SMOOTH * size[0], SMOOTH * size[1]), PAPER)
        self._draw = ImageDraw.Draw(self._image)

    def pixel(self, point: Point) -> Point:
        """Where a point of the world is on the large picture; the box stands in its middle."""
        middle = (self._low[0] + self._high[0]) / 2, (self._low[1] + self._high[1]) / 2
        width, height = self._image.size
        return width / 2 + (point[0] - middle[0]) * self._scale, height / 2 - (point[1] - middle[1]) * self._scale

    def line(self, points: Sequence[Point], color: Color, width: float, *, round_ends: bool = True) -> None:
        """A line through points, its width in units of the world."""
        pixels = [self.pixel(point) for point in points]
        thick = max(1, round(width * self._scale))
        self._draw.line(pixels, fill=color, width=thick, joint="curve")
        if round_ends:
            for point in (points[0], points[-1]):
                self.disc(point, width / 2, color)

    def disc(self, centre: Point, radius: float, color: Color) -> None:
        """A filled circle."""
        x, y = self.pixel(centre)
        r = max(1.0, radius * self._scale)
        self._draw.ellipse((x - r, y - r, x + r, y + r), fill=color)

    def polygon(self, points: Sequence[Point], color: Color) -> None:
        """A filled polygon."""
        self._draw.polygon([self.pixel(point) for point in points], fill=color)

    def box(self, low: Point, high: Point, color: Color, *, rounded: float = 0.0) -> None:
        """A filled rectangle, its corners rounded by so much."""
        (x0, y1), (x1, y0) = self.pixel(low), self.pixel(high)
        self._draw.rounded_rectangle((x0, y0, x1, y1), max(0.0, rounded * self._scale), fill=color)

    def arc(self, centre: Point, radius: float, start: float, end: float, color: Color, width: float) -> None:
        """Part of a circle, angles in degrees clockwise from the right."""
        x, y = self.pixel(centre)
        r = radius * self._scale
        self._draw.arc((x - r, y - r, x + r, y + r), start, end, fill=color, width=max(1, round(width * self._scale)))

    def text(self, at: Point, words: str, color: Color, height: float) -> None:
        """Words around a point, so high."""
        letters = font(max(8.0, height * self._scale))
        self._draw.text(self.pixel(at), words, fill=color, font=letters, anchor="mm")

    def pixels(self) -> np.ndarray:
        """The picture, [height, width, 3] uint8."""
        return np.asarray(self._image.reduce(SMOOTH))
