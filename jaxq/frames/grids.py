"""Pictures of finite worlds: cells, and who is where."""

from __future__ import annotations

from typing import Any

import numpy as np

from jaxq.frames.canvas import (
    BLUE,
    FAINT,
    GREEN,
    INK,
    ORANGE,
    PAPER,
    PINK,
    SKY,
    WATER,
    YELLOW,
    Canvas,
    Color,
)
from jaxq.worlds import CliffWalking, FrozenLake, FrozenLake8x8, Taxi

Size = tuple[int, int]

#: Where Taxi's passengers wait and want to go, row and column, with the colour of each.
PLACES: tuple[tuple[int, int, Color], ...] = ((0, 0, ORANGE), (0, 4, GREEN), (4, 0, YELLOW), (4, 3, BLUE))
IN_TAXI = len(PLACES)


def frozen_lake(world: FrozenLake, state: Any, size: Size) -> np.ndarray:
    """The ice with its holes, the goal's flag, and the walker."""
    from gymnasium.envs.toy_text.frozen_lake import MAPS

    rows = MAPS["8x8" if isinstance(world, FrozenLake8x8) else "4x4"]
    canvas = _cells(len(rows), len(rows[0]), size)
    for i, row in enumerate(rows):
        for j, letter in enumerate(row):
            _cell(canvas, len(rows), i, j, SKY)
            if letter == "H":
                canvas.disc((j + 0.5, len(rows) - i - 0.5), 0.36, WATER)
            elif letter == "G":
                _flag(canvas, (j + 0.5, len(rows) - i - 0.5))
            elif letter == "S":
                canvas.arc((j + 0.5, len(rows) - i - 0.5), 0.38, 0, 360, BLUE, 0.04)
    _walker(canvas, len(rows), *divmod(int(state.s), len(rows[0])))
    return canvas.pixels()


def cliff_walking(world: CliffWalking, state: Any, size: Size) -> np.ndarray:
    """The land above the cliff, the goal's flag, and the walker."""
    del world
    canvas = _cells(4, 12, size)
    for i in range(4):
        for j in range(12):
            _cell(canvas, 4, i, j, WATER if i == 3 and 0 < j < 11 else FAINT)
    canvas.arc((0.5, 0.5), 0.38, 0, 360, BLUE, 0.04)
    _flag(canvas, (11.5, 0.5))
    _walker(canvas, 4, *divmod(int(state.s), 12))
    return canvas.pixels()


def taxi(world: Taxi, state: Any, size: Size) -> np.ndarray:
    """The town with its walls and four places, the taxi, the passenger and where they want to go (ringed)."""
    from gymnasium.envs.toy_text.taxi import MAP

    del world
    rest, destination = divmod(int(state.s), len(PLACES))
    rest, passenger = divmod(rest, IN_TAXI + 1)
    row, column = divmod(rest, 5)
    canvas = _cells(5, 5, size)
    for i in range(5):
        for j in range(5):
            _cell(canvas, 5, i, j, FAINT)
    for k, (i, j, color) in enumerate(PLACES):
        canvas.box((j + 0.06, 5 - i - 0.94), (j + 0.94, 5 - i - 0.06), color, rounded=0.08)
        canvas.text((j + 0.5, 5 - i - 0.5), "RGYB"[k], PAPER, 0.45)
        if k == destination:
            canvas.arc((j + 0.5, 5 - i - 0.5), 0.46, 0, 360, INK, 0.07)
    for i, line in enumerate(MAP[1:-1]):  # a wall is | between two cells
        for j in range(4):
            if line[2 * j + 2] == "|":
                canvas.line([(j + 1, 5 - i), (j + 1, 4 - i)], INK, 0.08, round_ends=False)
    canvas.box((column + 0.14, 5 - row - 0.72), (column + 0.86, 5 - row - 0.36), INK, rounded=0.1)
    canvas.box((column + 0.28, 5 - row - 0.5), (column + 0.72, 5 - row - 0.18), INK, rounded=0.08)
    for wheel in (0.3, 0.7):
        canvas.disc((column + wheel, 5 - row - 0.74), 0.09, PAPER)
    if passenger == IN_TAXI:
        canvas.disc((column + 0.5, 5 - row - 0.34), 0.1, PINK)
    else:
        i, j, _ = PLACES[passenger]
        canvas.disc((j + 0.78, 5 - i - 0.24), 0.14, PINK)
    return canvas.pixels()


def _cells(rows: int, columns: int, size: Size) -> Canvas:
    return Canvas(size, (-0.1, -0.1), (columns + 0.1, rows + 0.1))


def _cell(canvas: Canvas, rows: int, row: int, column: int, color: Color) -> None:
    low = column + 0.03, rows - row - 1 + 0.03
    canvas.box(low, (low[0] + 0.94, low[1] + 0.94), color, rounded=0.08)


def _flag(canvas: Canvas, at: tuple[float, float]) -> None:
    x, y = at
    canvas.line([(x - 0.15, y - 0.3), (x - 0.15, y + 0.32)], INK, 0.05)
    canvas.polygon([(x - 0.13, y + 0.34), (x + 0.28, y + 0.18), (x - 0.13, y + 0.02)], GREEN)


def _walker(canvas: Canvas, rows: int, row: int, column: int) -> None:
    x, y = column + 0.5, rows - row - 0.5
    canvas.polygon([(x - 0.2, y - 0.3), (x + 0.2, y - 0.3), (x + 0.1, y + 0.1), (x - 0.1, y + 0.1)], ORANGE)
    canvas.disc((x, y + 0.18), 0.13, ORANGE)
