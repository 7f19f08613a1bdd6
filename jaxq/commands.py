"""``jaxq sweep`` and ``jaxq train``: from a checked plan to rows, tables and pictures."""

from __future__ import annotations

import argparse
import atexit
import contextlib
import gc
import json
import math
import os
import shlex
import shutil
import signal
import sys
import threading
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import Any

from jaxq import cpu, exits, flags
from jaxq.exits import failed
from jaxq.flags import UsageError
from jaxq.plans import Plan, plan
from jaxq.presets import Preset, Training


def run(
    command: str,
    chosen: Preset,
    options: argparse.Namespace,
    asked: Mapping[str, Any] | None = None,
    file: Path | None = None,
) -> int:
    """Runs ``sweep`` or ``train`` of a preset and returns the exit status. Raises UsageError.

    ``asked`` is what ``file`` says, as arguments of ``plan``; flags go before it.
    """
    check(options)
    given = {**(asked or {}), **flags.given_values(chosen, options)}
    for name, value in (("seed", options.seed), ("prng", options.prng)):
        given = given | ({name: value} if value is not None else {})
    if command == "sweep":
        if options.keep is not None and options.keep < 1:
            raise UsageError(f"--keep: {options.keep} is not allowed: at least 1")
        for name in ("seeds", "method", "samples", "halving", "rungs"):
            given = given | ({name: value} if (value := getattr(options, name)) is not None else {})
    given = {"seeds": flags.SEEDS if command == "sweep" else 1} | given
    try:
        planned = plan(**{"name": chosen.name, **given})
    except ValueError as error:
        raise UsageError(f"{file}: {error}" if file else str(error)) from None
    if options.dry_run:
        return _dry_run(planned, options)
    name = planned.default_name() if command == "sweep" else f"train-{planned.default_name()}"
    return execute(command, planned, options.out or Path("runs") / name, options)


def check(options: argparse.Namespace) -> None:
    """Raises UsageError for options that no run can have."""
    if options.workers is not None and options.workers < 1:
        raise UsageError(f"--workers: {options.workers} is not allowed: at least 1")
    if options.resume and options.overwrite:
        raise UsageError("--resume and --overwrite exclude each other")
    if options.allow_mismatch and not options.resume:
        raise UsageError("--allow-mismatch goes with --resume")


def _dry_run(planned: Plan, options: argparse.Namespace) -> int:
    cpu.tune()
    from jaxq import estimate

    settings, seeds, lanes, programs = len(planned.settings), len(planned.seeds), planned.lanes, planned.programs
    try:
        memory = estimate.memory(planned, options.workers)
    except ValueError as error:
        raise UsageError(str(error)) from None
    if options.json:
        counts = {"settings": settings, "seeds": seeds, "lanes": lanes, "programs": programs}
        print(json.dumps(counts | {"memory_bytes": memory}))
    else:
        print(f"{_count(settings, 'setting')} x {_count(seeds, 'seed')} = {_count(lanes, 'lane')}")
        print(_count(programs, "program"))
        print(f"about {estimate.told(memory)} of memory")
    return exits.OK


def say(text: str) -> None:
    """A line of talk."""
    print(text, file=sys.stderr)


def _count(number: int, thing: str) -> str:
    return f"{number} {thing}{'' if number == 1 else 's'}"


def execute(command: str, planned: Plan, path: Path, options: argparse.Namespace) -> int:
    """Runs a plan into a directory and prints what it came to; returns the exit status. Raises UsageError."""
    with _interrupts(options.quiet) as stop:  # ahead of the import of jax, which takes a second
        cpu.tune()
        _collect_rarely()
        from jaxq import estimate
        from jaxq.manifest import RunError
        from jaxq.run_files import WriteError
        from jaxq.runs import Locked, RunDirectory

        try:
            try:
                estimate.check(planned, options.workers)
            except ValueError as error:
                raise UsageError(str(error)) from None
            with RunDirectory.open(
                path,
                planned,
                resume=options.resume,
                overwrite=options.overwrite,
                allow_mismatch=options.allow_mismatch,
                say=say,
            ) as directory:
                return _sweep(command, planned, directory, options, stop)
        except Locked as error:
            return failed(str(error), exits.LOCKED)
        except (WriteError, MemoryError) as error:
            return failed(str(error))
        except RunError as error:
            raise UsageError(str(error)) from None
        except RuntimeError as error:  # jaxlib's
            if "RESOURCE_EXHAUSTED" not in str(error):
                raise
            return failed(f"not enough memory: {str(error).splitlines()[0].removeprefix('RESOURCE_EXHAUSTED: ')}")


def _sweep(command: str, planned: Plan, directory: Any, options: argparse.Namespace, stop: threading.Event) -> int:
    from jaxq import compile_cache, sweeps
    from jaxq.progress import Display
    from jaxq.stages import Listeners

    kept: list[Any] = []
    board = _board(directory.path, planned) if getattr(options, "tensorboard", False) else None
    with Display(planned, show=not (options.quiet or options.no_progress), talk=not options.quiet) as display:
        if options.resume and not directory.resumed:
            display.say(f"nothing to resume in {directory.path}: it begins anew")

        def on_result(result: Any) -> None:
            if board is not None:
                board(result)
            if command == "train":
                kept.append(result)
            elif options.verbose:
                setting = planned.label(result.lane.config) or f"setting {result.lane.config}"
                done = f"{len(result.episodes.total)} episodes, {result.env_steps} steps"
                display.say(f"{setting}, seed {result.lane.seed}: {result.status} after {done}")

        watch = command == "train" and options.verbose
        outcome = sweeps.run(
            planned,
            directory=directory,
            keep_episodes=command == "train" or options.episodes,
            keep_max_q=command == "train",
            keep=getattr(options, "keep", None),
            workers=options.workers,
            cache=None if options.no_cache else compile_cache.user_cache(display.say if options.verbose else None),
            tell=Listeners(
                compiling=display.compiling,
                progress=display.progress,
                result=on_result,
                episodes=_episode_printer(planned.settings[0], display.say) if watch else None,
                rung=display.rung,
            ),
            stop=stop,
        )
    if not outcome.complete:
        if not options.quiet:
            flag = "--resume instead of --overwrite" if options.overwrite else "--resume"
            print(
                f"interrupted: {len(outcome.lanes)} of {planned.lanes} lanes are kept in {directory.path};"
                f" the same command with {flag} and --out {shlex.quote(str(directory.path))} finishes them",
                file=sys.stderr,
            )
        return exits.INTERRUPTED
    return _print(command, planned, outcome, directory, kept, options)


def _board(path: Path, planned: Plan) -> Callable[[Any], None]:
    """Writes TensorBoard's event files of each lane that ends; those of an earlier try are replaced."""
    from jaxq import run_files, tensorboard

    def write(result: Any) -> None:
        folder = path / run_files.TENSORBOARD / f"{result.lane.config}-{result.lane.seed}"
        shutil.rmtree(folder, ignore_errors=True)
        tensorboard.write(folder, result, planned.settings[result.lane.config])

    return write


def _collect_rarely() -> None:
    """JAX and what it traces are a million objects that stay. Python's collector looks through them again and again,
    and twice more as the process ends: together a quarter of a short run.
    """
    gc.set_threshold(50_000)
    atexit.register(gc.freeze)


@contextlib.contextmanager
def _interrupts(quiet: bool) -> Iterator[threading.Event]:
    """First Ctrl-C or SIGTERM: finish the segment, keep what ended. Second: leave at once; what was written stays."""
    stop = threading.Event()

    def handle(number: int, frame: object) -> None:
        if stop.is_set():
            os._exit(exits.INTERRUPTED)
        stop.set()
        if not quiet:
            print("stopping after this segment; once more to stop at once", file=sys.stderr)

    before = {number: signal.signal(number, handle) for number in (signal.SIGINT, signal.SIGTERM)}
    try:
        yield stop
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


def _episode_printer(settings: Training, say: Callable[[str], None]) -> Callable[[Any, Any], None]:
    """Says a line for each episode that was not there the time before."""
    said = 0

    def show(_: Any, episodes: Any) -> None:
        nonlocal said
        for i, (_, length, total, max_q) in enumerate(zip(*(column[said:] for column in episodes), strict=True), said):
            mark = ""
            if settings.stop == "streak":
                mark = "  success" if length - 1 >= settings.success_steps else "  fail"
            best = "-" if math.isnan(max_q) else f"{max_q:.4f}"
            say(f"episode {i}: {length} steps, return {total:g}, best q {best}{mark}")
        said = len(episodes.length)

    return show


def _print(
    command: str, planned: Plan, outcome: Any, directory: Any, kept: list[Any], options: argparse.Namespace
) -> int:
    """Data first, pictures after: one that cannot be drawn takes nothing else with it."""
    from jaxq import report
    from jaxq.presets import TabularSettings
    from jaxq.streams import encodes

    status, summary = exits.OK, outcome.summary()
    if options.json:
        report.print_json(outcome)
    else:
        settings = planned.settings[0]
        if command == "train" and isinstance(settings, TabularSettings):
            print("final Q-table")
            policy = outcome.policy(0, planned.seeds[0])
            discretised = policy.about["edges"] is not None
            print(report.q_table(policy.weights["table"], settings.num_buckets if discretised else (-1,)))
        plain = not encodes(sys.stdout, report.LINES)
        print(report.settings_table(summary, outcome.varied, color=sys.stdout.isatty(), plain=plain))
    sys.stdout.flush()
    try:
        for picture in _pictures(command, planned, outcome, directory, kept):
            if not (options.json and options.quiet):
                print(picture, file=sys.stderr if options.json else sys.stdout)
    except OSError as error:
        status = failed(f"the picture in {directory.path} cannot be written: {error.strerror}")
    sys.stdout.flush()
    if not options.quiet:
        print(f"rows, policies and manifest: {directory.path}", file=sys.stderr)
    for row in summary:
        if row["diverged"] == row["seeds"]:
            named = planned.label(row["config"])
            status = failed(f"{named + ': ' if named else ''}every lane has diverged")
    return status


def _pictures(command: str, planned: Plan, outcome: Any, directory: Any, kept: list[Any]) -> Iterator[Path]:
    """Draws a run's pictures; their paths. Raises OSError."""
    from jaxq import pictures

    if command == "sweep":
        yield pictures.save(outcome.plot("curves"), directory.path / "learning_curves.png")
        return
    values = directory.path / "q_values.png"
    if kept and kept[0].max_q is not None:
        yield pictures.save(pictures.q_values(kept[0].max_q), values)
    elif values.exists():  # of a training that is resumed after its end: no row holds what the picture shows
        yield values
    one = planned.settings[0]
    success_at = one.success_steps if one.stop in ("streak", "window") else None
    lengths = outcome.episodes["length"].to_numpy()
    yield pictures.save(pictures.episode_lengths(lengths, success_at=success_at), directory.path / "episodes.png")
