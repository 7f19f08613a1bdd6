"""An environment of one's own on the command line: a function is named, imported, and tried before a run begins."""

import json
import sys
from pathlib import Path

import pytest

import jaxq
from jaxq import __main__, envs, exits, sources
from jaxq.cli import main
from jaxq.plans import plan

MODULE = """
from jaxq import envs

def hill(force=0.001, steps=30):
    return envs.time_limit(envs.make("MountainCar-v0", force=force), steps)

def broken(x=1):
    raise RuntimeError("not\\ntoday")

def needs(x):
    return hill()

class inside:
    walk = hill

number = 3

def frames(count=4):
    return envs.frame_history(hill(), count)

def branches(force=0.001):
    return hill() if force > 0 else hill(steps=3)

def resets(force=0.001):
    return envs.auto_reset(hill(force))

def domain(x=-1.0):
    import math
    return hill(math.log(x))

def leaves(x=1):
    raise SystemExit(0)

def stepless(force=0.001):
    import dataclasses
    return dataclasses.replace(hill(), step=lambda key, state, action: (state, None))

def tables(words={}):
    return hill()

def listed(words=[1, 2]):
    return hill()

def endless(limit=float("inf")):
    return hill()

def talks(force=0.001):
    print("made")
    return hill(force)

def shaped(sizes=(1, 2), name="none"):
    return hill()
"""
NUMBERS = {"max_env_steps": 400, "learning_starts": 128, "hidden": (8,), "eval_episodes": 10, "seeds": 2}
SMALL = "--max-env-steps 400 --learning-starts 128 --hidden 8 --eval-episodes 10 --seeds 2 --quiet".split()


@pytest.fixture(autouse=True)
def somewhere(tmp_path, monkeypatch, programs_are_compiled_once):
    monkeypatch.chdir(tmp_path)
    Path("hills.py").write_text(MODULE)
    Path("torn.py").write_text("1 +")
    Path("quits.py").write_text("import sys; sys.exit(5)")
    Path("noisy.py").write_text("print('hello')\nfrom hills import talks")
    yield
    sys.path[:] = [path for path in sys.path if path != str(Path.cwd())]
    for name in ("hills", "torn", "quits", "noisy"):
        sys.modules.pop(name, None)


def test_a_named_function_is_swept_resumed_played_and_filmed(capsys):
    words = ["sweep", "dqn", "--env", "hills:hill", "--env.force", "0.001", "0.002", *SMALL, "--out", "run"]
    assert main([*words, "--json"]) == 0
    lanes = json.loads(capsys.readouterr().out)["lanes"]
    assert [row["env.force"] for row in lanes] == [0.001, 0.001, 0.002, 0.002]
    assert [row["final_return"] for row in lanes] == [-30] * 4
    hill = sources.imported("hills:hill")
    same = jaxq.sweep("dqn", env=hill, **NUMBERS, **{"env.force": [0.001, 0.002]})
    assert same.lanes["eval_return"].to_pylist() == [row["eval_return"] for row in lanes]
    assert main([*words, "--resume"]) == 0
    assert main(["evaluate", "run", "--env", "hills:hill", "--episodes", "2", "--json"]) == 0
    assert json.loads(capsys.readouterr().out.splitlines()[-1])[0]["pure"] == -30
    assert main(["record", "run", "--env", "hills:hill", "--max-steps", "5", "--quiet"]) == 0
    assert Path("run/record.gif").read_bytes().startswith(b"GIF89a")
    for command, short in (("evaluate", ["--episodes", "2"]), ("record", ["--max-steps", "5", "--quiet"])):
        assert main([command, "run"]) == 2
        assert "give it, as --env MODULE:FUNCTION" in capsys.readouterr().err
        assert main([command, "run", "--env", "hills:inside.walk", *short]) == 0


def test_a_sweep_file_names_a_function_too(capsys):
    Path("sweep.toml").write_text('preset = "q-learning"\nenv = "jaxq.envs:two_states"\nseeds = 3\n')
    assert main(["sweep", "sweep.toml", "--dry-run"]) == 0
    assert "1 setting x 3 seeds = 3 lanes" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("name", "said"),
    [
        ("hills:hll", "env: 'hll' is unknown in hills; did you mean 'hill'?"),
        ("hils:hill", "env: hils cannot be imported: ModuleNotFoundError: No module named 'hils'"),
        ("torn:hill", "env: torn cannot be imported: SyntaxError: invalid syntax (torn.py, line 1)"),
        ("hills:", "env: 'hills:' is not allowed: MODULE:FUNCTION"),
        ("./hills.py:hill", "env: './hills.py:hill' is not allowed: MODULE:FUNCTION"),
        ("hills:number", "env: hills:number is not allowed: a function that makes a jaxq.types.Env"),
        ("hills:needs", "env: every parameter of needs must have a name and a default, not 'x'"),
        ("hills:broken", "env: hills:broken raised RuntimeError: not (hills.py, line 8)"),
        ("hills:frames", "env: hills:frames does not take traced numbers: ValueError: count: "),
        ("hills:branches", "env: hills:branches does not take traced numbers: TracerBoolConversionError: "),
        ("hills:resets", "env: hills:resets resets by itself, which a sweep does: leave auto_reset out"),
        ("hills:domain", "env: hills:domain raised ValueError: math domain error (hills.py, line 29)"),
        ("hills:leaves", "env: hills:leaves raised SystemExit: 0 (hills.py, line 32)"),
        (
            "hills:stepless",
            "env: hills:stepless does not take traced numbers: TypeError: step gave NoneType",
        ),
        ("hills:tables", "env: words={} is not allowed as a default: a number, a word, a switch, or numbers (,)"),
        ("hills:listed", "env: words=[1, 2] is not allowed as a default: a number, a word, a switch, or numbers (,)"),
        ("hills:endless", "env: limit: inf is not allowed"),
        ("builtins:dict", "env: dict is not allowed: no signature found"),
        ("quits:hill", "env: quits cannot be imported: SystemExit: 5"),
        ("hills:inside", "env: hills:inside made inside, which is no jaxq.types.Env"),
    ],
)
def test_what_is_no_environment_is_one_line_and_leaves_nothing(name, said, capsys):
    before = sorted(Path().iterdir())
    assert main(["sweep", "dqn", "--env", name, *SMALL]) == 2
    out, err = capsys.readouterr()
    assert out == ""
    assert err.startswith(f"jaxq: error: {said}")
    assert err.count("\n") == 1
    assert [path for path in sorted(Path().iterdir()) if path.name != "__pycache__"] == before


def test_what_a_module_and_a_function_print_is_talk(capsys):
    assert main(["sweep", "dqn", "--env", "noisy:talks", "--dry-run", "--json"]) == 0
    out, err = capsys.readouterr()
    assert json.loads(out)["lanes"] == 10
    assert {"hello", "made"} <= set(err.splitlines())


def test_tuples_and_words_are_structures(capsys):
    words = ["sweep", "dqn", "--env", "hills:shaped", "--env.sizes", "3,4", "5", "--dry-run", "--json"]
    assert main(words) == 0
    assert json.loads(capsys.readouterr().out)["programs"] == 2


def test_a_table_needs_bounds_of_what_it_divides(capsys):
    assert main(["sweep", "q-learning", "--env", "hills:hill", "--dry-run"]) == 2
    assert "env: hills:hill has observations of shape (2,), which a table divides" in capsys.readouterr().err


def test_a_lane_is_trained_again_from_its_directory(capsys):
    words = ["sweep", "dqn", "--env", "hills:hill", *SMALL, "--out", "run"]
    assert main(words) == 0
    again = ["train", "--from", "run", "--config", "0", "--seed", "1", "--out", "one"]
    assert main(again) == 2
    assert main([*again, "--env", "hills:hill"]) == 0
    assert "bit for bit the lane that run holds" in capsys.readouterr().err


def test_ctrl_c_in_an_import_is_the_status_of_an_interruption(monkeypatch):
    def interrupted(name):
        raise KeyboardInterrupt

    monkeypatch.setattr(sources.importlib, "import_module", interrupted)
    monkeypatch.setattr(sys, "argv", ["jaxq", "sweep", "dqn", "--env", "hills:hill"])
    assert __main__.main() == exits.INTERRUPTED


def test_what_a_function_refuses_is_known_before_a_run_begins(capsys):
    """Where a number is traced nobody can look at it: then the function is asked before."""
    words = ["sweep", "dqn", "--env", "hills:hill", *SMALL, "--out", "run"]
    assert main([*words, "--env.steps", "30", "0"]) == 2
    assert (
        capsys.readouterr().err
        == "jaxq: error: max_episode_steps: 0 is not allowed: a whole number from 1 to 2147483647\n"
    )
    assert not Path("run").exists()
    calls = []

    def counted(force=0.001):
        calls.append(force)
        return envs.make("MountainCar-v0", force=force)

    plan("dqn", env=counted, gamma=[0.9, 0.99], **{"env.force": [0.001, 0.002]})
    assert calls[0] == 0.001
    assert calls[2:] == [0.002]  # the one between was traced
