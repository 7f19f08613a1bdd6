"""The command line. stdout is data, stderr is talk; a user's mistake is one line and exit 2.

Only this file and the modules it calls print. Nothing here imports jax before the arguments are known to be good.
"""

from __future__ import annotations

import argparse
import atexit
import gc
import json
import os
import signal
import sys
import threading
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

from jaxq import cpu, flags
from jaxq.flags import COMMANDS, UsageError
from jaxq.plans import Plan, plan
from jaxq.presets import Preset, Settings, TabularSettings, preset, presets
from jaxq.suggest import nearest

EXIT_OK, EXIT_FAILED, EXIT_USAGE, EXIT_LOCKED, EXIT_INTERRUPTED = 0, 1, 2, 75, 130


def main(argv: Sequence[str] | None = None) -> int:
    """Runs the command line and returns its exit status."""
    arguments = list(sys.argv[1:] if argv is None else argv)
    try:
        return _dispatch(arguments)
    except UsageError as error:
        print(f"jaxq: error: {' '.join(str(error).split())}", file=sys.stderr)
        return EXIT_USAGE
    except BrokenPipeError:  # the reader of stdout has left
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return EXIT_OK


def _dispatch(arguments: list[str]) -> int:
    if not arguments or arguments[0].startswith("-"):
        flags.overview().parse_args(arguments or ["--help"])
        return EXIT_OK
    command, rest = arguments[0], arguments[1:]
    if command == "list":
        flags.Parser(prog="jaxq list", description=COMMANDS["list"]).parse_args(rest)
        return _list()
    if command == "bench":
        return _bench(rest)
    if command not in COMMANDS:
        raise UsageError(f"command {command!r} is unknown{nearest(command, COMMANDS)}")
    if not rest:
        raise UsageError(f"jaxq {command} needs a preset: {', '.join(p.name for p in presets())}")
    if rest[0].startswith("-"):
        flags.preset_overview(command).parse_args(rest)
    try:
        chosen = preset(rest[0])
    except ValueError as error:
        raise UsageError(str(error)) from None
    return _run(command, chosen, flags.parse(command, chosen, rest[1:]))


def _list() -> int:
    from jaxq.envs import names

    print("presets")
    for p in presets():
        print(f"  {p.name:14}{p.summary}")
    print("environments")
    for name in names():
        print(f"  {name}")
    return EXIT_OK


def _bench(words: list[str]) -> int:
    from jaxq.bench import command

    parser = flags.Parser(prog="jaxq bench", description=COMMANDS["bench"], allow_abbrev=False)
    command.arguments(parser)
    try:
        command.run(parser.parse_args(words))
    except ValueError as error:
        raise UsageError(str(error)) from None
    return EXIT_OK


def _run(command: str, chosen: Preset, options: argparse.Namespace) -> int:
    if options.workers is not None and options.workers < 1:
        raise UsageError(f"--workers: {options.workers} is not allowed: at least 1")
    if options.resume and options.overwrite:
        raise UsageError("--resume and --overwrite exclude each other")
    try:
        planned = plan(
            chosen.name,
            seeds=options.seeds if command == "sweep" else 1,
            root_seed=options.seed,
            prng=options.prng,
            **flags.given_values(chosen, options),
        )
    except ValueError as error:
        raise UsageError(str(error)) from None
    if options.dry_run:
        print(f"{len(planned.settings)} settings x {len(planned.seeds)} seeds = {planned.lanes} lanes")
        print(f"{planned.programs} programs")
        return EXIT_OK
    stop = threading.Event()
    before = _on_interrupt(stop, options.quiet)  # ahead of the import of jax, which takes a second
    try:
        return _with_directory(command, planned, options, stop)
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


def _with_directory(command: str, planned: Plan, options: argparse.Namespace, stop: threading.Event) -> int:
    cpu.tune()
    _collect_rarely()
    from jaxq.manifest import RunError
    from jaxq.runs import Locked, RunDirectory, WriteError

    name = planned.default_name() if command == "sweep" else f"train-{planned.default_name()}"
    path = options.out or Path("runs") / name
    try:
        with RunDirectory.open(path, planned, resume=options.resume, overwrite=options.overwrite) as directory:
            return _sweep(command, planned, directory, options, stop)
    except Locked as error:
        print(f"jaxq: error: {error}", file=sys.stderr)
        return EXIT_LOCKED
    except WriteError as error:
        print(f"jaxq: error: {error}", file=sys.stderr)
        return EXIT_FAILED
    except RunError as error:
        raise UsageError(str(error)) from None


def _sweep(command: str, planned: Plan, directory: Any, options: argparse.Namespace, stop: threading.Event) -> int:
    from jaxq import compile_cache, sweeps
    from jaxq.progress import Display

    kept: list[Any] = []
    with Display(planned, show=not (options.quiet or options.no_progress), talk=not options.quiet) as display:
        episodes = (
            _episode_printer(planned.settings[0], display.say) if command == "train" and options.verbose else None
        )

        def on_result(result: Any) -> None:
            if command == "train":
                kept.append(result)
            elif options.verbose:
                display.say(
                    f"setting {result.lane.config} seed {result.lane.seed}: {result.status} after"
                    f" {len(result.episodes.total)} episodes, {result.env_steps} steps"
                )

        cache = None if options.no_cache else compile_cache.user_cache(display.say if options.verbose else None)
        outcome = sweeps.run(
            planned,
            directory=directory,
            keep_episodes=command == "train" or options.episodes,
            keep_max_q=command == "train",
            workers=options.workers,
            cache=cache,
            on_compile=display.compiling,
            on_progress=display.progress,
            on_result=on_result,
            on_episodes=episodes,
            stop=stop,
        )
    if not outcome.complete:
        if not options.quiet:
            print(
                f"interrupted: {len(outcome.lanes)} of {planned.lanes} lanes are kept in {directory.path};"
                f" the same command with --resume --out {directory.path} finishes them",
                file=sys.stderr,
            )
        return EXIT_INTERRUPTED
    _print(command, outcome, directory, kept, options)
    hopeless = any(row["diverged"] == row["seeds"] for row in outcome.summary())
    return EXIT_FAILED if hopeless else EXIT_OK


def _collect_rarely() -> None:
    """JAX and what it traces are a million objects that stay. Python's collector looks through them again and again,
    and twice more as the process ends: together a quarter of a short run.
    """
    gc.set_threshold(50_000)
    atexit.register(gc.freeze)


def _on_interrupt(stop: threading.Event, quiet: bool) -> dict[int, Any]:
    """First Ctrl-C or SIGTERM: finish the segment and keep what ended. Second: leave at once; what was written stays.

    Returns the handlers that were there before.
    """

    def handle(number: int, frame: object) -> None:
        if stop.is_set():
            os._exit(EXIT_INTERRUPTED)
        stop.set()
        if not quiet:
            print("stopping after this segment; once more to stop at once", file=sys.stderr)

    return {number: signal.signal(number, handle) for number in (signal.SIGINT, signal.SIGTERM)}


def _episode_printer(settings: Settings, say: Callable[[str], None]) -> Callable[[Any, Any], None]:
    """Says a line for each episode that was not there the time before."""
    said = 0

    def show(_: Any, episodes: Any) -> None:
        nonlocal said
        for i, (_, length, total, max_q) in enumerate(zip(*(column[said:] for column in episodes), strict=True), said):
            mark = ""
            if isinstance(settings, TabularSettings):
                mark = "  success" if length - 1 >= settings.success_steps else "  fail"
            say(f"episode {i}: {length} steps, return {total:g}, best q {max_q:.4f}{mark}")
        said = len(episodes.length)

    return show


def _print(command: str, outcome: Any, directory: Any, kept: list[Any], options: argparse.Namespace) -> None:
    from jaxq import report

    summary = outcome.summary()
    pictures = _pictures(command, outcome, directory, kept)
    if options.json:
        print(json.dumps({"lanes": outcome.lanes, "summary": summary, "timing": outcome.timing.rows()}))
    else:
        settings = outcome.plan.settings[0]
        if command == "train" and isinstance(settings, TabularSettings):
            print("final Q-table")
            print(report.q_table(directory.policy(0, 0)["table"], settings.num_buckets))
        print(report.settings_table(summary, outcome.plan.varied, color=sys.stdout.isatty()))
    for picture in pictures:
        print(picture, file=sys.stderr if options.json else sys.stdout)
    sys.stdout.flush()
    if not options.quiet:
        print(f"rows, policies and manifest: {directory.path}", file=sys.stderr)


def _pictures(command: str, outcome: Any, directory: Any, kept: list[Any]) -> list[Path]:
    import numpy as np

    from jaxq import plots

    if command == "sweep":
        labels = {
            i: ", ".join(f"{name} {getattr(one, name)}" for name in outcome.plan.varied) or outcome.plan.preset.name
            for i, one in enumerate(outcome.plan.settings)
        }
        curves = plots.learning_curves(outcome.lanes, outcome.curves, labels)
        return [plots.save(curves, directory.path / "learning_curves.png")]
    figures = {}
    if kept and kept[0].max_q is not None:
        figures["q_values.png"] = plots.q_values(kept[0].max_q)
    lengths = np.array([row["length"] for row in directory.rows("episodes")])
    success_at = outcome.plan.settings[0].success_steps
    figures["episodes.png"] = plots.episode_lengths(lengths, success_at=success_at)
    for name, figure in figures.items():
        plots.save(figure, directory.path / name)
    # A training that was resumed after its end keeps the picture of its values: no row holds them.
    return [file for name in ("q_values.png", "episodes.png") if (file := directory.path / name).exists()]
