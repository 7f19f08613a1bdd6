"""Processes that are killed, interrupted or short of room, and the same command with --resume after them."""

import json
import os
import signal
import subprocess
import sys
import time

import faults
import numpy as np
import pytest
from faults import assert_same, contents

from jaxq import commands, machine, run_files
from jaxq.cli import main
from jaxq.runs import RunDirectory

SWEEP = "q-learning --gamma 0.9 0.99 --seeds 800 --max-episodes 50 --success-steps 30 --success-streak 2".split()
PLAN = faults.plan("q-learning", gamma=[0.9, 0.99], seeds=800, max_episodes=50, success_steps=30, success_streak=2)
COMMAND = [sys.executable, "-m", "jaxq"]
#: The same command, which writes often.
OFTEN = [
    sys.executable,
    "-c",
    "from jaxq import cpu; cpu.tune(); from jaxq import batches; batches.BATCH_LANES = 8\n"
    "from jaxq.__main__ import main; raise SystemExit(main())",
]


@pytest.fixture(scope="module")
def here(tmp_path_factory):
    """What the processes share: a directory, and a cache of compiled programs in it."""
    return tmp_path_factory.mktemp("resume")


@pytest.fixture(scope="module")
def start(here):
    """Starts a sweep in a process of its own."""

    def started(out, *words, command=COMMAND):
        return subprocess.Popen(
            [*command, "sweep", *SWEEP, "--episodes", "--out", str(out), *words],
            cwd=here,
            env={**os.environ, "JAXQ_CACHE_DIR": str(here / "cache")},
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
        )

    return started


def end(process):
    """The exit status of a process and what it said."""
    out, err = process.communicate(timeout=120)
    assert "Traceback" not in err
    return process.returncode, out, err


@pytest.fixture(scope="module")
def whole(here, start):
    """The sweep, undisturbed."""
    status, _, _ = end(start(here / "whole"))
    assert status == 0
    return here / "whole"


def rows(path):
    table = faults.rows(path)["lanes"]
    return 0 if table is None else len(table)


def finish(start, path, whole):
    status, _, _ = end(start(path, "--resume"))
    assert status == 0
    assert_same(path, whole)


def test_a_run_that_is_killed_eight_times_has_the_rows_of_an_undisturbed_one(start, whole, tmp_path):
    """At random times: some while it starts, most among its writes."""
    path, rng, counts = tmp_path / "run", np.random.default_rng(0), []
    for life in range(8):
        process = start(path, "--resume", "--quiet", command=OFTEN)
        if life % 4:
            more = len(list(path.glob("parts/*"))) + rng.integers(1, 12)
            while process.poll() is None and len(list(path.glob("parts/*"))) < more:
                time.sleep(0.001)
            time.sleep(rng.uniform(0, 0.01))
        else:
            time.sleep(rng.uniform(0, 1.5))
        process.kill()
        status, _, err = end(process)
        assert (status, err) == (-signal.SIGKILL, "")
        counts.append(rows(path))
    assert counts == sorted(counts)
    assert len(set(counts)) > 4
    assert 0 < counts[-1] < PLAN.lanes
    finish(start, path, whole)


def test_interrupted_in_every_way_and_resumed(start, whole, tmp_path):
    path, before = tmp_path / "läufe with spaces" / "run", 0
    for signals, words in [
        ([signal.SIGINT], []),
        ([signal.SIGTERM], ["--resume"]),
        ([signal.SIGINT, signal.SIGINT], ["--resume"]),
    ]:
        process = start(path, "--verbose", *words, command=OFTEN)
        while not (line := process.stderr.readline()).startswith("gamma"):  # the first lane that ended
            assert line
        for one in signals:
            process.send_signal(one)
        status, out, err = end(process)
        assert status == 130
        assert out == ""
        assert before < rows(path) < PLAN.lanes
        before = rows(path)
        if len(signals) == 1:
            said = f"interrupted: {before} of {PLAN.lanes} lanes are kept in {path}"
            assert err.splitlines()[-1].startswith(said)
            assert f"--resume and --out '{path}' finishes them" in err
    process = start(path, "--resume", "--verbose")
    status, _, err = end(process)
    assert status == 0
    assert err.count("gamma") == PLAN.lanes - before
    assert_same(path, whole)


def test_the_second_interrupt_leaves_at_once(monkeypatch, capsys):
    left = []
    monkeypatch.setattr(os, "_exit", left.append)
    before = signal.signal(signal.SIGINT, signal.default_int_handler)  # a shell's background jobs ignore it
    try:
        with commands._interrupts(quiet=False) as stop:
            assert not stop.is_set()
            signal.raise_signal(signal.SIGINT)
            assert stop.is_set()
            assert left == []
            assert "once more to stop at once" in capsys.readouterr().err
            signal.raise_signal(signal.SIGTERM)
            assert left == [130]
        with pytest.raises(KeyboardInterrupt):
            signal.raise_signal(signal.SIGINT)
    finally:
        signal.signal(signal.SIGINT, before)


def test_a_file_that_may_not_grow_is_one_line_and_what_was_committed_stays(start, whole, tmp_path):
    limited = "import resource; resource.setrlimit(resource.RLIMIT_FSIZE, ({0}, {0}))\n"
    # Bytes, and lanes of a batch: the first policies are too large, and then, after some batches, the manifest.
    for limit, lanes, words in ((20_000, 200, []), (25_000, 8, ["--resume"])):
        command = [*OFTEN[:2], limited.format(limit) + OFTEN[2].replace("= 8", f"= {lanes}")]
        process = start(tmp_path / "run", "--quiet", *words, command=command)
        status, out, err = end(process)
        assert (status, out) == (1, "")
        assert err.startswith(f"jaxq: error: {tmp_path}/run/")
        assert err.endswith(": File too large\n")
        assert len(err.splitlines()) == 1
        assert (rows(tmp_path / "run") > 0) == (lanes == 8)
    assert rows(tmp_path / "run") < PLAN.lanes
    kept = contents(tmp_path / "run" / "parts")
    finish(start, tmp_path / "run", whole)
    assert kept.items() <= contents(tmp_path / "run" / "parts").items()


def test_a_second_process_is_told_which_one_has_the_directory(start, tmp_path):
    with RunDirectory.open(tmp_path / "run", PLAN):
        before = contents(tmp_path / "run")
        for how in ("--resume", "--overwrite"):
            status, out, err = end(start(tmp_path / "run", how))
            assert (status, out) == (75, "")
            assert err == f"jaxq: error: {tmp_path}/run: process {os.getpid()} is writing to it\n"
        assert contents(tmp_path / "run") == before


def test_a_reader_that_leaves_early_disturbs_nothing(start, whole, tmp_path):
    process = start(tmp_path / "run")
    process.stdout.close()
    err = process.stderr.read()
    process.stderr.close()
    assert process.wait() == 0
    assert "Traceback" not in err
    assert_same(tmp_path / "run", whole)


@pytest.mark.parametrize("where", ["file/run", "/proc/nonexistent/run"])
def test_a_place_that_cannot_hold_a_run_is_one_line(tmp_path, capsys, where):
    (tmp_path / "file").write_text("")
    assert main(["sweep", *SWEEP, "--out", str(tmp_path / where)]) == 2
    captured = capsys.readouterr()
    assert captured.out == ""
    assert captured.err.startswith(f"jaxq: error: {tmp_path / where}: ")
    assert len(captured.err.splitlines()) == 1
    assert list(tmp_path.iterdir()) == [tmp_path / "file"]


def test_a_sweep_that_would_not_fit_into_memory_is_refused_before_it_starts(tmp_path, monkeypatch, capsys):
    large = ["sweep", "dqn", "--buffer-size", "16000000", "--hidden", "60000,60000", "--out", str(tmp_path / "run")]
    assert main(large) == 1
    err = capsys.readouterr().err
    assert err.startswith("jaxq: error: the sweep needs about ")
    assert len(err.splitlines()) == 1
    monkeypatch.setattr(machine, "available_memory", lambda: 499_000_000)
    assert main(["sweep", *SWEEP, "--out", str(tmp_path / "run")]) == 1
    assert "needs about 500 MB of memory, and 499 MB are free" in capsys.readouterr().err
    assert not list(tmp_path.iterdir())


MEASURED = """
import contextlib, io, json, re, sys
from jaxq.cli import main
told = io.StringIO()
with contextlib.redirect_stdout(told):
    main(["sweep", *sys.argv[1:], "--dry-run", "--json"])
    assert main(["sweep", *sys.argv[1:], "--quiet"]) == 0
estimate = json.loads(told.getvalue().splitlines()[0])["memory_bytes"]
peak = re.search(r"VmHWM:[^0-9]*([0-9]+)", open("/proc/self/status").read())  # getrusage has the parent's in it
print(json.dumps([estimate, int(peak[1]) * 1024]))
"""
TINY = "--hidden 8 --learning-starts 32 --batch-size 16 --max-env-steps 300 --eval-episodes 3 --workers 1"


@pytest.mark.parametrize("words", [" ".join(SWEEP), f"dqn {TINY} --seeds 4 --buffer-size 1000000"])
def test_the_memory_that_is_taken_is_about_what_was_estimated(here, tmp_path, words):
    done = subprocess.run(
        [sys.executable, "-c", MEASURED, *words.split(), "--out", str(tmp_path / "run")],
        env={**os.environ, "JAXQ_CACHE_DIR": str(here / "cache")},
        capture_output=True,
        text=True,
        check=True,
    )
    estimate, taken = json.loads(done.stdout)
    assert estimate > (1e9 if "dqn" in words else 4e8)  # the slots of the one, the process alone of the other
    assert estimate / 2 < taken < estimate * 2


def test_nothing_is_left_behind_but_what_a_run_writes(whole):
    assert run_files.foreign(whole) == set()
    assert run_files.temporaries(whole) == []
