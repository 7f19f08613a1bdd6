"""``jaxq report DIR``: the report of a run directory."""

from __future__ import annotations

import argparse
import sys

from jaxq import cpu, exits, flags
from jaxq.exits import failed
from jaxq.flags import UsageError


def arguments(parser: argparse.ArgumentParser) -> None:
    """The flags of the command."""
    parser.add_argument("directory", type=flags.directory, metavar="DIR", help="run directory")
    parser.add_argument("--quiet", action="store_true", help="no progress")


def run(options: argparse.Namespace) -> int:
    """Writes the report and prints its path; returns the exit status. Raises UsageError."""
    cpu.tune()
    from rich.console import Console

    from jaxq import page
    from jaxq.manifest import RunError
    from jaxq.outcome import load
    from jaxq.run_files import WriteError

    console = Console(stderr=True)
    try:
        outcome = load(options.directory)
        if not len(outcome.lanes):
            raise UsageError(f"{options.directory}: holds no lane yet")
        with console.status("reading") as status:
            told = (lambda name: None) if options.quiet else (lambda name: status.update(f"drawing {name}"))
            written = page.write(outcome, options.directory, told)
    except RunError as error:
        raise UsageError(str(error)) from None
    except WriteError as error:
        return failed(str(error))
    except OSError as error:
        return failed(f"the report in {options.directory} cannot be written: {error.strerror}")
    print(written)
    sys.stdout.flush()
    return exits.OK
