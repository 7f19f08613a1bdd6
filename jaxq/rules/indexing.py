"""One of several: what belongs to the action taken, and a number that is worked out once."""

from __future__ import annotations

import jax.numpy as jnp

from jaxq.types import Array


def taken(rows: Array, index: Array, axis: int = 0) -> Array:
    """The row at an index, and zeros for an index outside 0 .. A - 1: a negative one does not count from the end.

    Under vmap a gather with a bound is as quick as a bare one and several times as quick as a masked sum, whose
    gradient is a pass over all actions too.

    >>> taken(jnp.array([[1.0, 2.0], [3.0, 4.0]]), jnp.array(1), axis=1).tolist()
    [2.0, 4.0]
    """
    where = (slice(None),) * axis + (index,)
    return rows.at[where].get(mode="fill", fill_value=0, wrap_negative_indices=False)


def once(value: Array, index: Array, length: int) -> Array:
    """The same number, and 0 for an index outside 0 .. length - 1: a masked sum of one term.

    XLA fuses no reduction into a loop that reads it again and again. As plain arithmetic a number that a pass over a
    table needs, with all that leads to it, would be computed within that pass, cell by cell and lane by lane.

    >>> float(once(jnp.array(3.0), jnp.array(1), 2))
    3.0
    """
    return jnp.sum(jnp.where(jnp.arange(length) == index, value, 0), dtype=value.dtype)
