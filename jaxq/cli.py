"""The command line. stdout is data, stderr is talk; a user's mistake is one line and exit 2.

Nothing here imports jax before the arguments are known to be good.
"""

from __future__ import annotations

import importlib
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from jaxq import commands, exits, flags, streams, sweep_files, worlds
from jaxq.flags import COMMANDS, UsageError
from jaxq.presets import listed, preset, presets
from jaxq.suggest import nearest


def main(argv: Sequence[str] | None = None) -> int:
    """Runs the command line and returns its exit status."""
    arguments = list(sys.argv[1:] if argv is None else argv)
    try:
        with streams.guarded():
            try:
                return _dispatch(arguments)
            except UsageError as error:
                print(f"jaxq: error: {' '.join(str(error).split())}", file=sys.stderr)
                return exits.USAGE
    except streams.StdoutError as error:
        print(f"jaxq: error: {error}", file=sys.stderr)
        return exits.FAILED


def _dispatch(arguments: list[str]) -> int:
    if not arguments or arguments[0].startswith("-"):
        flags.read(flags.overview(), arguments or ["--help"], "jaxq")
        raise UsageError(f"jaxq needs a command: {', '.join(COMMANDS)}")
    command, rest = arguments[0], arguments[1:]
    if command == "list":
        flags.read(flags.Parser(prog="jaxq list", description=COMMANDS["list"], allow_abbrev=False), rest, "jaxq list")
        return _list()
    if command == "bench":
        return _bench(rest)
    if command not in COMMANDS:
        raise UsageError(f"command {command!r} is unknown{nearest(command, COMMANDS)}")
    if command in ("report", "evaluate", "record", "play", "verify") or (
        command == "train" and any(w.split("=")[0] == "--from" for w in rest)
    ):
        return _by_module(command, rest)
    if not rest:
        raise UsageError(f"jaxq {command} needs a preset: {', '.join(p.name for p in presets())}")
    if rest[0].startswith("-"):
        if rest[0] in ("-h", "--help"):
            flags.preset_overview(command).parse_args(rest)
        raise UsageError(f"the preset comes first: jaxq {command} PRESET {' '.join(rest[:1])} ...")
    asked: dict[str, Any] = {}
    file = Path(rest[0]) if command == "sweep" and rest[0].endswith(".toml") else None
    try:
        if file:
            asked = sweep_files.read(file)
        chosen = preset(asked.pop("name", rest[0]))
    except ValueError as error:
        raise UsageError(str(error)) from None
    return commands.run(command, chosen, flags.parse(command, chosen, rest[1:], asked.get("env")), asked, file)


def _by_module(command: str, words: list[str]) -> int:
    """The commands that take no preset."""
    module = importlib.import_module(f"jaxq.command_{command}")
    about = COMMANDS[command]
    parser = flags.Parser(prog=f"jaxq {command}", description=f"{about[0].upper()}{about[1:]}.", allow_abbrev=False)
    module.arguments(parser)
    return module.run(flags.read(parser, words, f"jaxq {command}"))


def _list() -> int:
    print(f"presets\n{listed()}")
    print(f"environments\n{worlds.listed()}")
    return exits.OK


def _bench(words: list[str]) -> int:
    from jaxq.bench import command

    parser = flags.Parser(prog="jaxq bench", description=COMMANDS["bench"], allow_abbrev=False)
    command.arguments(parser)
    options, suites = command.read(parser, words, "jaxq bench")
    results = command.run(suites, options)
    failed = any(row["error"] for result in results.values() for row in result["rows"])
    return exits.FAILED if failed else exits.OK
