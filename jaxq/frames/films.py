"""Films on disk: shots that are drawn one at a time become a GIF or an MP4, and none is held."""

from __future__ import annotations

import contextlib
import itertools
import math
import struct
import subprocess
import tempfile
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import NamedTuple

import numpy as np
from PIL import GifImagePlugin, Image

from jaxq import run_files
from jaxq.frames import canvas
from jaxq.frames.canvas import Color

#: Where nothing has changed since the frame before, a GIF's pixel has this place of the palette.
SAME = 255
#: An MP4 has at least so many pictures in a second, so that every time is a whole number of them, nearly.
FEWEST_PER_SECOND = 10


class Shot(NamedTuple):
    """A frame [H, W, 3] uint8, and how long it stays, seconds."""

    frame: np.ndarray
    seconds: float


def palette() -> list[Color]:
    """A GIF's colours: all those that pictures are drawn in, and what lies between two of them at smooth edges."""
    found = list(canvas.COLORS)
    for part in (0.5, 0.25, 0.75):
        for one, other in itertools.combinations(canvas.COLORS, 2):
            red, green, blue = (round(part * a + (1 - part) * b) for a, b in zip(one, other, strict=True))
            # Pillow tells no colours apart that are this near: what is drawn in one of ours must stay it.
            if all(max(abs(red - r), abs(green - g), abs(blue - b)) >= 8 for r, g, b in found):
                found.append((red, green, blue))
    return found[:SAME]


def write_gif(path: Path, shots: Iterable[Shot]) -> None:
    """Writes shots as a GIF that runs for ever, whole or not at all.

    Times are whole hundredths of a second; what is rounded off goes to the next frame. Raises WriteError.
    """
    held = Image.new("P", (1, 1))
    colors = palette()
    colors += colors[:1] * (256 - len(colors))
    held.putpalette([part for color in colors for part in color])
    before, due, shown = None, 0.0, 0
    with run_files.replacing(path) as part, open(part, "wb") as file:
        for shot in shots:
            image = np.asarray(Image.fromarray(shot.frame).quantize(palette=held, dither=Image.Dither.NONE))
            due += 100 * shot.seconds
            lasts = max(2, round(due) - shown)
            shown += lasts
            if before is None:
                file.write(b"GIF89a" + struct.pack("<HHBBB", image.shape[1], image.shape[0], 0xF7, 0, 0))
                file.write(bytes(part for color in colors for part in color))
                file.write(b"!\xff\x0bNETSCAPE2.0\x03\x01\0\0\0")
            changed = np.ones(image.shape, bool) if before is None else image != before
            top, bottom, left, right = _box(changed)
            new = Image.fromarray(np.where(changed, image, SAME).astype(np.uint8)[top:bottom, left:right])
            for data in GifImagePlugin.getdata(
                new, (left, top), duration=10 * lasts, transparency=SAME, disposal=1, include_color_table=False
            ):
                file.write(data)
            before = image
        file.write(b";")


def _box(changed: np.ndarray) -> tuple[int, int, int, int]:
    """The rows and columns, each from and up to, that hold what is true; one pixel where nothing is."""
    rows, columns = (np.flatnonzero(changed.any(axis)) for axis in (1, 0))
    if not rows.size:
        return 0, 1, 0, 1
    return int(rows[0]), int(rows[-1]) + 1, int(columns[0]), int(columns[-1]) + 1


def write_mp4(path: Path, shots: Iterable[Shot], pace: float, program: str) -> None:
    """Writes shots, most of which stay ``pace`` seconds, as MP4 with ffmpeg, whole or not at all.

    Raises WriteError, also for what ffmpeg complains of.
    """
    rate = math.ceil(FEWEST_PER_SECOND * pace) / pace
    coming = iter(shots)
    first = next(coming)
    height, width = first.frame.shape[:2]
    words = [program, "-y", "-loglevel", "error", "-f", "rawvideo", "-pix_fmt", "rgb24", "-s", f"{width}x{height}"]
    words += ["-r", f"{rate:.6g}", "-i", "-", "-an", "-c:v", "libx264", "-pix_fmt", "yuv420p", "-f", "mp4"]
    with run_files.replacing(path) as part, tempfile.TemporaryFile() as said:
        with subprocess.Popen(
            [*words, str(part)], stdin=subprocess.PIPE, stdout=subprocess.DEVNULL, stderr=said
        ) as running:
            assert running.stdin is not None
            try:
                with contextlib.suppress(BrokenPipeError):  # it has ended, and says why
                    for data in _repeated(itertools.chain([first], coming), rate):
                        running.stdin.write(data)
            except BaseException:
                running.kill()
                raise
            finally:
                with contextlib.suppress(BrokenPipeError):
                    running.stdin.close()
        if running.returncode or not part.exists():
            said.seek(0)
            lines = said.read().decode(errors="replace").strip().splitlines()
            raise run_files.WriteError(f"{path}: ffmpeg: {lines[-1] if lines else f'exit {running.returncode}'}")


def _repeated(shots: Iterable[Shot], rate: float) -> Iterator[bytes]:
    """The frames' bytes, each so often as it stays at ``rate`` a second."""
    due, sent = 0.0, 0
    for shot in shots:
        due += shot.seconds * rate
        data = shot.frame.tobytes()
        for _ in range(round(due) - sent):
            yield data
        sent = round(due)
