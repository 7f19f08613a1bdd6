"""What an error message about an unknown name ends with."""

from __future__ import annotations

import difflib
from collections.abc import Iterable


def nearest(word: str, known: Iterable[str]) -> str:
    """The nearest known word as a question, or all known words.

    >>> nearest("gama", ["gamma", "tau"])
    "; did you mean 'gamma'?"
    """
    known = list(known)
    near = difflib.get_close_matches(word, known, n=1)
    return f"; did you mean {near[0]!r}?" if near else f"; known: {', '.join(known)}"
