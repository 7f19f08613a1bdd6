"""The peers' side of the benchmarks is well formed; Gymnasium's contender, the one that is always there, runs."""

import ast
import json
import re
import runpy
import subprocess
import sys
from pathlib import Path

import pytest

from benchmarks import beside
from jaxq.bench import dqn, worker
from jaxq.plans import plan
from jaxq.presets import preset, settle

PEERS = Path(__file__).parent.parent / "benchmarks" / "peers"
WORKER = Path(__file__).parent.parent / "jaxq" / "bench" / "worker.py"
CONTENDERS = sorted(set(PEERS.glob("*.py")) - {PEERS / "install.py", PEERS / "__init__.py"})


@pytest.mark.parametrize("path", CONTENDERS, ids=lambda path: path.stem)
def test_a_contender_has_what_the_worker_asks_for_and_nothing_of_ours(path):
    tree = ast.parse(path.read_text())
    assert ast.get_docstring(tree)
    functions = {node.name: node for node in tree.body if isinstance(node, ast.FunctionDef)}
    # The worker asks for the one, ``solve`` for the other, and some offer both.
    first = {name: functions[name].args.args[0].arg for name in ("prepare", "solver") if name in functions}
    assert first
    assert first.items() <= {"prepare": "case", "solver": "numbers"}.items()
    assigned = {ast.unparse(node.targets[0]): node.value for node in tree.body if isinstance(node, ast.Assign)}
    assert "prepare" not in functions or ast.literal_eval(assigned["PACKAGES"])
    imported = [alias.name for node in ast.walk(tree) if isinstance(node, ast.Import) for alias in node.names]
    imported += [node.module for node in ast.walk(tree) if isinstance(node, ast.ImportFrom)]
    assert not [name for name in imported if name.split(".")[0] in ("jaxq", "benchmarks")]


def test_every_requirement_is_pinned():
    files = sorted(PEERS.glob("requirements*.txt"))
    assert files
    for file in files:
        lines = [line for line in file.read_text().splitlines() if not line.startswith("#")]
        assert lines
        for line in lines:
            assert re.fullmatch(r"[a-z0-9-]+==[0-9][0-9a-z.]*", line), f"{file.name}: {line}"


def test_peers_of_a_network_get_the_settings_that_ours_is_measured_at():
    given = {}
    for one in beside.PEERS_OF["dqn"]:
        if one.arguments[0].startswith("{"):
            name = one.name.split(", ")[-1]
            setting = {"64-64": "64-64", "120-84": "cleanrl"}.get(name, "article")
            given.setdefault(setting, []).append(json.loads(one.arguments[0]))
    assert {setting: len(all_) for setting, all_ in given.items()} == {"article": 5, "64-64": 3, "cleanrl": 3}
    for setting, all_ in given.items():
        ours = plan("article-dqn", **dqn.SETTINGS[setting]).settings[0]
        assert all(settle(preset("article-dqn"), **numbers) == ours for numbers in all_)
    arguments = worker.load(str(PEERS / "sb3_dqn.py")).as_ours(given["cleanrl"][0])
    assert arguments["target_update_interval"] == 50 * 10  # env steps, of updates
    assert arguments["policy_kwargs"] == {"net_arch": [120, 84]}


@pytest.fixture
def installer(monkeypatch, tmp_path):
    made = runpy.run_path(str(PEERS / "install.py"))
    states = []

    def fill(path, wanted):
        path.mkdir()
        (path / "new").write_text(" ".join(wanted))
        return states.pop(0)

    names = made["install"].__globals__
    monkeypatch.setitem(names, "ROOT", tmp_path)
    monkeypatch.setitem(names, "fill", fill)
    file = tmp_path / "requirements.txt"
    file.write_text("one==1\n")
    return made["install"], states, tmp_path / ".venv-peers", file


def test_an_environment_is_made_once_and_again_when_its_requirements_change(installer, capsys):
    install, states, path, file = installer
    states += [(True, True), (True, True)]
    assert install(".venv-peers", file)
    assert install(".venv-peers", file)
    assert capsys.readouterr().out == ".venv-peers: is there\n"
    file.write_text("one==2\n")
    assert install(".venv-peers", file)
    assert (path / "new").read_text() == "one==2"
    assert not states
    assert {child.name for child in path.parent.iterdir()} == {".venv-peers", "requirements.txt"}


def test_an_environment_that_works_is_kept_when_a_new_one_cannot_be_made(installer, capsys):
    install, states, path, file = installer
    states += [(True, False), (False, False), (True, True)]
    assert install(".venv-peers", file)  # a part is missing: the next run tries again
    file.write_text("one==2\n")
    assert install(".venv-peers", file)
    assert "what was there before is kept" in capsys.readouterr().out
    assert (path / "new").read_text() == "one==1"
    assert install(".venv-peers", file)
    assert (path / "new").read_text() == "one==2"
    states += [(False, False)]
    assert not install(".venv-other", file)
    before = path.with_name(".venv-peers.before")
    path.rename(before)
    path.mkdir()  # as an interrupted run leaves it
    assert install(".venv-peers", file)
    assert (path / "new").read_text() == "one==2"
    assert not before.exists()


def test_gymnasium_runs_through_the_worker():
    requests = "".join(json.dumps({"case": case, "seconds": 0.01}) + "\n" for case in ("8", "none"))
    words = [sys.executable, str(WORKER), str(PEERS / "gymnasium_env.py"), "vector"]
    done = subprocess.run(words, input=requests, stdout=subprocess.PIPE, text=True, timeout=120, check=True)
    hello, good, bad = (json.loads(line) for line in done.stdout.splitlines())
    assert "gymnasium" in hello["versions"]
    assert good["rate"] > 0
    assert "error" in bad
