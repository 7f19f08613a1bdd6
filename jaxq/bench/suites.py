"""What ``jaxq bench`` measures: each suite's contenders, all of them ours."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from jaxq import machine
from jaxq.bench import solve
from jaxq.bench.contest import Contender
from jaxq.bench.scaling import NETWORK_LANES


@dataclass(frozen=True)
class Suite:
    """Contenders on the same work. ``unit`` is what a rate counts per second, ``axis`` what a case is.

    Of ``whole`` runs the seconds are shown instead of their rate.
    """

    name: str
    summary: str
    unit: str
    axis: str
    contenders: Sequence[Contender]
    repeats: int = 5
    seconds: float = 0.5
    whole: bool = False


def cases(*counts: int) -> tuple[str, ...]:
    """Counts as cases."""
    return tuple(str(count) for count in counts)


ENVS = cases(1, 16, 64, 256, 1024, 4096, 16_384, 65_536)
LANES = cases(1, 16, 64, 256, 1024, 4096, 16_384)
GROUPS = cases(1, 8, 32, 128, 512, 1024)

COMMANDS = ("article-q, 1 seed", "article-q, 1024 seeds", "dqn, 64 settings, 16 seeds")
MANY_LANES = cases(16, 64, 256, 1024, 4096, 16_384)
CAPACITIES = cases(10**3, 10**4, 10**5, 10**6)
CORES = cases(*machine.core_counts())
WIDTHS = cases(16, 32, 64, 128, 256, 512)


def _scaling(name: str, which: Sequence[str], axis: str, preset: str) -> Contender:
    return Contender(name, "jaxq.bench.scaling", which, (axis, preset))


SCALING = (
    Suite(
        "scaling-lanes",
        "lanes of one length, few to many",
        "updates",
        "lanes",
        [
            _scaling("jaxq, article-q", MANY_LANES, "lanes", "article-q"),
            _scaling("jaxq, article-dqn", MANY_LANES[:4], "lanes", "article-dqn"),
        ],
        repeats=3,
    ),
    Suite(
        "scaling-replay",
        "article-dqn with a full replay",
        "updates",
        "transitions",
        [Contender("jaxq", "jaxq.bench.full_replay", CAPACITIES)],
        repeats=7,
    ),
    Suite(
        "scaling-cores",
        "the same lanes on one core to all",
        "updates",
        "cores",
        [
            _scaling("jaxq, article-q", CORES, "cores", "article-q"),
            _scaling("jaxq, article-dqn", CORES, "cores", "article-dqn"),
        ],
    ),
    Suite(
        "scaling-network",
        f"article-dqn with two hidden layers of one width, {NETWORK_LANES} lanes",
        "updates",
        "units per layer",
        [_scaling("jaxq", WIDTHS, "width", "article-dqn")],
        repeats=3,
    ),
)

SOLVED = tuple(solve.CASES)

SUITES = {
    suite.name: suite
    for suite in (
        Suite(
            "env",
            "CartPole alone under a random policy, keys of both families",
            "env steps",
            "environments",
            [
                Contender("jaxq", "jaxq.bench.env", ENVS, ("pcg4d",)),
                Contender("jaxq, threefry", "jaxq.bench.env", ENVS, ("threefry",)),
            ],
        ),
        Suite(
            "tabular",
            "article-q: act, step, discretise, update",
            "updates",
            "lanes",
            [
                Contender("jaxq", "jaxq.bench.tabular", LANES, ("pcg4d",)),
                Contender("jaxq, threefry", "jaxq.bench.tabular", LANES, ("threefry",)),
            ],
        ),
        Suite(
            "dqn",
            "article-dqn; hidden 64-64 with batch 64; hidden 120-84 with an update per 10 steps",
            "updates",
            "lanes",
            [
                Contender("jaxq", "jaxq.bench.dqn", GROUPS, ("article",)),
                Contender("jaxq, 64-64", "jaxq.bench.dqn", GROUPS[:4], ("64-64",)),
                Contender("jaxq, 120-84", "jaxq.bench.dqn", GROUPS[:4], ("cleanrl",)),
            ],
            repeats=3,
        ),
        Suite(
            "sweep",
            "whole commands, from start to end",
            "runs",
            "command",
            [
                Contender("compile cache empty", "jaxq.bench.sweep", COMMANDS[:2], ("cold",)),
                Contender("compile cache full", "jaxq.bench.sweep", COMMANDS, ("warm",)),
            ],
            repeats=3,
            seconds=0,
            whole=True,
        ),
        Suite(
            "solve",
            "trainings until their episodes, exploration and all, meet the rule of success (dqn: 100 of 475 steps on"
            " average), or reach their limit",
            "seeds",
            "setting",
            [
                Contender("jaxq, seeds together", "jaxq.bench.solve", SOLVED, ("together",), seconds=0),
                Contender("jaxq, one at a time", "jaxq.bench.solve", SOLVED, ("alone",), seconds=0),
            ],
            repeats=1,
            seconds=600,
        ),
        *SCALING,
    )
}


def groups() -> dict[str, list[str]]:
    """Names that mean several suites, those which begin with the name and a hyphen: "scaling"."""
    found: dict[str, list[str]] = {}
    for name in SUITES:
        group, hyphen, _ = name.partition("-")
        if hyphen:
            found.setdefault(group, []).append(name)
    return found
