"""Whole commands as a user runs them: start, compile or fetch from the cache, run, write, draw, end."""

from __future__ import annotations

import atexit
import json
import os
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

from jaxq import run_files

PACKAGES = ("jaxq", "jax", "jaxlib")
#: A command is its own warm-up, or is meant to run cold.
WARM_UP = False

RATES = "5e-5 1e-4 2e-4 4e-4 8e-4 1.6e-3 3.2e-3 6.4e-3".split()
COMMANDS = {
    "article-q, 1 seed": ["article-q", "--seeds", "1"],
    "article-q, 1024 seeds": ["article-q", "--seeds", "1024"],
    # 64 settings; a lane makes 2,000 updates, one per 4 steps once 1,000 transitions are stored.
    "dqn, 64 settings, 16 seeds": [
        *("dqn", "--seeds", "16", "--learning-rate", *RATES, "--gamma", "0.9", "0.95", "0.99", "0.995"),
        *("--target-period", "50", "200", "--max-env-steps", "9000", "--tau", "1", "--epsilon-decay", "50000"),
        *("--learning-rate-end", "5e-5", "--buffer-size", "10000", "--eval-episodes", "10", "--stop", "none"),
    ],
}

_last: dict[str, dict[str, Any]] = {}
_devices: list[str] = []


def prepare(case: str, cache: str = "warm") -> Callable[[], float]:
    """The command of that name with an empty compile cache ("cold") or a full one ("warm"). Units: runs."""
    folder = Path(tempfile.mkdtemp(prefix="jaxq-bench-"))
    atexit.register(shutil.rmtree, folder, ignore_errors=True)
    kept, out = folder / "cache", folder / "run"

    def run(words: list[str]) -> dict[str, Any]:
        environment = {**os.environ, "JAXQ_CACHE_DIR": str(kept)}
        environment.pop("XLA_FLAGS", None)  # the command line sets its own
        environment.pop("JAX_COMPILATION_CACHE_DIR", None)  # JAX's own cache may hold what ours does not
        line = [sys.executable, "-m", "jaxq", "sweep", *words, "--json", "--quiet", "--overwrite", "--out", str(out)]
        done = subprocess.run(line, capture_output=True, text=True, env=environment)
        if done.returncode:
            raise RuntimeError(done.stderr.strip() or f"exit {done.returncode}")
        _devices.append(json.loads((out / run_files.MANIFEST).read_text())["device"])
        return json.loads(done.stdout)["timing"]

    if cache == "warm":  # one seed compiles what all of them run
        run(one_seed(COMMANDS[case]))

    def bout() -> float:
        if cache == "cold":
            shutil.rmtree(kept, ignore_errors=True)
        _last[case] = run(COMMANDS[case])
        return 1.0

    return bout


def one_seed(words: Sequence[str]) -> list[str]:
    """The same command with one seed."""
    where = words.index("--seeds") + 1
    return [*words[:where], "1", *words[where + 1 :]]


def notes(case: str) -> dict[str, Any]:
    """What the last run of that command said of its time."""
    return _last.get(case, {})


def device() -> str | None:
    """The accelerator that the last command ran on."""
    return None if _devices[-1] == "cpu" else _devices[-1]
