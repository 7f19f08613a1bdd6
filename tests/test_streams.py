"""Streams that are closed, full, or short of characters: talk never stops a run, lost data is said."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

pytestmark = pytest.mark.usefixtures("programs_are_compiled_once")

WORDS = f"{sys.executable} -m jaxq train q-learning --max-episodes 30 --verbose --out run"


@pytest.fixture(autouse=True)
def somewhere_else(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)


def shell(line, **env):
    return subprocess.run(["bash", "-c", line], capture_output=True, text=True, env={**os.environ, **env})


def kept():
    return {file.name for file in Path("run").rglob("*.p*") if file.is_file()}


WHOLE = {"episodes.png", "q_values.png", *(f"00000-{kind}.parquet" for kind in ("curves", "episodes", "lanes"))}


@pytest.mark.parametrize("gone", ["2>&-", "2>/dev/full", "2> >(head -1 >/dev/null)"])
def test_a_stderr_that_is_gone_changes_nothing(gone):
    done = shell(f"{WORDS} {gone}")
    assert done.returncode == 0
    assert done.stdout.startswith("final Q-table")
    assert kept() == WHOLE


def test_an_error_is_not_said_on_stdout_where_stderr_is_closed():
    done = shell(f"{WORDS} --gamma 2 2>&-")
    assert (done.returncode, done.stdout) == (2, "")


def test_a_closed_stdout_is_somewhere_else():
    assert shell(f"{WORDS} >&-").returncode == 0
    assert kept() == WHOLE


@pytest.mark.parametrize("words", [WORDS, f"{WORDS} --json", f"{sys.executable} -m jaxq list"])
def test_a_full_stdout_is_one_line_and_exit_1(words):
    done = shell(f"{words.replace('--verbose', '--quiet')} >/dev/full")
    assert done.returncode == 1
    assert done.stderr == "jaxq: error: stdout: No space left on device\n"


def test_a_reader_that_leaves_is_no_error():
    done = shell(f"{sys.executable} -m jaxq list | head -1; exit ${{PIPESTATUS[0]}}")
    assert (done.returncode, done.stdout, done.stderr) == (0, "presets\n", "")


@pytest.mark.parametrize("encoding", ["ascii", "latin-1"])
def test_a_table_needs_no_other_characters(encoding):
    done = shell(WORDS, PYTHONIOENCODING=encoding)
    assert done.returncode == 0
    assert "solved" in done.stdout
    assert "?" not in done.stdout
    assert "Traceback" not in done.stderr


def test_a_dumb_terminal_has_the_same_table():
    first, second = shell(WORDS, TERM="dumb"), shell(f"{WORDS} --overwrite", TERM="xterm")
    assert first.stdout == second.stdout
    assert not any(line != line.rstrip() for line in first.stdout.splitlines())


def test_a_picture_that_cannot_be_written_takes_nothing_with_it():
    """A directory stands where the picture belongs."""
    Path("run/episodes.png").mkdir(parents=True)
    done = shell(WORDS)
    assert done.returncode == 1
    assert done.stdout.startswith("final Q-table")
    assert "picture" in done.stderr
    assert "Traceback" not in done.stderr
