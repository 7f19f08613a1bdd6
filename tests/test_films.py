"""Recordings hold what the policy did, whole or not at all."""

import argparse
import errno
import itertools
import os
import stat
import weakref

import jax
import numpy as np
import pytest
from PIL import Image

import jaxq
from jaxq import cli, command_evaluate, envs, frames, parts, recording, run_files
from jaxq.envs import CartPoleState
from jaxq.frames import canvas, films
from jaxq.frames.panel import Moment, beside, fitted
from jaxq.worlds import WORLDS, CartPole, world

pytestmark = pytest.mark.usefixtures("programs_are_compiled_once")


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    path = tmp_path_factory.mktemp("run") / "q"
    jaxq.sweep("q-learning", max_episodes=5, eval_episodes=3, seeds=3, keep=1, out=path)
    return path


def test_a_lane_whose_policy_was_not_kept_is_neither_chosen_nor_played(run, capsys, monkeypatch):
    outcome = jaxq.load(run)
    kept = outcome.store.policies()
    assert kept == {(0, 0), (0, 2)}  # each was the best when it ended
    for seed in range(3):
        if (0, seed) in kept:
            outcome.policy(0, seed)
        else:
            with pytest.raises(ValueError, match=f"setting 0, seed {seed}: no policy is saved"):
                outcome.policy(0, seed)
            assert cli.main(["record", str(run), "--seed", str(seed)]) == 2
            assert f"--seed: {seed} has no lane with a policy" in capsys.readouterr().err
    for one in kept:  # whichever lane is the best, the one that was kept is chosen
        monkeypatch.setattr(parts, "kept_policies", lambda path, one=one: {one})
        options = argparse.Namespace(directory=run, config=None, seed=None, all=False)
        assert [row["seed"] for row in command_evaluate.chosen(outcome, options)] == [one[1]]


def test_a_recording_is_what_the_greedy_policy_does(run):
    outcome = jaxq.load(run)
    (rows,) = recording.play(outcome, 0, 2, 1, 1000)
    policy = outcome.policy(0, 2)
    step, t = jax.jit(envs.make("CartPole-v1").step), 0
    for before, after in itertools.pairwise(rows):
        obs = np.array(before.state[:4], np.float32)
        np.testing.assert_allclose(before.values, policy.q_values(obs[None])[0], rtol=1e-6)
        assert before.action == policy.act(obs[None])[0]
        expected, happened = step(jax.random.key(0), CartPoleState(*before.state), before.action)
        np.testing.assert_allclose(np.array(expected[:4]), np.array(after.state[:4]), rtol=1e-5, atol=1e-6)
        assert (before.terminated, before.truncated) == (bool(happened.terminated), bool(happened.truncated))
        t += 1
    assert rows[-1].action == recording.NO_ACTION
    assert rows[-2].terminated or rows[-2].truncated
    assert sum(row.reward for row in rows) == t


def decoded(path):
    """The frames of a GIF and how long each stays, milliseconds."""
    with Image.open(path) as film:
        found, lasts = [], []
        for k in range(film.n_frames):
            film.seek(k)
            found.append(np.asarray(film.convert("RGB")))
            lasts.append(film.info["duration"])
    return found, lasts


def where(picture, color):
    rows, columns = np.nonzero(np.all(picture == np.array(color), -1))
    return columns.mean(), rows.mean()


@pytest.mark.parametrize("seed", [0, 2])
def test_a_film_shows_each_state_with_its_values_in_order(run, tmp_path, seed, capsys):
    path = tmp_path / "film.gif"
    words = ["--seed", str(seed), "--episodes", "2", "--max-steps", "7", "--fps", "5", "--out", str(path)]
    assert cli.main(["record", str(run), *words]) == 0
    played = recording.play(jaxq.load(run), 0, seed, 2, 7)
    values = np.concatenate([taken.values for rows in played for taken in rows if taken.values is not None])
    scale, expected = recording.Scale(values.min(), values.max()), []
    for k, rows in enumerate(played):
        for t, taken in enumerate(rows):
            ended = "terminated" if rows[-2].terminated else "still going"
            moment = Moment(
                taken.values, taken.action, t, t, ended if t == len(rows) - 1 else "", f"episode {k + 1} of 2"
            )
            past = [max(one.values) for one in rows[: t + 1] if one.values is not None]
            picture = frames.draw(CartPole(), taken.state, size=(480, 320))
            title = f"CartPole-v1  setting 0, seed {seed}"
            expected.append(beside(picture, moment, past, scale, (title, "left", "right")))
    found, lasts = decoded(path)
    assert len(found) == len(expected)
    for shown, wanted in zip(found, expected, strict=True):
        assert np.abs(shown.astype(int) - wanted).mean() < 0.5
        assert np.abs(shown.astype(int) - wanted).max() < 80  # at smooth edges
        for color in (canvas.INK, canvas.BLUE, canvas.YELLOW):
            assert where(shown[:, :480], color) == pytest.approx(where(wanted[:, :480], color), abs=1)
    assert lasts == [time for rows in played for time in [200] * (len(rows) - 1) + [1000]]
    sums = ", ".join(f"{len(rows) - 1}" for rows in played)
    assert capsys.readouterr().err == f"returns: {sums}\n"


def test_the_setting_and_the_seed_that_are_asked_for_are_played(run, monkeypatch):
    asked = []
    monkeypatch.setattr(recording, "play", lambda outcome, *words: asked.append(words[:4]) or 1 / 0)
    rows = [{"config": c, "seed": s, "eval_return": float(c - s), "status": "done"} for c in (0, 1) for s in (0, 1)]
    monkeypatch.setattr(parts, "kept_policies", lambda path: {(row["config"], row["seed"]) for row in rows})
    monkeypatch.setattr(jaxq.outcome.Outcome, "lanes", jaxq.outcome.pa.Table.from_pylist(rows))
    for words in ([], ["--config", "0"], ["--seed", "1"], ["--config", "0", "--seed", "1", "--episodes", "3"]):
        with pytest.raises(ZeroDivisionError):
            cli.main(["record", str(run), *words, "--max-steps", "9"])
    assert asked == [(1, 0, 1, 9), (0, 0, 1, 9), (1, 1, 1, 9), (0, 1, 3, 9)]


def test_a_film_runs_at_the_worlds_pace(run, capsys):
    assert cli.main(["record", str(run), "--seed", "0", "--episodes", "2", "--max-steps", "30"]) == 0
    said = capsys.readouterr()
    assert said.out.splitlines()[0] == str(run / "record.gif")
    returns = [float(x) for x in said.err.removeprefix("returns: ").split(", ")]
    found, lasts = decoded(run / "record.gif")
    assert found[0].shape[0] % 2 == found[0].shape[1] % 2 == 0
    # 50 steps a second are shown as every second one for 40 ms, and the last stays a second.
    expected = []
    for steps in returns:
        expected += [40] * len([t for t in range(int(steps)) if t % 2 == 0]) + [1000]
    assert lasts == expected


@pytest.mark.parametrize("name", WORLDS)
def test_the_colours_of_pictures_are_those_of_films(name, tmp_path):
    one, blank = world(name), np.full((64, 64, 3), canvas.PAPER, np.uint8)
    state = envs.make(name).reset(jax.random.key(0))
    picture = frames.draw(one, state, size=fitted(frames.size_of(one)))
    films.write_gif(tmp_path / "film.gif", iter([films.Shot(picture, 1.0)]))
    (shown,), _ = decoded(tmp_path / "film.gif")
    assert np.abs(shown.astype(int) - picture).mean() < 1
    for color in canvas.COLORS:
        count = [int(np.all(one == color, -1).sum()) for one in (shown, picture)]
        assert count[0] >= count[1]
        films.write_gif(tmp_path / "plain.gif", [films.Shot(blank, 0.1), films.Shot(blank * 0 + np.uint8(color), 0.1)])
        assert np.all(decoded(tmp_path / "plain.gif")[0][1] == color)


@pytest.mark.parametrize("fps", [0.3, 7, 15, 23.976])
def test_what_is_rounded_off_a_time_is_not_lost(fps, tmp_path):
    rng = np.random.default_rng(0)
    pictures = [rng.integers(0, 255, (16, 16, 3)).astype(np.uint8) for _ in range(50)]
    pictures[30] = pictures[29]  # nothing changes
    films.write_gif(tmp_path / "film.gif", (films.Shot(one, 1 / fps) for one in pictures))
    found, lasts = decoded(tmp_path / "film.gif")
    assert len(found) >= 49  # Pillow may join what is the same
    assert sum(lasts) == pytest.approx(50_000 / fps, abs=10)
    assert max(lasts) - min(lasts) <= 10 or len(found) == 49


def test_frames_are_drawn_when_they_are_written_and_none_is_held(run, tmp_path, monkeypatch):
    played, alive, most, told = recording.play(jaxq.load(run), 0, 2, 2, 20), [], [], []

    def kept(*words):
        frame = beside(*words)
        alive[:] = [one for one in alive if one() is not None] + [weakref.ref(frame)]
        most.append(sum(one() is not None for one in alive))
        return frame

    monkeypatch.setattr(recording, "beside", kept)
    shots = recording.shots(CartPole(), played, "t", 5, lambda done, of: told.append((done, of)))
    assert most == []
    films.write_gif(tmp_path / "film.gif", shots)
    count = sum(map(len, played))
    assert len(most) == count
    assert max(most) <= 3
    assert told == [(k + 1, count) for k in range(count)]


def test_playing_says_how_far_it_is(run):
    told = []
    played = recording.play(jaxq.load(run), 0, 2, 2, 8, lambda done, of: told.append((done, of)))
    assert told == sorted(told)
    assert told[0] == (1 / 8, 2)
    assert told[-1] == (2, 2)
    assert len(told) == sum(map(len, played))


def test_no_values_are_shown_or_counted_after_a_termination(run):
    (rows,) = recording.play(jaxq.load(run), 0, 2, 1, 1000)
    assert rows[-1].terminated
    assert rows[-1].values is None
    assert len(list(recording.scenes(CartPole(), [rows], 5))[-1].past) == len(rows) - 1
    (cut,) = recording.play(jaxq.load(run), 0, 2, 1, 3)
    assert cut[-1].values is not None


@pytest.mark.parametrize("ends", [KeyboardInterrupt, OSError(errno.ENOSPC, "No space left on device")], ids=str)
@pytest.mark.parametrize("kind", ["gif", "mp4"])
def test_what_does_not_end_leaves_what_was_there(run, ends, kind, tmp_path, monkeypatch, capsys):
    fake(tmp_path, monkeypatch, 'cat > "$last"')
    path = tmp_path / f"film.{kind}"
    path.write_bytes(b"before")
    drawn = itertools.count()

    def draw(*words, **options):
        if next(drawn) == 3:
            raise ends
        return np.zeros((320, 480, 3), np.uint8)

    monkeypatch.setattr(frames, "draw", draw)
    status = cli.main(["record", str(run), "--fps", "5", "--out", str(path)])
    assert status == (130 if ends is KeyboardInterrupt else 1)
    said = capsys.readouterr()
    assert said.out == ""
    assert ("No space left" in said.err) == (status == 1)
    assert path.read_bytes() == b"before"
    assert not list(tmp_path.glob(".*tmp*"))


def fake(folder, monkeypatch, does):
    """Puts a program of this name on the path; ``$last`` is the file that it is asked for."""
    program = folder / "ffmpeg"
    program.write_text(f"#!/bin/sh\nfor last; do :; done\n{does}\n")
    program.chmod(program.stat().st_mode | stat.S_IEXEC)
    monkeypatch.setenv("PATH", f"{folder}{os.pathsep}{os.environ['PATH']}")


@pytest.mark.parametrize("fps", [0.25, 4, 25, 50])
def test_mp4_is_as_long_as_its_shots(fps, run, tmp_path, monkeypatch):
    fake(tmp_path, monkeypatch, 'cat > "$last"; echo "$@" > "$last.words"')
    path = tmp_path / "film.MP4"
    assert cli.main(["record", str(run), "--seed", "0", "--max-steps", "6", "--fps", str(fps), "--out", str(path)]) == 0
    (asked,) = [file.read_text() for file in tmp_path.glob("*.words")] or [
        file.read_text() for file in tmp_path.glob(".*.words")
    ]
    width, height = (int(x) for x in asked.split(" -s ")[1].split()[0].split("x"))
    rate = float(asked.split(" -r ")[1].split()[0])
    sent = np.frombuffer(path.read_bytes(), np.uint8).reshape(-1, height, width, 3)
    steps = 6 if fps <= 25 else 3 * 2
    assert len(sent) / rate == pytest.approx(steps / fps + recording.PAUSE, abs=0.6 / rate)
    assert rate >= 10
    (rows,) = recording.play(jaxq.load(run), 0, 0, 1, 6)
    wanted = list(recording.shots(CartPole(), [rows], "CartPole-v1  setting 0, seed 0", fps))
    np.testing.assert_array_equal(sent[0], wanted[0].frame)
    np.testing.assert_array_equal(sent[-1], wanted[-1].frame)


def test_what_ffmpeg_complains_of_is_said(run, tmp_path, monkeypatch, capsys):
    words = ["record", str(run), "--seed", "0", "--max-steps", "6", "--quiet"]
    fake(tmp_path, monkeypatch, 'cat > "$last"')
    assert cli.main(words) == 0
    assert capsys.readouterr().out.split() == [str(run / "record.gif"), str(run / "record.mp4")]
    before = (run / "record.mp4").read_bytes()
    for reads in ("cat > /dev/null", ":"):  # also where it ends before it has read all
        fake(tmp_path, monkeypatch, f"{reads}\necho no codec >&2\nexit 3")
        assert cli.main(words) == 1
        assert "record.mp4: ffmpeg: no codec" in capsys.readouterr().err
        assert (run / "record.mp4").read_bytes() == before
        assert not list(run.glob(".*tmp*"))


def test_recordings_are_the_runs_own(run):
    for name in run_files.RECORDINGS:
        (run / name).write_bytes(b"")
        assert run / name in run_files.own_files(run)
        assert run_files.temporary(run / name) not in run_files.foreign(run)


def test_an_outcome_records_itself_also_in_an_environment_of_ones_own(run, tmp_path):
    path = tmp_path / "film.gif"
    assert jaxq.load(run).record(path, 0, 2, episodes=2, max_steps=5, fps=5) == [5, 5]
    assert decoded(path)[0][0].shape == (320, 740, 3)
    own = jaxq.sweep("q-learning", env=_own, max_episodes=1, eval_episodes=1)
    assert own.store.policies() == {(0, 0)}
    assert own.record(str(path), max_steps=5) == [5]
    assert decoded(path)[0][0].shape == (320, 260, 3)  # its action values alone
    for wrong, said in (
        ({"path": "film.avi"}, "path: film.avi is not allowed: a name that ends in .gif or .mp4"),
        ({"episodes": 0}, "episodes: 0 is not allowed"),
        ({"fps": 0.0}, "fps: 0.0 is not allowed: from 0.1 to 1000"),
        ({"seed": 1}, "setting 0, seed 1: no policy is saved"),
    ):
        with pytest.raises(ValueError, match=said):
            jaxq.load(run).record(**{"path": path, **wrong})


def _own():
    return envs.make("CartPole-v1")


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["--episodes", "0"], "--episodes: 0 is not allowed: an integer from 1 to 100"),
        (["--fps", "nan"], "--fps: nan is not allowed"),
        (["--max-steps", "0"], "--max-steps: 0 is not allowed"),
        (["--out", "film.avi"], "--out: film.avi is not allowed: a name that ends in .gif or .mp4"),
        (["--out", "/no/such/folder/film.gif"], "--out: /no/such/folder is not a directory"),
        (["--out", "."], "--out: . is not allowed: a name that ends in"),
        (["--config", "0", "--seed", "9"], "--config: 0, --seed: 9 has no lane with a policy"),
        (["--config", "7"], "--config: 7 has no lane with a policy"),
        (["--fast"], "--fast is unknown to jaxq record"),
    ],
)
def test_what_cannot_be_recorded_is_one_line_and_changes_nothing(run, words, said, capsys, monkeypatch):
    monkeypatch.setenv("PATH", "")
    before = {path: path.stat().st_mtime_ns for path in run.rglob("*")}
    assert cli.main(["record", str(run), *words]) == 2
    captured = capsys.readouterr()
    assert captured.out == ""
    assert said in captured.err
    assert captured.err.count("\n") == 1
    assert {path: path.stat().st_mtime_ns for path in run.rglob("*")} == before


def test_mp4_without_ffmpeg_and_a_directory_that_is_none(run, tmp_path, monkeypatch, capsys):
    monkeypatch.setenv("PATH", "")
    assert cli.main(["record", str(run), "--out", str(tmp_path / "film.mp4")]) == 2
    assert "needs ffmpeg, which is not on the path" in capsys.readouterr().err
    (tmp_path / "film.gif").mkdir()
    monkeypatch.setattr(recording, "play", lambda *words: pytest.fail("played before it was known where to write"))
    assert cli.main(["record", str(run), "--out", str(tmp_path / "film.gif")]) == 2
    assert "film.gif is a directory" in capsys.readouterr().err
    monkeypatch.setattr(os, "access", lambda path, how: path != tmp_path)
    assert cli.main(["record", str(run), "--out", str(tmp_path / "other.gif")]) == 2
    assert "takes no files" in capsys.readouterr().err
    assert cli.main(["record", str(tmp_path / "none")]) == 2
    assert capsys.readouterr().err.count("\n") == 1
