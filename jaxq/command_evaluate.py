"""``jaxq evaluate DIR``: saved policies play again, on the pure environment and in real Gymnasium."""

from __future__ import annotations

import argparse
import json
import math
import sys
from typing import Any

from jaxq import cpu, exits, flags
from jaxq.flags import Once, UsageError, whole
from jaxq.suggest import nearest

EPISODES = 100
WHERE = ("pure", "gymnasium")
CAPTION = (
    "recorded: greedy return at the end of training; the others: fresh episodes from start states that neither training"
    " nor its evaluation saw, so they differ from it"
)


def arguments(parser: argparse.ArgumentParser) -> None:
    """The flags of the command."""
    parser.add_argument("directory", type=flags.directory, metavar="DIR", help="run directory")
    where = f"pure (default), or gymnasium as well; {flags.OWN}"
    parser.add_argument("--env", action=Once, default="pure", help=where, metavar="WHERE|MODULE:FUNCTION")
    parser.add_argument("--config", action=Once, type=whole, default=None, help="this setting's lanes", metavar="I")
    parser.add_argument("--seed", action=Once, type=whole, default=None, help="lanes of this seed index", metavar="S")
    parser.add_argument("--all", action="store_true", help="every lane (default the one of greatest greedy return)")
    parser.add_argument(
        "--episodes", action=Once, type=whole, default=EPISODES, help=f"episodes (default {EPISODES})", metavar="N"
    )
    parser.add_argument("--json", action="store_true", help="print a JSON list of rows")
    parser.add_argument("--quiet", action="store_true", help="no progress and no talk")


def run(options: argparse.Namespace) -> int:
    """Plays the chosen lanes and prints a row each; returns the exit status. Raises UsageError."""
    if options.env not in WHERE and ":" not in options.env:
        raise UsageError(f"--env: {options.env!r} is unknown{nearest(options.env, WHERE)}")
    if not 1 <= options.episodes <= 100_000:
        raise UsageError(f"--episodes: {options.episodes} is not allowed: from 1 to 100000")
    cpu.tune()
    from rich.console import Console
    from rich.progress import track

    from jaxq import report
    from jaxq.manifest import RunError
    from jaxq.outcome import load
    from jaxq.streams import encodes

    try:
        outcome = load(options.directory, None if options.env in WHERE else flags.own(options.env))
        lanes = chosen(outcome, options)
        show = not options.quiet and sys.stderr.isatty()
        watched = track(lanes, "evaluating", console=Console(stderr=True), transient=True, disable=not show)
        rows = [_row(outcome, lane, options) for lane in watched]
    except (RunError, ValueError) as error:
        raise UsageError(str(error)) from None
    if options.json:
        print(json.dumps(rows))
    else:
        print(report.rows_table(rows, plain=not encodes(sys.stdout, report.LINES)))
        print(CAPTION)
    return exits.OK


def chosen(outcome: Any, options: argparse.Namespace) -> list[dict[str, Any]]:
    """The rows of the lanes asked for whose policy was kept: those of ``config`` and ``seed``, with ``all`` every one,
    else the best. Raises UsageError where there is none."""
    kept = outcome.store.policies()
    rows = [row for row in outcome.lanes.to_pylist() if row.get("eval_return") is not None]
    rows = [row for row in rows if (row["config"], row["seed"]) in kept]
    asked = {name: wanted for name in ("config", "seed") if (wanted := getattr(options, name)) is not None}
    rows = [row for row in rows if all(row[name] == wanted for name, wanted in asked.items())]
    if not rows and asked:
        named = ", ".join(f"--{name}: {wanted}" for name, wanted in asked.items())
        raise UsageError(f"{named} has no lane with a policy in {options.directory}")
    if not rows:
        raise UsageError(f"{options.directory}: holds no lane with a policy")
    return rows if getattr(options, "all", False) or asked else [best(rows)]


def best(rows: list[dict[str, Any]]) -> dict[str, Any]:
    """The lane of greatest greedy return, of those that halving did not stop where there are any."""

    def rank(row: dict[str, Any]) -> tuple[bool, float]:
        value = row["eval_return"]
        return row["status"] != "stopped", -math.inf if math.isnan(value) else value

    return max(rows, key=rank)


def _row(outcome: Any, lane: dict[str, Any], options: argparse.Namespace) -> dict[str, Any]:
    import numpy as np

    from jaxq import replayed

    config, seed = lane["config"], lane["seed"]
    played = replayed.play(outcome, config, seed, options.episodes)
    row = {"config": config, "seed": seed, **{name: lane[name] for name in outcome.varied}}
    row |= {"recorded": lane["eval_return"], "pure": float(played.returns.mean(dtype=float))}
    if options.env == "gymnasium":
        from jaxq.interop.gymnasium import reference as gymnasium

        settings = outcome.settings(config)
        returns = gymnasium.greedy_returns(settings.env, outcome.policy(config, seed), played.starts)
        row |= {"gymnasium": float(returns.mean())}
        if gymnasium.same_episodes(settings.env):
            row["same_episodes"] = float(np.isclose(returns, played.returns, rtol=1e-4).mean())
    return row | {"episodes": options.episodes}
