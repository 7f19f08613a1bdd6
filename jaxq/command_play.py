"""``jaxq play DIR``: greedy episodes of a saved policy in the terminal, at the world's own pace."""

from __future__ import annotations

import argparse
import sys
import time

from jaxq import command_record, cpu, exits
from jaxq.flags import UsageError


def arguments(parser: argparse.ArgumentParser) -> None:
    """The flags of the command."""
    command_record.episode_arguments(parser)
    parser.add_argument("--quiet", action="store_true", help="no talk")


def run(options: argparse.Namespace) -> int:
    """Plays the lane on the terminal's other screen; returns the exit status. Raises UsageError."""
    cpu.tune()
    command_record.check_episodes(options)
    from rich.console import Console
    from rich.live import Live

    from jaxq import frames, recording
    from jaxq.frames import terminal
    from jaxq.streams import encodes

    console = Console()
    if not (console.is_terminal and console.color_system and encodes(sys.stdout, terminal.BLOCK)):
        raise UsageError("jaxq play needs a terminal with colours and blocks: jaxq record writes a film")
    try:
        with Console(stderr=True, quiet=options.quiet).status("playing"):
            lane = command_record.played(options)
        between = recording.scale(lane.episodes)
        names = recording.actions(lane.world, lane.episodes)
        drawn = frames.drawn(lane.world)
        with Live(console=console, screen=True, auto_refresh=False) as live:
            due = time.monotonic()
            for scene in recording.scenes(lane.world, lane.episodes, options.fps):
                picture = frames.draw(lane.world, scene.state) if drawn else None
                words = (lane.title, *names)
                live.update(terminal.screen(picture, scene.moment, between, words, console.size), refresh=True)
                due += scene.seconds
                time.sleep(max(0.0, due - time.monotonic()))
                due = max(due, time.monotonic())  # a slow terminal is late, and does not hurry afterwards
    except KeyboardInterrupt:
        return exits.INTERRUPTED
    if not options.quiet:
        print(lane.returns(), file=sys.stderr)
    return exits.OK
