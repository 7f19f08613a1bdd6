"""How a target network follows the online one: any trees of arrays, as flax, haiku or equinox make them."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp

from jaxq.rules.shapes import arrays
from jaxq.types import Array, ArrayLike, PyTree


def polyak_update(online: PyTree, target: PyTree, tau: ArrayLike) -> PyTree:
    """A step of the target towards the online parameters.

    target <- tau online + (1 - tau) target, leaf by leaf, in the target's dtypes. Shapes: trees alike, tau []. tau is
    in [0, 1]: 0 leaves the target as it is and 1 copies, be the other one infinite or no number. Leaves with nothing
    in between (counters, keys) are copied where tau is not 0. Raises ValueError where the trees differ. Polyak and
    Juditsky, 1992; Lillicrap et al., *Continuous Control with Deep Reinforcement Learning*, 2016.

    >>> polyak_update({"w": jnp.array(4.0)}, {"w": jnp.array(0.0)}, 0.25)["w"].tolist()
    1.0
    """
    (tau,) = arrays(tau=(tau, ""))

    def share(weight: Array, value: Array) -> Array:
        return weight * jnp.where((weight == 0) & ~jnp.isfinite(value), 0, value)

    def step(new: Array, old: Array) -> Array:
        if not jnp.issubdtype(old.dtype, jnp.inexact):
            return jnp.where(tau == 0, old, new)
        return share(tau, new) + share(1.0 - tau, old)

    return _leaf_by_leaf(step, online, target)


def periodic_step(updates: ArrayLike, period: ArrayLike, tau: ArrayLike = 1.0) -> Array:
    """The step of a target that moves every so many updates: tau then, otherwise 0.

    step = tau 1(updates mod period = 0). Shapes: all [] -> []. ``updates`` are those done before, so the first moves
    the target. A number, not a branch: under ``vmap`` a branch would run both ways. ``period`` is at least 1. Raises
    ValueError for other shapes. Mnih et al., 2015.

    >>> [float(periodic_step(updates, 3)) for updates in range(5)]
    [1.0, 0.0, 0.0, 1.0, 0.0]
    """
    updates, period, tau = arrays(updates=(updates, ""), period=(period, ""), tau=(tau, ""))
    return jnp.where(updates % period == 0, tau, 0.0)


def periodic_update(online: PyTree, target: PyTree, updates: ArrayLike, period: ArrayLike) -> PyTree:
    """The online parameters every ``period`` updates, else the target as it is.

    target <- online where updates mod period = 0. Shapes: trees alike, updates and period []. Raises ValueError where
    the trees differ. Mnih et al., *Human-level control through deep reinforcement learning*, 2015.

    >>> [float(periodic_update(jnp.array(4.0), jnp.array(0.0), updates, 2)) for updates in range(3)]
    [4.0, 0.0, 4.0]
    """
    updates, period = arrays(updates=(updates, ""), period=(period, ""))
    now = updates % period == 0
    return _leaf_by_leaf(lambda new, old: jnp.where(now, new, old), online, target)


def _leaf_by_leaf(step: Callable[[Array, Array], Array], online: PyTree, target: PyTree) -> PyTree:
    """A function of both trees' leaves, in the target's dtypes."""
    given: Any = jax.tree.structure(target)
    allowed: Any = jax.tree.structure(online)
    if given != allowed:
        raise ValueError(f"target: {given} is not allowed: {allowed} as online")

    def one(path: Any, new: ArrayLike, old: ArrayLike) -> Array:
        new, old = jnp.asarray(new), jnp.asarray(old)
        if new.shape != old.shape:
            where = f"target{jax.tree_util.keystr(path)}"
            raise ValueError(f"{where}: shape {old.shape} is not allowed: {new.shape} as in online")
        made = step(new, old)
        return made if made.dtype == old.dtype else made.astype(old.dtype)  # a key has no astype

    return jax.tree_util.tree_map_with_path(one, online, target)
