"""What ``jaxq bench`` measures: each suite's contenders, all of them ours."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from jaxq.bench import solve
from jaxq.bench.contest import Contender


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
            "trainings until they are solved, or reach their limit",
            "seeds",
            "setting",
            [
                Contender("jaxq, seeds together", "jaxq.bench.solve", SOLVED, ("together",), seconds=0),
                Contender("jaxq, one at a time", "jaxq.bench.solve", SOLVED, ("alone",), seconds=0),
            ],
            repeats=1,
            seconds=600,
        ),
    )
}
