"""Who runs beside us in each suite: the limits of the machine, and the peers that a user would pick instead."""

from __future__ import annotations

import json
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from jaxq import cpu
from jaxq.bench import dqn, solve, tabular
from jaxq.bench.contest import Contender
from jaxq.bench.suites import ENVS, GROUPS, LANES, WIDTHS, cases
from jaxq.plans import plan
from jaxq.settings import Settings

HERE = Path(__file__).parent
PEERS = HERE / "peers"

#: Ends the name of a peer that runs with XLA's settings as ours are, which are none of its own.
TUNED = ", our XLA settings"

#: What such a peer has in its environment.
OURS = {"XLA_FLAGS": " ".join(cpu.FLAGS)}
#: Lanes of a wide vmap: it is at its best with few.
FEW = cases(1, 4, 8, 16, 32, 128)

#: Contenders that need nothing beyond this package's own environment.
LIMITS: dict[str, Sequence[Contender]] = {
    "env": [
        Contender("SIMD C, all cores", "benchmarks.limits.c", ENVS, ("env",)),
        Contender("Gymnasium, vector", str(PEERS / "gymnasium_env.py"), ENVS, ("vector",)),
        Contender("Gymnasium, sync", str(PEERS / "gymnasium_env.py"), ENVS[:5], ("sync",)),
    ],
    "tabular": [Contender("scalar C, all cores", "benchmarks.limits.c", LANES, ("table",))],
    "dqn": [
        Contender("products alone", "benchmarks.limits.products", GROUPS[1:], ("article",)),
        Contender("products alone, 64-64", "benchmarks.limits.products", GROUPS[1:4], ("64-64",)),
        Contender("products alone, 120-84", "benchmarks.limits.products", GROUPS[1:4], ("cleanrl",)),
        Contender("plain JAX, one vmap", "benchmarks.plain_jax", FEW),
        Contender(f"plain JAX, one vmap{TUNED}", "benchmarks.plain_jax", FEW, environment=OURS),
        Contender("jaxq, one vmap", "benchmarks.one_vmap", cases(8, 32, 128)),
    ],
    "scaling-network": [Contender("products alone", "benchmarks.limits.products", WIDTHS, ("width",))],
}


@dataclass(frozen=True)
class Bar:
    """A ratio of two contenders' medians: in one case, or each at its best where ``case`` is None.

    ``least`` is what it should reach at least, ``goal`` what it would be good to reach.
    """

    suite: str
    ours: str
    other: str
    least: float | None = None
    goal: float | None = None
    case: str | None = None


BARS = [
    Bar("env", "jaxq", "Gymnasium, vector", least=8),
    Bar("env", "jaxq", "Gymnasium, sync"),
    Bar("env", "jaxq", "envpool"),
    Bar("env", "jaxq", "gymnax", least=10),
    Bar("env", "jaxq", f"gymnax{TUNED}"),
    Bar("env", "jaxq", "SIMD C, all cores", goal=0.25),
    Bar("tabular", "jaxq", "scalar C, all cores", least=0.5, goal=1, case="4096"),
    Bar("tabular", "jaxq", "the tutorial, NumPy", least=500),
    Bar("tabular", "jaxq", "Numba"),
    *(Bar("dqn", "jaxq", "products alone", least=0.75, case=case) for case in GROUPS[1:]),
    Bar("dqn", "jaxq, 64-64", "products alone, 64-64", case="128"),
    Bar("dqn", "jaxq, 120-84", "products alone, 120-84", case="128"),
    Bar("dqn", "jaxq", "plain JAX, one vmap", least=3, case="128"),
    Bar("dqn", "jaxq", "plain JAX, one vmap"),
    Bar("dqn", "jaxq", f"plain JAX, one vmap{TUNED}"),
    Bar("dqn", "jaxq", "jaxq, one vmap", case="128"),
    Bar("dqn", "jaxq", "the tutorial, PyTorch", least=20),
    Bar("dqn", "jaxq", "the tutorial, PyTorch, 2 threads", least=20),
    Bar("dqn", "jaxq", "stable-baselines3"),
    Bar("dqn", "jaxq", "stable-baselines3, 2 threads"),
    Bar("dqn", "jaxq", "sbx"),
    Bar("dqn", "jaxq", "rejax", least=3),
    Bar("dqn", "jaxq", f"rejax{TUNED}"),
    Bar("dqn", "jaxq, 64-64", "stable-baselines3, 64-64"),
    Bar("dqn", "jaxq, 64-64", "sbx, 64-64"),
    Bar("dqn", "jaxq, 64-64", "rejax, 64-64", least=3),
    Bar("dqn", "jaxq, 120-84", "stable-baselines3, 120-84"),
    Bar("dqn", "jaxq, 120-84", "sbx, 120-84"),
    Bar("dqn", "jaxq, 120-84", "rejax, 120-84", least=3),
    *(
        Bar("solve", ours, other, case=case)
        for case, others in (
            ("article-q", ["the tutorial, NumPy"]),
            ("article-dqn", ["the tutorial, PyTorch"]),
            (
                "dqn",
                ["stable-baselines3", "stable-baselines3, its zoo's settings", "sbx", "rejax", "rejax, seeds together"],
            ),
        )
        for other in others
        for ours in ("jaxq, seeds together", "jaxq, one at a time")
    ),
    *(Bar("scaling-network", "jaxq", "products alone", case=case) for case in WIDTHS),
]


def python_of(folder: str) -> str:
    """The Python of a virtual environment beside the Makefile; where there is none the contender's error says so."""
    return str(HERE.parent / folder / "bin" / "python") if folder else sys.executable


def _peer(name: str, file: str, which: Sequence[str], *arguments: str, folder: str = ".venv-peers") -> Contender:
    environment = OURS if name.endswith(TUNED) else {}
    return Contender(name, str(PEERS / file), which, arguments, python_of(folder), environment)


def _agent(setting: str) -> str:
    """The settings of the agent that ``jaxq.bench.dqn`` measures under that name, as JSON."""
    return _json(plan("article-dqn", **dqn.SETTINGS[setting]).settings[0])


def _json(one: Settings) -> str:
    return json.dumps(one.flat())


def _solver(name: str, agent: str, case: str, *more: str, folder: str = ".venv-peers") -> Contender:
    """A peer that trains until it is solved, beside our setting of that case."""
    numbers = _json(solve.planned(case).settings[0])
    return _peer(name, "solve.py", (case,), agent, numbers, *more, folder=folder)


#: Contenders with environments of their own: ``make peers``.
PEERS_OF: dict[str, Sequence[Contender]] = {
    "env": [
        *(_peer(f"gymnax{tuned}", "gymnax_env.py", ENVS, folder=".venv-peers-gymnax") for tuned in ("", TUNED)),
        _peer("envpool", "envpool_env.py", ENVS[:6]),
    ],
    "tabular": [
        _peer("the tutorial, NumPy", "numpy_table.py", cases(1)),
        _peer("Numba", "numba_table.py", LANES, str(tabular.UPDATES)),
    ],
    "dqn": [
        _peer("the tutorial, PyTorch", "torch_dqn.py", cases(1), "1"),
        _peer("the tutorial, PyTorch, 2 threads", "torch_dqn.py", cases(1), "2"),
        *(
            _peer(f"{name}{suffix}", file, which, _agent(setting), folder=folder)
            for name, file, which, folder in (
                ("stable-baselines3", "sb3_dqn.py", cases(1), ".venv-peers"),
                ("sbx", "sbx_dqn.py", cases(1), ".venv-peers"),
                ("rejax", "rejax_dqn.py", FEW, ".venv-peers-rejax"),
            )
            for suffix, setting in (("", "article"), (", 64-64", "64-64"), (", 120-84", "cleanrl"))
        ),
        _peer("stable-baselines3, 2 threads", "sb3_dqn.py", cases(1), _agent("article"), "2"),
        _peer(f"rejax{TUNED}", "rejax_dqn.py", FEW, _agent("article"), folder=".venv-peers-rejax"),
    ],
    "solve": [
        _solver("the tutorial, NumPy", "numpy_table", "article-q"),
        _solver("the tutorial, PyTorch", "torch_dqn", "article-dqn"),
        _solver("stable-baselines3", "sb3_dqn", "dqn"),
        _solver("stable-baselines3, its zoo's settings", "sb3_zoo_dqn", "dqn"),
        _solver("sbx", "sbx_dqn", "dqn"),
        _solver("rejax", "rejax_dqn", "dqn", folder=".venv-peers-rejax"),
        _solver("rejax, seeds together", "rejax_dqn", "dqn", "16", folder=".venv-peers-rejax"),
    ],
}
