"""Errors for what is not one transition: shapes by letters, the same in every docstring of the rules.

====  ==========================================
A     actions
T     time, steps of one trajectory
K     atoms of a categorical distribution, or members of an ensemble
N     quantiles
M     another number of atoms or quantiles
S     states of a table
====  ==========================================
"""

from __future__ import annotations

import jax
import jax.numpy as jnp
import numpy as np

from jaxq.types import Array, ArrayLike

#: Arguments that count something, so that another dtype is an error.
INDICES = ("a_tm1", "a_t", "state", "action")
#: Arguments that may be whole numbers and stay so; others are made floating-point ones, as sums of bytes overflow.
WHOLE = (*INDICES, "table", "amount", "trace", "updates", "period", "cut_t")


def arrays(**arguments: tuple[ArrayLike, str]) -> tuple[Array, ...]:
    """The arguments as JAX's arrays, where each has the axes that its letters name: "" for a scalar, "TA" for [T, A].

    A letter is one length in all arguments; actions and states must be integers, values become floating-point. Raises
    ValueError for a shape and TypeError for a dtype, in one line that names the argument.

    >>> arrays(q_tm1=(jnp.zeros(3), "A"), q_t=(jnp.zeros(2), "A"))
    Traceback (most recent call last):
    ValueError: q_t: shape (2,) is not allowed: [A], A = 3 as in q_tm1
    """
    lengths: dict[str, tuple[int, str]] = {}
    found = []
    for name, (given, letters) in arguments.items():
        allowed = f"[{', '.join(letters)}]"
        try:
            value = jnp.asarray(given)
        except (TypeError, ValueError):
            raise TypeError(f"{name}: {given!r} is not allowed: numbers, {allowed}") from None
        if value.ndim != len(letters):
            batch = "; a rule sees one transition, jax.vmap adds a batch" if value.ndim > len(letters) else ""
            raise ValueError(f"{name}: shape {value.shape} is not allowed: {allowed}{batch}")
        for letter, length in zip(letters, value.shape, strict=True):
            known, first = lengths.setdefault(letter, (length, name))
            if known != length:
                raise ValueError(
                    f"{name}: shape {value.shape} is not allowed: {allowed}, {letter} = {known} as in {first}"
                )
        if name in INDICES and not jnp.issubdtype(value.dtype, jnp.integer):
            raise TypeError(f"{name}: dtype {value.dtype} is not allowed: an integer")
        if name not in WHOLE and not jnp.issubdtype(value.dtype, jnp.inexact):
            value = value * 1.0  # weak, so that a reward of 1 widens no bfloat16
        found.append(value)
    return tuple(found)


def per_step(value: ArrayLike) -> str:
    """The letters of an argument that is one number, or one for each step: "" or "T"."""
    return "" if np.isscalar(value) or getattr(value, "ndim", 1) == 0 else "T"


def whole(name: str, value: int, most: int | None = None) -> int:
    """A whole number from 1 that shapes the program. Raises ValueError for another one, and for one that is traced.

    >>> whole("n", 0)
    Traceback (most recent call last):
    ValueError: n: 0 is not allowed: a whole number from 1
    """
    allowed = "a whole number from 1" if most is None else f"a whole number from 1 to {most}"
    if isinstance(value, jax.core.Tracer):
        raise ValueError(f"{name}: a traced value is not allowed: {allowed}; under jax.jit name it in static_argnames")
    if isinstance(value, bool) or not isinstance(value, int | np.integer) or not 1 <= value <= (most or value):
        raise ValueError(f"{name}: {value!r} is not allowed: {allowed}")
    return int(value)
