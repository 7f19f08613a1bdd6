"""``jaxq record DIR``: greedy episodes of a saved policy as a GIF, and as MP4 where ffmpeg is."""

from __future__ import annotations

import argparse
import os
import sys
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

from jaxq import cpu, exits, flags
from jaxq.command_evaluate import best, chosen
from jaxq.flags import Once, UsageError, whole
from jaxq.run_files import RECORDINGS, WriteError
from jaxq.worlds import World

if TYPE_CHECKING:
    from jaxq.recording import Taken


class Played(NamedTuple):
    """Greedy episodes of one lane, and what they are called."""

    world: World
    title: str
    episodes: list[list[Taken]]

    def returns(self) -> str:
        """A line of talk."""
        from jaxq import recording

        return f"returns: {', '.join(f'{one:.6g}' for one in recording.returns(self.episodes))}"


def episode_arguments(parser: argparse.ArgumentParser) -> None:
    """The flags that say which episodes."""
    parser.add_argument("directory", type=flags.directory, metavar="DIR", help="run directory")
    parser.add_argument("--env", action=Once, default=None, help=flags.OWN, metavar="MODULE:FUNCTION")
    parser.add_argument("--config", action=Once, type=whole, default=None, help="this setting's lane", metavar="I")
    parser.add_argument("--seed", action=Once, type=whole, default=None, help="lane of this seed index", metavar="S")
    parser.add_argument("--episodes", action=Once, type=whole, default=1, help="episodes (default 1)", metavar="N")
    parser.add_argument(
        "--max-steps", action=Once, type=whole, default=1000, help="cut episodes here (default 1000)", metavar="M"
    )
    parser.add_argument(
        "--fps", action=Once, type=float, default=None, help="steps per second (default the world's own)", metavar="F"
    )


def check_episodes(options: argparse.Namespace) -> None:
    """Raises UsageError for flags of episodes that are out of range."""
    from jaxq import recording

    try:
        recording.check(options.episodes, options.max_steps, options.fps)
    except ValueError as error:
        raise UsageError(f"--{str(error).replace('max_steps', 'max-steps')}") from None


def played(options: argparse.Namespace, tell: Callable[[float, int], None] = lambda done, of: None) -> Played:
    """The episodes that the flags ask for; ``tell`` is called as they are played. Raises UsageError."""
    from jaxq import recording
    from jaxq.manifest import RunError
    from jaxq.outcome import load

    try:
        outcome = load(options.directory, None if options.env is None else flags.own(options.env))
        lane = best(chosen(outcome, options))
        config, seed = lane["config"], lane["seed"]
        episodes = recording.play(outcome, config, seed, options.episodes, options.max_steps, tell)
    except (RunError, ValueError) as error:
        raise UsageError(str(error)) from None
    return Played(outcome.settings(config).env, recording.title(outcome, config, seed), episodes)


def arguments(parser: argparse.ArgumentParser) -> None:
    """The flags of the command."""
    episode_arguments(parser)
    parser.add_argument(
        "--out",
        action=Once,
        type=Path,
        default=None,
        help="FILE.gif or FILE.mp4 (default DIR/record.gif, and DIR/record.mp4 where ffmpeg is)",
        metavar="FILE",
    )
    parser.add_argument("--quiet", action="store_true", help="no progress and no talk")


def run(options: argparse.Namespace) -> int:
    """Plays the lane and writes the films; prints their paths and returns the exit status. Raises UsageError."""
    cpu.tune()
    check_episodes(options)
    targets = _targets(options)
    from rich.console import Console
    from rich.progress import Progress

    from jaxq import recording

    show = not options.quiet and sys.stderr.isatty()
    try:
        with Progress(console=Console(stderr=True), transient=True, disable=not show) as progress:
            task = progress.add_task("playing", total=options.episodes)

            def tell(done: float, of: int) -> None:
                progress.update(task, completed=done, total=of)

            lane = played(options, tell)
            for target in targets:
                progress.reset(task, description=f"drawing {target.suffix[1:].upper()}")
                recording.write(target, lane.world, lane.episodes, lane.title, options.fps, tell)
                print(target)
    except WriteError as error:
        return exits.failed(str(error))
    except KeyboardInterrupt:
        return exits.INTERRUPTED
    if not options.quiet:
        print(lane.returns(), file=sys.stderr)
    return exits.OK


def _targets(options: argparse.Namespace) -> list[Path]:
    """The files to write. Raises UsageError for what cannot be written, before anything is played."""
    from jaxq.recording import ENDINGS, MP4, ffmpeg

    program, given = ffmpeg(), options.out
    if given is not None and given.suffix.lower() not in ENDINGS:
        raise UsageError(f"--out: {given} is not allowed: a name that ends in {' or '.join(ENDINGS)}")
    if given is not None and not given.parent.is_dir():
        raise UsageError(f"--out: {given.parent} is not a directory")
    if given is not None and given.suffix.lower() == MP4 and program is None:
        raise UsageError(f"--out: {given} needs ffmpeg, which is not on the path: FILE.gif needs nothing")
    names = RECORDINGS if program is not None else RECORDINGS[:1]
    targets = [options.directory / name for name in names] if given is None else [given]
    for target in targets:
        if target.is_dir():
            raise UsageError(f"--out: {target} is a directory")
        if not os.access(target.parent, os.W_OK | os.X_OK):
            raise UsageError(f"--out: {target.parent} takes no files: name another FILE")
    return targets
