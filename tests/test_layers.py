"""The house: arrows point down, nothing heavy is imported unasked, files are short."""

import ast
import json
import subprocess
import sys
from pathlib import Path

import pytest

PACKAGE = Path(__file__).parent.parent / "jaxq"

#: Each module may import from lower rows only; modules of one row do not know each other unless listed together in
#: a pair below.
LAYERS = [
    ["types", "families", "suggest", "cpu", "machine", "run_files", "streams", "exits", "bench.worker"],
    ["bench.contest", "bench.report", "bench.memory", "bench.affinity", "bench", "sources"],
    ["settings", "axes", "table_parts"],
    ["worlds.world"],
    ["worlds.classic", "worlds.toy_text", "worlds.own"],
    ["worlds", "requests"],
    [
        "prng",
        "elementary",
        "rules.indexing",
        "rules.shapes",
        "rules.weighting",
        "policies",
        "presets",
        "envs.moments",
        "envs.precision",
    ],
    ["rules.values", "rules.tables", "rules.target_networks", "rules.categorical", "rules.quantile", "schedules"],
    ["rules.returns", "rules.one_step"],
    ["rules.rescaling"],
    ["rules.multi_step"],
    ["rules"],
    [
        "envs.acrobot",
        "envs.auto_reset",
        "envs.cartpole",
        "envs.mdp",
        "envs.mountain_car",
        "envs.one_hot",
        "envs.pendulum",
        "envs.probes",
        "networks",
        "optimisers",
        "replay",
        "success",
        "plans",
    ],
    ["envs.solutions", "envs.outcomes", "envs.two_states", "evaluation"],
    [
        "envs.discretise",
        "envs.frame_history",
        "envs.normalise",
        "envs.scale_reward",
        "envs.sticky_actions",
        "envs.time_limit",
    ],
    ["envs.toy_text"],
    ["envs", "agents", "stats", "manifest", "sweep_files"],
    ["agents.backups", "agents.model"],
    ["agents.tabular", "agents.dqn"],
    ["rounds"],
    ["experiment"],
    ["programs", "compile_cache"],
    ["executables", "tally", "functions", "saved_policy"],
    ["slots", "shared", "checkpoints", "halving", "tables", "summaries"],
    ["workers", "store"],
    ["lanes", "parts"],
    ["memory_run", "batches", "repair", "estimate", "tensorboard"],
    ["runs", "pictures.columns", "pictures.dress", "pictures.scales", "report", "progress", "flags", "bench.solved"],
    ["pictures.training", "pictures.curves", "pictures.axes", "pictures.survival", "pictures.spread"],
    ["pictures.policy"],
    ["pictures"],
    ["replayed", "interop", "interop.dtypes", "interop.gymnasium.compiled", "interop.gymnasium.spaces"],
    ["frames.canvas", "interop.brax", "interop.gymnax.spaces", "interop.gymnax.theirs"],
    ["interop.gymnax.style"],
    ["interop.gymnax"],
    ["frames.classic", "frames.grids", "frames.panel", "frames.films"],
    ["frames", "frames.terminal"],
    ["interop.gymnasium.env", "interop.gymnasium.reference", "interop.gymnasium.foreign", "interop.gymnasium.trained"],
    ["interop.gymnasium.vector", "interop.gymnasium.transitions"],
    ["interop.gymnasium.learner"],
    ["interop.gymnasium.host"],
    ["interop.gymnasium"],
    ["drawing", "recording"],
    ["outcome"],
    ["page", "stages"],
    ["sweeps", "bench.equal_lanes"],
    ["bench.env", "bench.tabular", "bench.dqn", "bench.sweep", "bench.solve", "bench.scaling", "bench.full_replay"],
    ["bench.suites"],
    ["bench.command"],
    ["verify.checks", "verify.numpy_rules", "verify.stepped"],
    ["verify.states"],
    ["verify.numpy_rules_distributions", "verify.numpy_rules_multi"],
    ["verify.rule_cases", "verify.steps", "verify.episodes", "verify.outcomes", "verify.resets"],
    ["verify.environments", "verify.rules", "verify.keys", "verify.lanes", "verify.compiles"],
    ["verify"],
    ["commands"],
    ["command_report", "command_evaluate", "command_train", "command_verify"],
    ["command_record"],
    ["command_play"],
    ["cli"],
    ["__main__"],
]
RANK = {name: row for row, names in enumerate(LAYERS) for name in names}


def module_of(path):
    parts = path.relative_to(PACKAGE).with_suffix("").parts
    return ".".join(parts[:-1] if parts[-1] == "__init__" and len(parts) > 1 else parts)


def jaxq_imports(path):
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.ImportFrom) and node.module and node.module.split(".")[0] == "jaxq":
            base = node.module.removeprefix("jaxq").lstrip(".")
            for alias in node.names:
                nested = f"{base}.{alias.name}".lstrip(".")
                if nested in RANK:
                    yield nested
                elif base:
                    yield base
        elif isinstance(node, ast.Import):
            for alias in node.names:
                if alias.name.startswith("jaxq."):
                    yield alias.name.removeprefix("jaxq.")


SOURCES = sorted(PACKAGE.rglob("*.py"))


def test_every_module_has_its_layer():
    assert {module_of(path) for path in SOURCES} - {"__init__"} == set(RANK)


@pytest.mark.parametrize("path", SOURCES, ids=module_of)
def test_imports_point_down(path):
    name = module_of(path)
    if name == "__init__":
        return
    wrong = {other for other in jaxq_imports(path) if RANK[other] >= RANK[name]}
    assert not wrong, f"{name} imports {sorted(wrong)}, which are not below it"


@pytest.mark.parametrize("path", SOURCES, ids=module_of)
def test_files_are_short(path):
    assert len(path.read_text().splitlines()) <= 300


def loaded_by(code):
    script = f"{code}\nimport json, sys\nprint(json.dumps(sorted(sys.modules)))"
    out = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=True).stdout
    return set(json.loads(out.splitlines()[-1]))


def test_import_jaxq_imports_nothing_heavy():
    loaded = loaded_by("import jaxq")
    assert not loaded & {"jax", "brax", "matplotlib", "gymnasium", "flax", "scipy", "pyarrow"}


def test_help_imports_no_jax():
    code = "import jaxq.cli\ntry:\n    jaxq.cli.main(['sweep', 'article-dqn', '--help'])\nexcept SystemExit: pass"
    assert not loaded_by(code) & {"jax", "brax", "matplotlib", "gymnasium", "scipy", "pyarrow", "rich"}


def test_the_whole_library_without_its_edges_imports_neither_brax_nor_matplotlib_nor_gymnasium():
    loaded = loaded_by("import jaxq\n[getattr(jaxq, name) for name in jaxq.__all__ if name != 'pictures']")
    assert not loaded & {"brax", "matplotlib", "gymnasium"}


def test_the_summary_of_one_seed_needs_no_scipy_stats():
    code = """
import jaxq
from jaxq import stages, sweeps
sweeps.sweep("q-learning", max_episodes=3).summary()
"""
    assert "scipy.stats" not in loaded_by(code)
