"""What every world is: an environment's numbers and options, each with its default, unit, range and help."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any, ClassVar, TypeAlias

from jaxq.settings import Settings

#: Range of what has a size.
SIZE = {"ge": 1e-6, "le": 1e6}
#: Range of what may have either sign.
SIGNED = {"ge": -1e6, "le": 1e6}

#: The low and high of each coordinate.
Bounds: TypeAlias = Sequence[tuple[Any, Any]]


class World(Settings):
    """An environment's numbers and options.

    ``summary`` says what it is in a line. ``reward_threshold`` is the mean return at which it counts as solved, where
    there is such a thing. ``factory`` is the user's own function of the fields, None for an environment that ``envs``
    knows by its ``id``. ``buckets`` is into how many parts tables divide each coordinate of an observation unless told
    otherwise, between its ``bounds``; None where a table needs none, or has bounds among its own settings. A greedy
    evaluation is cut at ``eval_steps``, where an episode might never end. ``frame_rate`` is how many steps of it a
    second shows.
    """

    id: ClassVar[str] = ""
    summary: ClassVar[str] = ""
    reward_threshold: ClassVar[float | None] = None
    buckets: ClassVar[tuple[int, ...] | None] = None
    eval_steps: ClassVar[int] = 10**6
    frame_rate: ClassVar[int] = 30
    factory: ClassVar[Callable[..., Any] | None] = None
    source: ClassVar[str | None] = (
        None  # of the user's function, what sources.digest says: a run directory remembers it
    )

    def __str__(self) -> str:
        return self.id

    def actions(self) -> tuple[str, ...]:
        """What each action does, in a word; empty where nobody has said."""
        return ()

    @staticmethod
    def observed(numbers: Any) -> Bounds | None:
        """The least and greatest of each coordinate of an observation, which may be infinite; None where nobody has
        said. ``numbers`` is a world of this kind, or the record of its numbers in ``envs``."""
        return None

    @property
    def bounds(self) -> Bounds | None:
        """The low and high of each coordinate between which tables divide an observation; None where ``buckets`` is."""
        return None if self.buckets is None else self.observed(self)

    def identity(self) -> Any:
        """The environment, or the user's function itself: two may have one name."""
        return type(self).factory or self.id
