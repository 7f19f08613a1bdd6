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
import signal
import sys
import threading
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

from jaxq import cpu, flags
from jaxq.flags import UsageError
from jaxq.plans import Plan, plan
from jaxq.presets import Preset, Settings, TabularSettings

EXIT_OK, EXIT_FAILED, EXIT_USAGE, EXIT_LOCKED, EXIT_INTERRUPTED = 0, 1, 2, 75, 130


def run(command: str, chosen: Preset, options: argparse.Namespace) -> int:
    """Runs ``sweep`` or ``train`` of a preset and returns the exit status. Raises UsageError."""
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
        _dry_run(planned, options.json)
        return EXIT_OK
    with _interrupts(options.quiet) as stop:  # ahead of the import of jax, which takes a second
        return _with_directory(command, planned, options, stop)


def _dry_run(planned: Plan, as_json: bool) -> None:
    settings, seeds, lanes, programs = len(planned.settings), len(planned.seeds), planned.lanes, planned.programs
    if as_json:
        print(json.dumps({"settings": settings, "seeds": seeds, "lanes": lanes, "programs": programs}))
    else:
        print(f"{_count(settings, 'setting')} x {_count(seeds, 'seed')} = {_count(lanes, 'lane')}")
        print(_count(programs, "program"))


def _count(number: int, thing: str) -> str:
    return f"{number} {thing}{'' if number == 1 else 's'}"


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
        return _failed(str(error), EXIT_LOCKED)
    except WriteError as error:
        return _failed(str(error))
    except RunError as error:
        raise UsageError(str(error)) from None
    except RuntimeError as error:  # jaxlib's
        if "RESOURCE_EXHAUSTED" not in str(error):
            raise
        return _failed(f"not enough memory: {str(error).splitlines()[0].removeprefix('RESOURCE_EXHAUSTED: ')}")


def _failed(what: str, status: int = EXIT_FAILED) -> int:
    print(f"jaxq: error: {what}", file=sys.stderr)
    return status


def _sweep(command: str, planned: Plan, directory: Any, options: argparse.Namespace, stop: threading.Event) -> int:
    from jaxq import compile_cache, sweeps
    from jaxq.progress import Display

    kept: list[Any] = []
    with Display(planned, show=not (options.quiet or options.no_progress), talk=not options.quiet) as display:
        if options.resume and not directory.resumed:
            display.say(f"nothing to resume in {directory.path}: it begins anew")

        def on_result(result: Any) -> None:
            if command == "train":
                kept.append(result)
            elif options.verbose:
                setting = _label(planned, result.lane.config) or f"setting {result.lane.config}"
                done = f"{len(result.episodes.total)} episodes, {result.env_steps} steps"
                display.say(f"{setting}, seed {result.lane.seed}: {result.status} after {done}")

        watch = command == "train" and options.verbose
        outcome = sweeps.run(
            planned,
            directory=directory,
            keep_episodes=command == "train" or options.episodes,
            keep_max_q=command == "train",
            workers=options.workers,
            cache=None if options.no_cache else compile_cache.user_cache(display.say if options.verbose else None),
            on_compile=display.compiling,
            on_progress=display.progress,
            on_result=on_result,
            on_episodes=_episode_printer(planned.settings[0], display.say) if watch else None,
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
        return EXIT_INTERRUPTED
    return _print(command, outcome, directory, kept, options)


def _label(planned: Plan, config: int) -> str:
    return ", ".join(f"{name} {getattr(planned.settings[config], name)}" for name in planned.varied)


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
            os._exit(EXIT_INTERRUPTED)
        stop.set()
        if not quiet:
            print("stopping after this segment; once more to stop at once", file=sys.stderr)

    before = {number: signal.signal(number, handle) for number in (signal.SIGINT, signal.SIGTERM)}
    try:
        yield stop
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


def _episode_printer(settings: Settings, say: Callable[[str], None]) -> Callable[[Any, Any], None]:
    """Says a line for each episode that was not there the time before."""
    said = 0

    def show(_: Any, episodes: Any) -> None:
        nonlocal said
        for i, (_, length, total, max_q) in enumerate(zip(*(column[said:] for column in episodes), strict=True), said):
            mark = ""
            if isinstance(settings, TabularSettings):
                mark = "  success" if length - 1 >= settings.success_steps else "  fail"
            best = "-" if math.isnan(max_q) else f"{max_q:.4f}"
            say(f"episode {i}: {length} steps, return {total:g}, best q {best}{mark}")
        said = len(episodes.length)

    return show


def _print(command: str, outcome: Any, directory: Any, kept: list[Any], options: argparse.Namespace) -> int:
    """Data first, pictures after: one that cannot be drawn takes nothing else with it."""
    from jaxq import report
    from jaxq.streams import encodes

    status, summary = EXIT_OK, outcome.summary()
    if options.json:
        print(json.dumps({"lanes": outcome.lanes, "summary": summary, "timing": outcome.timing.rows()}))
    else:
        settings = outcome.plan.settings[0]
        if command == "train" and isinstance(settings, TabularSettings):
            print("final Q-table")
            print(report.q_table(directory.policy(0, 0)["table"], settings.num_buckets))
        plain = not encodes(sys.stdout, report.LINES)
        print(report.settings_table(summary, outcome.plan.varied, color=sys.stdout.isatty(), plain=plain))
    sys.stdout.flush()
    try:
        for picture in _pictures(command, outcome, directory, kept):
            if not (options.json and options.quiet):
                print(picture, file=sys.stderr if options.json else sys.stdout)
    except OSError as error:
        status = _failed(f"the picture in {directory.path} cannot be written: {error.strerror}")
    sys.stdout.flush()
    if not options.quiet:
        print(f"rows, policies and manifest: {directory.path}", file=sys.stderr)
    for row in summary:
        if row["diverged"] == row["seeds"]:
            named = _label(outcome.plan, row["config"])
            status = _failed(f"{named + ': ' if named else ''}every lane has diverged")
    return status


def _pictures(command: str, outcome: Any, directory: Any, kept: list[Any]) -> Iterator[Path]:
    """Draws a run's pictures; their paths. Raises OSError."""
    import numpy as np

    from jaxq import plots

    if command == "sweep":
        labels = {i: _label(outcome.plan, i) or outcome.plan.preset.name for i in range(len(outcome.plan.settings))}
        curves = plots.learning_curves(outcome.lanes, outcome.curves, labels)
        yield plots.save(curves, directory.path / "learning_curves.png")
        return
    values = directory.path / "q_values.png"
    if kept and kept[0].max_q is not None:
        yield plots.save(plots.q_values(kept[0].max_q), values)
    elif values.exists():  # of a training that is resumed after its end: no row holds what the picture shows
        yield values
    lengths = np.array([row["length"] for row in directory.rows("episodes")])
    success_at = outcome.plan.settings[0].success_steps
    yield plots.save(plots.episode_lengths(lengths, success_at=success_at), directory.path / "episodes.png")
