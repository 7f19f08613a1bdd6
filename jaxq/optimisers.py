"""Optimisers as optax transformations whose numbers may all be traced."""

from __future__ import annotations

from typing import NamedTuple

import jax
import jax.numpy as jnp
import optax

from jaxq.types import Array, PyTree


class AdamWState(NamedTuple):
    """Moving averages of the gradient; ``largest`` is empty without AMSGrad.

    ``mean_weight`` and ``square_weight`` are the sums of the weights in ``mean`` and ``square``, 1 - b^t after t
    updates. They follow the same recursion as the averages, so that the ratio is a weighted mean whatever the rounding
    of b, where 1 - b**t in float32 would be off by 1e-5 at first.
    """

    mean: PyTree
    square: PyTree
    largest: PyTree
    mean_weight: Array
    square_weight: Array


def adamw(
    learning_rate: Array | float,
    weight_decay: Array | float,
    *,
    b1: Array | float = 0.9,
    b2: Array | float = 0.999,
    eps: Array | float = 1e-8,
    amsgrad: bool = True,
) -> optax.GradientTransformation:
    """Adam with decoupled weight decay, by default with AMSGrad, in PyTorch's order of operations.

    p <- p (1 - lr wd);  m <- b1 m + (1 - b1) g;  v <- b2 v + (1 - b2) g^2;  x <- max(x, v);
    p <- p - lr / (1 - b1^t) m / (sqrt(x) / sqrt(1 - b2^t) + eps).
    The maximum is taken over v before its correction, where optax's ``amsgrad`` takes it after. The whole step is
    proportional to the learning rate: with 0 the parameters stay as they are, bit for bit.

    Shapes: those of the parameters; every number []. Raises ValueError when ``update`` is called without ``params``.
    Loshchilov and Hutter, *Decoupled Weight Decay Regularization*, 2019; Reddi, Kale and Kumar, *On the Convergence of
    Adam and Beyond*, 2018; PyTorch documentation, ``torch.optim.AdamW``.
    """

    def init(params: PyTree) -> AdamWState:
        def zeros() -> PyTree:
            return jax.tree.map(jnp.zeros_like, params)

        weight = jnp.zeros((), jnp.result_type(jnp.float32, *jax.tree.leaves(params)))
        return AdamWState(zeros(), zeros(), zeros() if amsgrad else (), weight, weight)

    def update(grads: PyTree, state: AdamWState, params: PyTree | None = None) -> tuple[PyTree, AdamWState]:
        if params is None:
            raise ValueError("adamw decays weights: call update(grads, state, params), not update(grads, state)")
        mean = jax.tree.map(lambda g, m: b1 * m + (1 - b1) * g, grads, state.mean)
        square = jax.tree.map(lambda g, v: b2 * v + (1 - b2) * g * g, grads, state.square)
        largest = jax.tree.map(jnp.maximum, state.largest, square) if amsgrad else ()
        mean_weight = b1 * state.mean_weight + (1 - b1)
        square_weight = b2 * state.square_weight + (1 - b2)

        # Scalars first: one product per parameter instead of a division.
        decay, step, scale = learning_rate * weight_decay, learning_rate / mean_weight, 1 / jnp.sqrt(square_weight)
        updates = jax.tree.map(
            lambda p, m, x: -decay * p - step * m / (jnp.sqrt(x) * scale + eps),
            params,
            mean,
            largest if amsgrad else square,
        )
        return updates, AdamWState(mean, square, largest, mean_weight, square_weight)

    return optax.GradientTransformation(init, update)
