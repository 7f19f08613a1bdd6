"""stdout and stderr that may be closed, full, or short of characters: talk never stops a run, lost data is said."""

from __future__ import annotations

import contextlib
import os
import sys
from collections.abc import Iterator
from typing import Any


class StdoutError(Exception):
    """Data could not be written to stdout; the message says why."""


class _Stream:
    """A text stream with another way to fail."""

    def __init__(self, stream: Any):
        self._stream = stream

    def write(self, text: str) -> int:
        return self._try(self._stream.write, text) or len(text)

    def flush(self) -> None:
        self._try(self._stream.flush)

    def _try(self, work: Any, *words: str) -> Any:
        try:
            return work(*words)
        except OSError as error:
            with contextlib.suppress(OSError, ValueError):  # else what is still in its buffer fails again at the exit
                os.dup2(os.open(os.devnull, os.O_WRONLY), self._stream.fileno())
            self._failed(error)

    def _failed(self, error: OSError) -> None:
        """The reader has left, or the disk is full: silence."""

    def __getattr__(self, name: str) -> Any:
        return getattr(self._stream, name)


class _Data(_Stream):
    def _failed(self, error: OSError) -> None:
        if not isinstance(error, BrokenPipeError):  # a reader that has left has had enough
            raise StdoutError(f"stdout: {error.strerror}") from None


@contextlib.contextmanager
def guarded() -> Iterator[None]:
    """Within it, a stderr that is gone is silent, a stdout that is full raises StdoutError, a stdout whose reader has
    left is silent, one that is closed goes nowhere, and characters that its encoding lacks become question marks.
    """
    before = sys.stdout, sys.stderr
    with contextlib.ExitStack() as opened:

        def somewhere(stream: Any) -> Any:
            return stream if stream is not None else opened.enter_context(open(os.devnull, "w"))

        if hasattr(sys.stdout, "reconfigure"):
            sys.stdout.reconfigure(errors="replace")
        sys.stdout, sys.stderr = _Data(somewhere(sys.stdout)), _Stream(somewhere(sys.stderr))
        try:
            yield
            sys.stdout.flush()
        finally:
            sys.stdout, sys.stderr = before


def encodes(stream: Any, text: str) -> bool:
    """Whether a stream's encoding has all of these characters."""
    try:
        text.encode(getattr(stream, "encoding", None) or "utf-8")
    except (UnicodeEncodeError, LookupError):
        return False
    return True
