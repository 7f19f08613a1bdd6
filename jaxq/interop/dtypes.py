"""States of others, made such that a loop can carry them."""

from __future__ import annotations

from typing import Any

import jax
import jax.numpy as jnp


def as_arrays(tree: Any) -> Any:
    """The tree with arrays where plain numbers stand."""
    return jax.tree.map(jnp.asarray, tree)


def like(new: Any, old: Any) -> Any:
    """``new`` with the dtypes of ``old``, a tree of arrays of the same structure: a step may return plain numbers."""
    return jax.tree.map(lambda one, other: jnp.asarray(one, other.dtype), new, old)
