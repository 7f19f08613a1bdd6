"""``jaxq play`` shows in a terminal what ``jaxq record`` films."""

import io
import re
import time

import numpy as np
import pytest
from rich.console import Console

import jaxq
from jaxq import cli, recording
from jaxq.frames import terminal
from jaxq.frames.panel import Moment, Scale

pytestmark = pytest.mark.usefixtures("programs_are_compiled_once")

ESCAPE = re.compile(r"\x1b\[[0-9;?]*[a-zA-Z]")


def printed(renderable, columns=80):
    held = io.StringIO()
    Console(file=held, width=columns, force_terminal=True, color_system="truecolor").print(renderable, end="")
    return held.getvalue()


def pixels(text, columns):
    """The picture that half blocks show: the colours that hold when each character is written."""
    rows, colors = [], [(0, 0, 0), (0, 0, 0)]
    for line in text.splitlines():
        row = []
        for codes, word in re.findall(r"(?:\x1b\[([0-9;]*)m)?([^\x1b]*)", line):
            numbers = [int(code) for code in codes.split(";") if code]
            for kind, place in ((38, 0), (48, 1)):
                if kind in numbers:
                    at = numbers.index(kind)
                    colors[place] = tuple(numbers[at + 2 : at + 5])
            row += [tuple(colors)] * word.count(terminal.BLOCK)
        if row:
            rows += [[above for above, _ in row], [below for _, below in row]]
    return np.array(rows, np.uint8).reshape(-1, columns, 3)


def test_half_blocks_are_the_picture():
    picture = np.random.default_rng(0).integers(0, 256, (8, 5, 3)).astype(np.uint8)
    picture[2:4, 1:4] = 7  # a run of one colour
    np.testing.assert_array_equal(pixels(printed(terminal.half_blocks(picture)), 5), picture)


@pytest.mark.parametrize("size", [(80, 24), (40, 12), (30, 8), (200, 20)])
def test_a_screen_fits_the_terminal_and_keeps_the_pictures_shape(size):
    columns, lines = size
    picture = np.zeros((40, 60, 3), np.uint8)
    moment = Moment(np.array([1.0, 2.0]), 1, 3, 4.5, "")
    shown = terminal.screen(picture, moment, Scale(0.0, 2.0), ("a title", "left", "right"), size)
    told = ESCAPE.sub("", printed(shown, columns)).splitlines()
    assert len(told) <= lines
    assert max(map(len, told)) <= columns
    blocks = [line for line in told if terminal.BLOCK in line]
    width, height = len(blocks[0].rstrip()) if blocks else 0, 2 * len(blocks)
    assert width / height == pytest.approx(60 / 40, rel=0.2)
    assert told[0].startswith("a title  step 3  return 4.5"[:columns])
    left, right = (line.count(terminal.FULL) for line in told[-2:])
    assert 2 * left == pytest.approx(right, abs=1)


def test_values_that_are_no_numbers_have_no_bar():
    moment = Moment(np.array([np.nan, 1.0, np.inf]), 1, 0, 0.0, "")
    told = ESCAPE.sub("", printed(terminal.screen(None, moment, Scale(1.0, 1.0), ("", "", "", ""), (40, 10))))
    assert [line.count(terminal.FULL) > 0 for line in told.splitlines()[1:]] == [False, False, False]
    assert "nan" in told
    assert "inf" in told


def test_after_a_termination_a_screen_shows_no_values():
    told = printed(
        terminal.screen(None, Moment(None, -1, 3, 4.0, ""), Scale(0.0, 2.0), ("", "left", "right"), (40, 10))
    )
    assert terminal.FULL not in told
    assert [line.split()[0] for line in ESCAPE.sub("", told).splitlines()[1:]] == ["left", "right"]


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    path = tmp_path_factory.mktemp("run") / "lake"
    jaxq.sweep("q-learning", env="FrozenLake-v1", max_episodes=20, eval_episodes=2, seeds=1, out=path)
    return path


def test_episodes_are_shown_at_the_worlds_pace(run, capsys, monkeypatch):
    for name, value in {"FORCE_COLOR": "1", "COLORTERM": "truecolor", "TERM": "xterm", "COLUMNS": "90"}.items():
        monkeypatch.setenv(name, value)
    slept, now = [], [0.0]
    monkeypatch.setattr(time, "monotonic", lambda: now[0])
    monkeypatch.setattr(time, "sleep", lambda seconds: (slept.append(seconds), now.__setitem__(0, now[0] + seconds)))
    assert cli.main(["play", str(run), "--episodes", "2", "--max-steps", "9", "--fps", "4"]) == 0
    said = capsys.readouterr()
    (rows, others) = recording.play(jaxq.load(run), 0, 0, 2, 9)
    pause = recording.PAUSE
    assert slept == pytest.approx([0.25] * (len(rows) - 1) + [pause] + [0.25] * (len(others) - 1) + [pause])
    told = ESCAPE.sub("", said.out)
    assert all(f"FrozenLake-v1  setting 0, seed 0  step {t}  return" in told for t in range(len(rows)))
    assert re.search(r"(terminated|still going)  episode 1 of 2", told)
    assert re.search(r"(terminated|still going)  episode 2 of 2", told)
    assert said.out.count("\x1b[?1049h") == said.out.count("\x1b[?1049l") == 1  # the screen before comes back
    assert ESCAPE.sub("", said.err).splitlines()[-1].startswith("returns: ")

    def interrupted(seconds):
        raise KeyboardInterrupt

    monkeypatch.setattr(time, "sleep", interrupted)
    assert cli.main(["play", str(run), "--quiet"]) == 130
    said = capsys.readouterr()
    assert said.out.count("\x1b[?1049h") == said.out.count("\x1b[?1049l") == 1
    assert said.err == ""


@pytest.mark.parametrize(
    ("words", "told"),
    [
        ([], "jaxq play needs a terminal with colours and blocks: jaxq record writes a film"),
        (["--fps", "0"], "--fps: 0.0 is not allowed: from 0.1 to 1000"),
        (["--episodes", "101"], "--episodes: 101 is not allowed: an integer from 1 to 100"),
        (["--out", "film.gif"], "--out is unknown to jaxq play"),
    ],
)
def test_what_cannot_be_played_is_one_line(run, words, told, capsys):
    assert cli.main(["play", str(run), *words]) == 2
    said = capsys.readouterr()
    assert said.out == ""
    assert told in said.err
    assert said.err.count("\n") == 1
