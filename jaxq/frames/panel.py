"""A frame of a recording: the world's picture, and beside it the action values and how the episode goes."""

from __future__ import annotations

from collections.abc import Sequence
from functools import lru_cache
from typing import NamedTuple

import numpy as np
from PIL import Image, ImageDraw

from jaxq.frames.canvas import BLUE, FAINT, HOLLOW, INK, ORANGE, PAPER, SMOOTH, Color, font

#: Height of a recording, width of its panel and the most of its picture, pixels; even, as films must be.
HEIGHT, PANEL, WIDEST = 320, 260, 640
MARGIN = 14
#: More actions have bars without words.
MOST_NAMED = 12
#: Rows and columns of the bars and of the curve.
TOP, BOTTOM, CURVE_TOP, CURVE_BOTTOM = 72, 232, 258, HEIGHT - 10
#: Room for a name at most, and for a value.
NAME, VALUE = 84, 58


class Moment(NamedTuple):
    """One step of a recording, as far as the panel shows it."""

    values: np.ndarray | None  # [A]; none after a termination
    action: int
    step: int
    total: float
    note: str  # what happened at the end, or nothing
    episode: str = ""  # which of several


class Scale(NamedTuple):
    """The least and greatest action value of a whole recording, so that bars do not jump."""

    low: float
    high: float

    def part(self, value: float) -> float:
        """How far a value is from the least to the greatest; NaN for what is no finite number."""
        return (value - self.low) / ((self.high - self.low) or 1.0) if np.isfinite(value) else np.nan


class Rows(NamedTuple):
    """Where the bars of actions are: their middles, how thick they are, and from where to where they go."""

    middles: list[float]
    thick: float
    first: float
    last: float
    named: bool


def fitted(size: tuple[int, int]) -> tuple[int, int]:
    """The width and height at which a picture of this size is shown, as large as there is room."""
    factor = min(HEIGHT / size[1], WIDEST / size[0])
    return 2 * max(1, round(size[0] * factor / 2)), 2 * max(1, round(size[1] * factor / 2))


def beside(
    picture: np.ndarray | None, moment: Moment, past: Sequence[float], scale: Scale, words: Sequence[str]
) -> np.ndarray:
    """The frame: ``picture`` as large as there is room, and the panel; ``past`` are the greatest values so far.

    ``words`` are a title and the names of the actions, which may be empty. Shapes: picture [h, w, 3] or None ->
    [HEIGHT, W, 3] uint8, W even.
    """
    shown, width = None, 0
    if picture is not None:
        size = fitted((picture.shape[1], picture.shape[0]))
        width, shown = size[0], Image.fromarray(picture)
        shown = shown if shown.size == size else shown.resize(size, Image.Resampling.LANCZOS)
    frame = Image.new("RGB", (width + PANEL, HEIGHT), PAPER)
    if shown is not None:
        frame.paste(shown, (0, (HEIGHT - shown.height) // 2))
    frame.paste(_panel(moment, past, scale, tuple(words)), (width, 0))
    return np.asarray(frame)


def _panel(moment: Moment, past: Sequence[float], scale: Scale, words: tuple[str, ...]) -> Image.Image:
    image = _still(words).copy()
    draw = ImageDraw.Draw(image)
    names, rows = words[1:], _rows(words[1:])
    _text(draw, (MARGIN, 30), f"step {moment.step}", INK, 13, 100)
    _text(draw, (PANEL - MARGIN, 30), f"return {moment.total:.6g}", INK, 13, 130, right=True)
    _text(draw, (MARGIN, 48), moment.note, ORANGE, 13, 100)
    _text(draw, (PANEL - MARGIN, 48), moment.episode, INK, 13, 130, right=True)
    for i, value in enumerate([] if moment.values is None else moment.values.tolist()):
        chosen, y, half = i == moment.action, rows.middles[i], rows.thick / 2
        length = (rows.last - rows.first) * max(0.0, min(1.0, scale.part(value))) if np.isfinite(value) else None
        if length is not None:
            color = BLUE if chosen else FAINT
            _box(draw, (rows.first, y - half, rows.first + max(1.0, length), y + half), color)
        if rows.named:
            _text(draw, (PANEL - MARGIN, y - 7), f"{value:.4g}", BLUE if chosen else INK, 12, VALUE, right=True)
        if rows.named and chosen:
            _box(draw, (0, y - 7, rows.first - 4, y + 7), PAPER)
            _name(draw, names, i, rows, BLUE)
    _curve(draw, past, scale)
    return image.reduce(SMOOTH)


@lru_cache(maxsize=8)
def _still(words: tuple[str, ...]) -> Image.Image:
    """What all frames of a film have in common."""
    image = Image.new("RGB", (SMOOTH * PANEL, SMOOTH * HEIGHT), PAPER)
    draw = ImageDraw.Draw(image)
    title, *names = words
    _text(draw, (MARGIN, 10), title, INK, 13, PANEL - 2 * MARGIN)
    rows = _rows(tuple(names))
    for i, y in enumerate(rows.middles):
        _box(draw, (rows.first, y - rows.thick / 2, rows.last, y + rows.thick / 2), HOLLOW)
        if rows.named:
            _name(draw, names, i, rows, INK)
    _text(draw, (MARGIN, 240), "greatest action value", INK, 11, PANEL - 2 * MARGIN)
    _box(draw, (MARGIN, CURVE_TOP, PANEL - MARGIN, CURVE_BOTTOM), HOLLOW)
    return image


@lru_cache(maxsize=8)
def _rows(names: tuple[str, ...]) -> Rows:
    each = (BOTTOM - TOP) / len(names)
    middles = [TOP + (i + 0.5) * each for i in range(len(names))]
    if len(names) > MOST_NAMED:
        return Rows(middles, 0.8 * each, MARGIN, PANEL - MARGIN, named=False)
    widest = max(font(SMOOTH * 12).getlength(name or str(i)) / SMOOTH for i, name in enumerate(names))
    first, last = MARGIN + min(NAME, widest) + 6, PANEL - MARGIN - VALUE - 6
    return Rows(middles, min(20.0, 0.62 * each), first, last, named=True)


def _name(draw: ImageDraw.ImageDraw, names: Sequence[str], i: int, rows: Rows, color: Color) -> None:
    _text(draw, (rows.first - 6, rows.middles[i] - 7), names[i] or str(i), color, 12, NAME, right=True)


def _curve(draw: ImageDraw.ImageDraw, past: Sequence[float], scale: Scale) -> None:
    """The greatest values so far from left to right, with gaps where one is no finite number."""
    along = np.linspace(MARGIN + 2, PANEL - MARGIN - 2, max(len(past), 60))[: len(past)]
    up = [CURVE_BOTTOM - 4 - (CURVE_BOTTOM - CURVE_TOP - 8) * scale.part(value) for value in past]
    points = list[tuple[float, float]]()
    for x, y in [*zip(along.tolist(), up, strict=True), (0.0, np.nan)]:
        if np.isfinite(y):
            points.append((SMOOTH * x, SMOOTH * y))
            continue
        if len(points) > 1:
            draw.line(points, fill=BLUE, width=2 * SMOOTH, joint="curve")
        points = []


def _box(draw: ImageDraw.ImageDraw, box: tuple[float, float, float, float], color: Color) -> None:
    left, top, right, bottom = (SMOOTH * side for side in box)
    draw.rounded_rectangle((left, top, right, bottom), min(2 * SMOOTH, (bottom - top) / 2), fill=color)


def _text(
    draw: ImageDraw.ImageDraw,
    at: tuple[float, float],
    words: str,
    color: Color,
    size: int,
    room: float,
    *,
    right: bool = False,
) -> None:
    """Words from a point on, or up to it, within ``room``: smaller where need be, then with a gap in their middle."""
    if words:
        shown, height = _fitted(words, size, room)
        where = SMOOTH * at[0], SMOOTH * (at[1] + (size - height) / 2)
        draw.text(where, shown, fill=color, font=font(SMOOTH * height), anchor="ra" if right else "la")


@lru_cache(maxsize=1024)
def _fitted(words: str, size: int, room: float) -> tuple[str, int]:
    least = max(9, size - 3)
    for height in range(size, least - 1, -1):
        if font(SMOOTH * height).getlength(words) <= SMOOTH * room:
            return words, height
    for kept in range(len(words) - 1, 1, -1):
        short = f"{words[: kept // 2]}...{words[len(words) - (kept + 1) // 2 :]}"
        if font(SMOOTH * least).getlength(short) <= SMOOTH * room:
            return short, least
    return words[:1], least
