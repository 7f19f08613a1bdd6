"""``jaxq train --from DIR --config I --seed S``: one lane of a sweep again, bit for bit, with episodes and pictures."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

from jaxq import commands, cpu, exits, flags
from jaxq.flags import Once, UsageError, whole
from jaxq.plans import Plan


def arguments(parser: argparse.ArgumentParser) -> None:
    """The flags of the command."""
    parser.add_argument("--from", action=Once, type=flags.directory, required=True, dest="source", metavar="DIR")
    parser.add_argument("--config", action=Once, type=whole, required=True, help="index of the setting", metavar="I")
    parser.add_argument("--seed", action=Once, type=whole, required=True, help="index of the seed", metavar="S")
    parser.add_argument("--env", action=Once, default=None, help=flags.OWN, metavar="MODULE:FUNCTION")
    run = parser.add_argument_group("run")
    flags.directory_flags(run)
    flags.output_flags(run)


def run(options: argparse.Namespace) -> int:
    """Trains the lane and compares it with the row of the sweep; returns the exit status. Raises UsageError."""
    commands.check(options)
    cpu.tune()
    from jaxq.manifest import RunError
    from jaxq.outcome import load

    try:
        outcome = load(options.source, None if options.env is None else flags.own(options.env))
    except (RunError, ValueError) as error:
        raise UsageError(str(error)) from None
    planned = lane_plan(outcome, options.config, options.seed)
    name = f"train-{planned.name}-{options.config}-{options.seed}-{planned.hash()[:8]}"
    path = options.out or Path("runs") / name
    status = commands.execute("train", planned, path, options)
    if status == exits.OK:
        status = _compare(outcome, load(path), options)
    return status


def lane_plan(outcome: Any, config: int, seed: int) -> Plan:
    """The plan of one lane of a sweep. Raises UsageError for what it does not hold."""
    if not 0 <= seed < 2**31:
        raise UsageError(f"--seed: {seed} is not allowed: a seed index, from 0")
    try:
        one = outcome.settings(config)
    except ValueError as error:
        raise UsageError(f"--{error}" if str(error).startswith("config") else str(error)) from None
    spec = outcome.spec
    return Plan(spec["preset"], (one,), (), (seed,), spec["root_seed"], spec["prng"])


def _compare(sweep: Any, again: Any, options: argparse.Namespace) -> int:
    """Whether the row is the sweep's."""
    there = [row for row in sweep.lanes.to_pylist() if (row["config"], row["seed"]) == (options.config, options.seed)]
    if not there:
        if not options.quiet:
            commands.say(f"{options.source}: holds no row of this lane to compare with")
        return exits.OK
    (here,) = again.lanes.to_pylist()
    differing = [name for name, value in there[0].items() if name != "config" and here.get(name) != value]
    if there[0]["status"] == "stopped":
        if not options.quiet:
            commands.say("the sweep stopped this lane at a rung of its halving; here it ran to its end")
        return exits.OK
    if differing:
        name = differing[0]
        return exits.failed(
            f"the lane is not what {options.source} holds: {name} was {there[0][name]}, is {here.get(name)};"
            " other versions, another CPU or other settings of XLA make other bits"
        )
    if not options.quiet:
        commands.say(f"bit for bit the lane that {options.source} holds")
    return exits.OK
