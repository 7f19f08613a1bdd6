"""Exit statuses, and the last line of a command that fails."""

from __future__ import annotations

import sys

OK, FAILED, USAGE, LOCKED, INTERRUPTED = 0, 1, 2, 75, 130


def failed(what: str, status: int = FAILED) -> int:
    """Says in one line on stderr why a command ends, and returns its status."""
    print(f"jaxq: error: {' '.join(what.split())}", file=sys.stderr)
    return status
