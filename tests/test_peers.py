"""The peers' side of the benchmarks is well formed; Gymnasium's contender, the one that is always there, runs."""

import ast
import json
import re
import subprocess
import sys
from pathlib import Path

import pytest

PEERS = Path(__file__).parent.parent / "benchmarks" / "peers"
WORKER = Path(__file__).parent.parent / "jaxq" / "bench" / "worker.py"
CONTENDERS = sorted(set(PEERS.glob("*.py")) - {PEERS / "install.py", PEERS / "__init__.py"})


@pytest.mark.parametrize("path", CONTENDERS, ids=lambda path: path.stem)
def test_a_contender_has_what_the_worker_asks_for_and_nothing_of_ours(path):
    tree = ast.parse(path.read_text())
    assert ast.get_docstring(tree)
    functions = {node.name: node for node in tree.body if isinstance(node, ast.FunctionDef)}
    assert functions["prepare"].args.args[0].arg == "case"
    assigned = {ast.unparse(node.targets[0]): node.value for node in tree.body if isinstance(node, ast.Assign)}
    assert ast.literal_eval(assigned["PACKAGES"])
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


def test_the_settings_are_all_of_the_same_kind():
    settings = json.loads((PEERS / "dqn_settings.json").read_text())
    assert {"article", "64-64", "cleanrl"} == set(settings)
    assert len({frozenset(numbers) for numbers in settings.values()}) == 1


def test_gymnasium_runs_through_the_worker():
    requests = "".join(json.dumps({"case": case, "seconds": 0.01}) + "\n" for case in ("8", "none"))
    words = [sys.executable, str(WORKER), str(PEERS / "gymnasium_env.py"), "vector"]
    done = subprocess.run(words, input=requests, stdout=subprocess.PIPE, text=True, timeout=120, check=True)
    hello, good, bad = (json.loads(line) for line in done.stdout.splitlines())
    assert "gymnasium" in hello["versions"]
    assert good["rate"] > 0
    assert "error" in bad
