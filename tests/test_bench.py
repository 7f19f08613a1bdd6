"""The contest, our contenders in it, and ``jaxq bench``."""

import json
import subprocess
import sys

import gymnasium
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxq import lanes, machine, prng, programs
from jaxq.bench import command, contest, dqn, env, report, suites, sweep, tabular
from jaxq.bench.contest import Contender
from jaxq.cli import main
from jaxq.envs import make
from jaxq.envs.auto_reset import auto_reset
from jaxq.plans import plan

CONTENDER = """
import time
PACKAGES = ("numpy", "no-such-package")

def prepare(case, units="1"):
    print("talk on stdout is no answer")
    if case == "bad":
        raise ValueError("first line\\n  second line")
    if case == "dies":
        import os
        os._exit(3)
    prepared.append(case)
    made = float(units) * len(prepared)
    told[case] = {"units": made}
    def bout():
        time.sleep(0.002)
        return made
    return bout

def notes(case):
    return told[case]

prepared, told = [], {}
"""


@pytest.fixture
def module(tmp_path):
    path = tmp_path / "contender.py"
    path.write_text(CONTENDER)
    return str(path)


def rows_of(result):
    return {(row["contender"], row["case"]): row for row in result["rows"]}


def test_an_accelerator_is_told(tmp_path):
    """A contender whose JAX says that it runs on one; the others, and those without JAX, run on the processor."""
    plain = tmp_path / "plain.py"
    plain.write_text("def prepare(case):\n    return lambda: 1.0\n")
    for name, kind in (("gpu", "NVIDIA H200"), ("cpu", "cpu")):
        fake = f"""
import sys, types
jax = sys.modules["jax"] = types.ModuleType("jax")
jax.devices = lambda: [types.SimpleNamespace(platform={name!r}, device_kind={kind!r})]
"""
        (tmp_path / f"{name}.py").write_text(fake + plain.read_text())
    contenders = [Contender(name, str(tmp_path / f"{name}.py"), ("1",)) for name in ("plain", "cpu", "gpu")]
    result = contest.contest(contenders, repeats=1, seconds=0)
    assert {name: row["device"] for (name, _), row in rows_of(result).items()} == {
        "plain": None,
        "cpu": None,
        "gpu": "NVIDIA H200",
    }
    assert report.machine(result).endswith("; gpu on NVIDIA H200")
    (tmp_path / "asks.py").write_text(plain.read_text() + "def device():\n    return 'NVIDIA H200'\n")
    asks = contest.contest([Contender("asks", str(tmp_path / "asks.py"), ("1",))], repeats=1, seconds=0)
    assert report.machine(asks).endswith("; asks on NVIDIA H200")
    assert report.machine(contest.contest(contenders[:2], repeats=1, seconds=0)).endswith(result["machine"]["system"])


def test_an_accelerator_gets_groups_of_its_own_width(monkeypatch):
    settings = [plan(name).settings[0] for name in ("article-q", "article-dqn")]
    on_cpu = [programs.program(one, "pcg4d").width for one in settings]
    assert lanes.default_workers() == machine.cores()
    monkeypatch.setattr(jax, "default_backend", lambda: "gpu")
    assert [programs.program(one, "pcg4d").width > 16 * width for one, width in zip(settings, on_cpu, strict=True)] == [
        True,
        True,
    ]
    assert lanes.default_workers() == 1


def test_contenders_take_turns_and_cases_are_prepared_once(module):
    turns = []
    contenders = [Contender("one", module, ("a", "b")), Contender("ten", module, ("b",), ("10",))]
    result = contest.contest(contenders, repeats=3, seconds=0.01, on_turn=lambda *turn: turns.append(turn))
    assert [what for _, _, what, _ in turns] == ["one, a", "one, b", "ten, b"] * 3
    assert [done for done, *_ in turns] == list(range(9))
    assert {total for _, total, *_ in turns} == {9}
    rows = rows_of(result)
    for row in rows.values():
        assert len(row["rates"]) == 3
        assert row["median"] == sorted(row["rates"])[1]
        assert row["spread"] == (max(row["rates"]) - min(row["rates"])) / row["median"]
    # A bout makes as many units as cases were prepared, so a second preparation would be seen.
    assert [row["notes"] for row in rows.values()] == [{"units": 1.0}, {"units": 2.0}, {"units": 10.0}]
    assert result["versions"]["one"].keys() == {"python", "numpy"}
    json.dumps(result, allow_nan=False)


def test_a_contender_that_fails_is_told_and_stops_nobody(module):
    contenders = [
        Contender("sound", module, ("a",)),
        Contender("bad", module, ("bad", "a")),
        Contender("dies", module, ("dies", "a")),
        Contender("no module", "no_such_module", ("a",)),
        Contender("no python", module, ("a",), python="/no/such/python"),
    ]
    result = contest.contest(contenders, repeats=2, seconds=0)
    rows = rows_of(result)
    assert len(rows["sound", "a"]["rates"]) == 2
    assert len(rows["bad", "a"]["rates"]) == 2
    assert rows["bad", "bad"]["error"] == "ValueError: first line second line"
    assert rows["bad", "bad"]["median"] is None
    assert "ended with status 3" in rows["dies", "dies"]["error"]
    assert rows["dies", "a"]["error"]
    assert "no_such_module" in rows["no module", "a"]["error"]
    assert "does not run" in rows["no python", "a"]["error"]
    lines = report.errors(result)
    assert any(line.startswith("no python: /no/such/python does not run") for line in lines)
    table = report.text(report.grid(result, "lanes"))
    assert "error" in table
    assert table.splitlines()[0].split()[0] == "lanes"


@pytest.mark.parametrize(("field", "value"), [("repeats", 0), ("seconds", -1.0), ("seconds", float("nan"))])
def test_a_contest_refuses_what_makes_no_sense(module, field, value):
    with pytest.raises(ValueError, match=f"^{field}: {value} "):
        contest.contest([Contender("one", module, ("a",))], **{"repeats": 1, "seconds": 0.0, field: value})


@pytest.mark.parametrize("family", ["pcg4d", "threefry"])
def test_the_env_contender_plays_what_gymnasium_plays(family, monkeypatch):
    monkeypatch.setattr(env, "STEPS", 32 * 40)
    chunks, width = 3, 32
    root = jax.random.key_data(prng.key(0, family))
    world = auto_reset(make("CartPole-v1"))
    keys = jax.random.split(prng.wrap(root, family), (chunks, width))
    states = jax.vmap(jax.vmap(world.reset))(keys)
    run = jax.jit(lambda states, first: env.roll(world, family, root, states, first))
    rolled = run(states, jnp.uint32(0))
    again = run(rolled.states, jnp.uint32(env.STEPS))
    ours = 2 * env.STEPS * chunks * width / float((rolled.episodes + again.episodes).sum())

    theirs, rng = gymnasium.make("CartPole-v1"), np.random.default_rng(0)
    lengths = []
    for seed in range(600):
        theirs.reset(seed=seed)
        steps, over = 0, False
        while not over:
            _, _, terminated, truncated, _ = theirs.step(int(rng.integers(2)))
            steps, over = steps + 1, terminated or truncated
        lengths.append(steps)
    error = np.std(lengths) / np.sqrt(len(lengths))
    assert abs(ours - np.mean(lengths)) < 5 * error
    assert len(np.unique(np.asarray(rolled.states.x))) == chunks * width  # no two environments share their keys
    assert not np.array_equal(rolled.episodes, again.episodes)  # nor two stretches of time


def test_the_env_contender_counts_its_steps(monkeypatch):
    monkeypatch.setattr(env, "STEPS", 64)
    monkeypatch.setattr(env, "BOUT", 2**10)
    assert env.prepare("1")() == 2**10
    assert env.prepare("130")() == 3 * 64 * 64  # whole chunks


def test_the_tabular_contender_makes_every_update_it_counts(monkeypatch):
    monkeypatch.setattr(tabular, "UPDATES", 4000)
    assert tabular.prepare("1")() == 4000
    assert tabular.prepare("20")() == 20 * 4000


@pytest.mark.parametrize(("setting", "each"), [("64-64", 512), ("cleanrl", 512)])
def test_the_dqn_contender_makes_every_update_it_counts(monkeypatch, setting, each):
    monkeypatch.setattr(dqn, "MOST", each)
    monkeypatch.setattr(dqn, "BOUT", 2**10)
    assert dqn.prepare("2", setting)() == 2 * each


def test_a_module_may_do_its_own_warm_up_and_tell_more(tmp_path):
    path = tmp_path / "contender.py"
    path.write_text(
        "WARM_UP = False\nruns = []\ndef prepare(case):\n    def bout():\n        runs.append(case)\n"
        "        return 1.0\n    return bout\ndef notes(case):\n    return {'runs': len(runs)}\n"
    )
    result = contest.contest([Contender("one", str(path), ("a",))], repeats=2, seconds=0)
    assert rows_of(result)["one", "a"]["notes"] == {"runs": 2}
    assert report.notes(result) == [["notes", "runs"], ["a, one", "2"]]
    assert report.notes({"rows": []}) == []


def test_a_contender_may_have_a_time_of_its_own(tmp_path):
    path = tmp_path / "contender.py"
    path.write_text(
        "import time\nWARM_UP = False\nbouts = []\ntime.perf_counter = lambda: 0.04 * len(bouts)\ndef prepare(case):\n"
        "    def bout():\n        bouts.append(case)\n        return 1.0\n    return bout\ndef notes(case):\n"
        "    return {'bouts': len(bouts)}\n"
    )
    turns = []
    contenders = [Contender("fixed", str(path), ("a",), seconds=0), Contender("timed", str(path), ("a",))]
    result = contest.contest(contenders, repeats=1, seconds=0.1, on_turn=lambda *turn: turns.append(turn))
    assert rows_of(result)["fixed", "a"]["notes"] == {"bouts": 1}
    assert rows_of(result)["timed", "a"]["notes"] == {"bouts": 3}
    assert [least for *_, least in turns] == [0, 0.1]


def test_the_bar_shows_how_long_a_turn_takes(monkeypatch):
    monkeypatch.setattr(command.time, "monotonic", lambda: 100.0)
    bar = command._Bar("solve", quiet=True)
    column = command._Turn()
    assert column.render(bar.bar.tasks[0]).plain == ""
    bar.turn(0, 2, "a peer, dqn", 600.0)
    assert column.render(bar.bar.tasks[0]).plain == "0 of at least 600 s"
    bar.turn(1, 2, "ours, dqn", 0)
    assert column.render(bar.bar.tasks[0]).plain == "0 s"


def test_a_contender_that_nobody_waits_for_any_more_ends_in_silence(module):
    with subprocess.Popen(
        [sys.executable, str(contest.WORKER), module],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    ) as process:
        assert "versions" in json.loads(process.stdout.readline())
        process.stdout.close()
        process.stdin.write(json.dumps({"case": "1", "seconds": 0}) + "\n")
        process.stdin.close()
        assert process.wait() == 0
        assert process.stderr.read() == "talk on stdout is no answer\n"


def test_whole_runs_are_shown_in_seconds():
    row = {"contender": "one", "case": "a", "median": 0.25, "spread": 0.1, "error": None}
    assert report.grid({"rows": [row], "whole": True}, "command")[1] == ["a", "4.00 s (±5 %)"]


def test_the_sweep_contender_runs_the_command_cold_and_warm(monkeypatch):
    monkeypatch.setitem(sweep.COMMANDS, "small", ["q-learning", "--max-episodes", "20", "--seeds", "3"])
    for cache, cached in (("cold", 0), ("warm", 1)):
        assert sweep.prepare("small", cache)() == 1.0
        assert sweep.notes("small")["cached"] == cached
        assert sweep.device() == (None if jax.default_backend() == "cpu" else jax.devices()[0].device_kind)
    monkeypatch.setitem(sweep.COMMANDS, "wrong", ["q-learning", "--gamma", "2"])
    with pytest.raises(RuntimeError, match="gamma"):
        sweep.prepare("wrong", "cold")()


def test_the_commands_have_the_seeds_that_they_are_named_for():
    for name, words in sweep.COMMANDS.items():
        assert words[words.index("--seeds") + 1] == name.split(" seed")[0].split()[-1]
    assert sweep.one_seed(["dqn", "--seeds", "16", "--gamma", "0.9"]) == ["dqn", "--seeds", "1", "--gamma", "0.9"]


def test_every_contender_of_ours_has_its_module_and_cases():
    for suite in suites.SUITES.values():
        for contender in suite.contenders:
            assert contender.cases
            assert contender.module.startswith("jaxq.bench.")
            assert contender.python == sys.executable


def test_rates_read_well():
    assert report.rate(123_456_789, "updates") == "123 M updates/s"
    assert report.rate(1_234.5) == "1.23 k"
    assert report.rate(99.96) == "100"
    assert report.rate(0.5, "runs") == "0.50 runs/s"
    assert report.rate(None) == "-"


def test_what_a_contender_tells_beside_numbers(tmp_path):
    path = tmp_path / "contender.py"
    path.write_text(
        "def tools():\n    return {'compiler': 'cc 1'}\ndef prepare(case):\n    return lambda: 1.0\n"
        "def notes(case):\n    return {'differs': 'half the work', 'runs': 1234}\n"
    )
    result = contest.contest([Contender(name, str(path), ("a", "b")) for name in ("x", "y")], repeats=1, seconds=0)
    assert result["versions"]["x"]["compiler"] == "cc 1"
    assert report.notes(result)[:2] == [["notes", "runs"], ["a, x", "1,234"]]
    assert report.remarks(result) == ["x; y: half the work."]


def test_a_contender_that_is_left_cleans_up(tmp_path):
    """As after Ctrl-C: its files are gone, whether it waits for a request or is at work."""
    path, made = tmp_path / "contender.py", tmp_path / "made"
    path.write_text(
        f"import atexit, pathlib, time\nmade = pathlib.Path({str(made)!r})\n"
        "def prepare(case):\n    made.touch()\n    atexit.register(made.unlink)\n    return lambda: 1.0\n"
    )

    def stop(done, *_):
        if done:
            assert made.exists()
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        contest.contest([Contender("x", str(path), ("a", "b"))], repeats=1, seconds=0, on_turn=stop)
    assert not made.exists()


def test_bench_prints_a_table_and_json(capsys, monkeypatch, module):
    small = suites.Suite("env", "a test", "steps", "environments", [Contender("one", module, ("1", "2"))], 1, 0.0)
    monkeypatch.setitem(suites.SUITES, "env", small)
    assert main(["bench", "env", "--cases", "2"]) == 0
    out = capsys.readouterr().out.splitlines()
    assert out[0] == "env: a test"
    assert out[2].split() == ["environments", "one"]
    assert out[3].split()[0] == "2"
    assert main(["bench", "env", "--json", "--repeats", "2"]) == 0
    result = json.loads(capsys.readouterr().out)["env"]
    assert [row["case"] for row in result["rows"]] == ["1", "2"]
    assert result["repeats"] == 2
    assert result["machine"]["cores"] >= 1


def test_bench_fails_when_one_of_ours_does(capsys, monkeypatch, module):
    small = suites.Suite("env", "a test", "steps", "environments", [Contender("one", module, ("1", "bad"))], 1, 0.0)
    monkeypatch.setitem(suites.SUITES, "env", small)
    assert main(["bench", "env"]) == 1
    told = capsys.readouterr()
    assert told.err == "not run: one: ValueError: first line second line\n"
    assert main(["bench", "env", "--cases", "1"]) == 0


def test_suites_that_ended_before_ctrl_c_are_printed(capsys, monkeypatch, module):
    for name in ("env", "dqn"):
        small = suites.Suite(name, "a test", "steps", "lanes", [Contender("one", module, ("1",))], 1, 0.0)
        monkeypatch.setitem(suites.SUITES, name, small)
    began = []

    def contest_or_ctrl_c(contenders, **options):
        began.append(contenders)
        if len(began) == 2:
            raise KeyboardInterrupt
        return contest.contest(contenders, **options)

    monkeypatch.setattr(command, "contest", contest_or_ctrl_c)
    with pytest.raises(KeyboardInterrupt):
        main(["bench", "env", "dqn", "--json", "--quiet"])
    assert json.loads(capsys.readouterr().out).keys() == {"env"}


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["evn"], "suite 'evn' is unknown; did you mean 'env'?"),
        (["env", "--repeats", "0"], "0 is not allowed: a whole number from 1 to 1000"),
        (["env", "--seconds", "nan"], "nan is not allowed: a number from 0 to 3600"),
        (["env", "--cases", "3"], "cases: env has no 3; known: 1, "),
        (["env", "dqn", "--cases", "1", "16"], "cases: dqn has no 16; known: 1, 8"),
        (["env", "--sceonds", "1"], "--sceonds"),
    ],
)
def test_a_mistake_is_one_line(capsys, words, message):
    assert main(["bench", *words]) == 2
    captured = capsys.readouterr()
    assert captured.out == ""
    assert len(captured.err.splitlines()) == 1
    assert message in captured.err


def test_nothing_asked_shows_its_flags(capsys):
    with pytest.raises(SystemExit) as left:
        main(["bench", "--help"])
    assert left.value.code == 0
    assert "--repeats" in capsys.readouterr().out
