"""Updates of a table of action values, and eligibility traces of the same shape.

A cell outside the table is not visited: nothing is added, and traces fade alone. States and actions are integers, or it
is a TypeError. A table keeps its dtype, so that a scan can carry it.
"""

from __future__ import annotations

import jax.numpy as jnp
import numpy as np

from jaxq.rules.indexing import once
from jaxq.rules.shapes import arrays
from jaxq.types import Array, ArrayLike

#: Tables up to this many cells are written densely: on a CPU a masked pass over a small table is vector code, where
#: a scatter is a loop.
DENSE_CELLS = 512


def update_table(table: ArrayLike, state: ArrayLike, action: ArrayLike, amount: ArrayLike) -> Array:
    """The table with ``amount`` added to one cell.

    q[state, action] += amount. Shapes: table [S, A], the rest [] -> [S, A]. Raises ValueError for other shapes, and
    TypeError for an amount that is no whole number where the table has these alone. Sutton and Barto, 2018, section
    6.1.

    >>> update_table(jnp.zeros((2, 2)), jnp.array(1), jnp.array(0), 3.0).tolist()
    [[0.0, 0.0], [3.0, 0.0]]
    """
    table, state, action, amount = arrays(
        table=(table, "SA"), state=(state, ""), action=(action, ""), amount=(amount, "")
    )
    if jnp.issubdtype(table.dtype, jnp.integer) and not jnp.issubdtype(amount.dtype, jnp.integer):
        raise TypeError(f"amount: dtype {amount.dtype} is not allowed: an integer, as the table's")
    amount = amount.astype(table.dtype)
    if table.size > DENSE_CELLS:
        return table.at[state, action].add(amount, mode="drop", wrap_negative_indices=False)
    columns = table.shape[1]
    cell = once(_row(state, table) * columns + _wide(action), action, columns)
    amount = once(amount, action, columns)
    flat = table.reshape(-1)
    # An array of numbers, not arange: XLA counts an iota in 64 bits, half as many at a time.
    return (flat + jnp.where(np.arange(flat.size, dtype=np.int32) == cell, amount, 0)).reshape(table.shape)


def accumulating_trace(trace: ArrayLike, state: ArrayLike, action: ArrayLike, decay_t: ArrayLike) -> Array:
    """A trace that counts visits: each adds 1 to what is left of those before.

    e = decay_t e; e[state, action] += 1. ``decay_t`` is gamma lambda, 0 where the trajectory was cut before this visit.
    Shapes: trace [S, A], the rest [] -> [S, A]. Raises ValueError for other shapes. Sutton and Barto, 2018, section
    12.2.

    >>> accumulating_trace(jnp.array([[2.0, 1.0]]), jnp.array(0), jnp.array(0), 0.5).tolist()
    [[2.0, 0.5]]
    """
    return _visit(trace, state, action, decay_t, 1)


def replacing_trace(trace: ArrayLike, state: ArrayLike, action: ArrayLike, decay_t: ArrayLike) -> Array:
    """A trace that remembers the last visit alone.

    e = decay_t e; e[state, action] = 1. Shapes: trace [S, A], the rest [] -> [S, A]. Raises ValueError for other
    shapes. Singh and Sutton, *Reinforcement Learning with Replacing Eligibility Traces*, 1996.

    >>> replacing_trace(jnp.array([[2.0, 1.0]]), jnp.array(0), jnp.array(0), 0.5).tolist()
    [[1.0, 0.5]]
    """
    return _visit(trace, state, action, decay_t, 0)


def dutch_trace(
    trace: ArrayLike, state: ArrayLike, action: ArrayLike, decay_t: ArrayLike, step_size: ArrayLike
) -> Array:
    """A trace between the two: a visit takes the share ``step_size`` from those before.

    e = decay_t e; e[state, action] = (1 - step_size) e[state, action] + 1. Shapes: trace [S, A], the rest [] -> [S, A].
    Raises ValueError for other shapes. Van Seijen and Sutton, *True Online TD(lambda)*, 2014.

    >>> dutch_trace(jnp.array([[2.0, 1.0]]), jnp.array(0), jnp.array(0), 0.5, 0.25).tolist()
    [[1.75, 0.5]]
    """
    (step_size,) = arrays(step_size=(step_size, ""))
    return _visit(trace, state, action, decay_t, 1 - step_size)


def _visit(trace: ArrayLike, state: ArrayLike, action: ArrayLike, decay_t: ArrayLike, kept: ArrayLike) -> Array:
    """e = decay_t e, and in the visited cell kept e + 1."""
    trace, state, action, decay_t = arrays(
        trace=(trace, "SA"), state=(state, ""), action=(action, ""), decay_t=(decay_t, "")
    )
    if not jnp.issubdtype(trace.dtype, jnp.floating):
        raise TypeError(f"trace: dtype {trace.dtype} is not allowed: a floating-point one")
    faded = trace * decay_t
    rows, columns = faded.shape
    cells = np.arange(rows * columns, dtype=np.int32).reshape(rows, columns)
    action = _wide(action)
    inside = (action >= 0) & (action < columns)  # an action outside is not one of the next state
    cell = jnp.where(inside, _row(state, trace) * columns + action, -1)
    return jnp.where(cells == cell, kept * faded + 1, faded).astype(trace.dtype)


def _row(state: Array, table: Array) -> Array:
    """A state whose cells can be counted in 32 bits; one outside the table has none within."""
    return jnp.clip(_wide(state), -1, table.shape[0]).astype(jnp.int32)


def _wide(index: Array) -> Array:
    """An index of at least 32 bits: fewer may not hold the number of rows or columns that it is compared with."""
    return index.astype(jnp.promote_types(index.dtype, jnp.int32))
