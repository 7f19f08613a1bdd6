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
    in [0, 1]; where ``online`` is finite, 0 leaves the target as it is, bit for bit. Raises ValueError where the trees
    differ. Polyak and Juditsky, 1992; Lillicrap et al., *Continuous Control with Deep Reinforcement Learning*, 2016.

    >>> polyak_update({"w": jnp.array(4.0)}, {"w": jnp.array(0.0)}, 0.25)["w"].tolist()
    1.0
    """
    (tau,) = arrays(tau=(tau, ""))
    return _leaf_by_leaf(lambda new, old: tau * new + (1.0 - tau) * old, online, target)


def periodic_step(updates: ArrayLike, period: ArrayLike, tau: ArrayLike = 1.0) -> Array:
    """The step of a target that moves every so many updates: tau then, otherwise 0.

    step = tau 1(updates mod period = 0). Shapes: all [] -> []. ``updates`` are those done before, so the first moves
    the target. A number, not a branch: under ``vmap`` a branch would run both ways. Raises ValueError for other shapes.
    Mnih et al., 2015.

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

    def one(path: Any, new: Array, old: Array) -> Array:
        if jnp.shape(new) != jnp.shape(old):
            where = f"target{jax.tree_util.keystr(path)}"
            raise ValueError(f"{where}: shape {jnp.shape(old)} is not allowed: {jnp.shape(new)} as in online")
        return step(new, old).astype(jnp.result_type(old))

    return jax.tree_util.tree_map_with_path(one, online, target)
