"""Networks: pairs of pure functions from an observation to action values.

A ``Network`` is any pair (init, apply); learners know nothing else about it. ``mlp`` makes one from a flax module with
PyTorch's default initialisation.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import flax.linen as nn
import jax
import jax.numpy as jnp
from jax.extend.core import Primitive
from jax.interpreters import ad, batching, mlir

from jaxq.types import Array, Key, PyTree


@dataclass(frozen=True)
class Network:
    """Action values as pure functions of parameters and ONE observation; the caller vmaps.

    ``init(key, obs) -> params``, where ``obs`` is one observation of the right shape and dtype; the key is consumed.
    ``apply(params, obs) -> q`` with q [A].
    """

    init: Callable[[Key, PyTree], PyTree]
    apply: Callable[[PyTree, PyTree], Array]


def mlp(hidden: Sequence[int], num_actions: int) -> Network:
    """A multilayer perceptron with ReLU between its layers; ``hidden=()`` is a linear function.

    q = W_n relu(... relu(W_1 x + b_1) ...) + b_n, x the flattened observation. Shapes: obs any, q [A].
    """
    module = MLP(tuple(hidden), num_actions)
    return Network(init=module.init, apply=module.apply)


class MLP(nn.Module):
    """Multilayer perceptron on one flattened observation. Shapes: obs any -> [num_outputs].

    >>> params = MLP(hidden=(8,), num_outputs=2).init(jax.random.key(0), jnp.zeros((3, 3)))
    >>> jax.tree.map(jnp.shape, params)["params"]["Linear_0"]
    {'bias': (8,), 'kernel': (9, 8)}
    """

    hidden: tuple[int, ...] = (128, 128)
    num_outputs: int = 2

    @nn.compact  # type: ignore[untyped-decorator]
    def __call__(self, obs: Array) -> Array:
        x = jnp.ravel(obs)
        x = x.astype(jnp.promote_types(x.dtype, jnp.float32))
        for width in self.hidden:
            x = nn.relu(Linear(width)(x))
        return Linear(self.num_outputs)(x)


class Linear(nn.Module):
    """Affine layer that starts as PyTorch's ``torch.nn.Linear``.

    y = x W + b; W, b ~ Uniform(-1/sqrt(I), 1/sqrt(I)), I the number of inputs. Shapes: x [I] -> [O], W [I, O], b [O].
    PyTorch documentation, ``torch.nn.Linear``; LeCun et al., *Efficient BackProp*, 1998.
    """

    num_outputs: int

    @nn.compact  # type: ignore[untyped-decorator]
    def __call__(self, x: Array) -> Array:
        num_inputs = x.shape[-1]
        bound = num_inputs**-0.5

        def uniform(key: Key, shape: tuple[int, ...]) -> Array:
            return jax.random.uniform(key, shape, minval=-bound, maxval=bound)

        kernel = self.param("kernel", uniform, (num_inputs, self.num_outputs))
        bias = self.param("bias", uniform, (self.num_outputs,))
        return _product(x, kernel) + bias


# The gradient of a kernel is x^T g, a sum over the batch. XLA on CPU runs a product that contracts the leading axes of
# both operands at two thirds of the rate of a plain one, and folds a transposition of x into it. So x^T is written out
# behind a barrier. Only ``vmap`` knows the batch, hence a primitive: an ordinary bilinear product in everything but
# how it batches and what the gradient of its kernel is made of.


def _product(x: Array, kernel: Array) -> Array:
    """x W. Shapes: x [I] or, once a vmap has met it, [B, I]; kernel [I, O] -> [O] or [B, O]."""
    return _product_p.bind(x, kernel)


def _kernel_gradient(g: Array, x: Array, kernel: Array) -> Array:
    """x^T g. Shapes: g [O], x [I] or g [B, O], x [B, I] -> [I, O]."""
    if x.ndim == 1:
        return jnp.outer(x, g)
    return jax.lax.optimization_barrier(x.T) @ g


def _product_batching(operands: Sequence[Array], axes: Sequence[Any]) -> tuple[Array, int]:
    (x, kernel), (x_axis, kernel_axis) = operands, axes
    if kernel_axis is not None or x_axis is None:  # a vmap over lanes
        return jax.vmap(jnp.matmul, (x_axis, kernel_axis))(x, kernel), 0
    x = jnp.moveaxis(x, x_axis, 0)
    out = _product(x.reshape(-1, x.shape[-1]), kernel)
    return out.reshape(*x.shape[:-1], kernel.shape[-1]), 0


_product_p = Primitive("product")
_product_p.def_impl(jnp.matmul)
# An array like x but for its shape: what else its type holds (such as the devices it varies over) carries over.
_product_p.def_abstract_eval(
    lambda x, kernel: x.update(shape=(*x.shape[:-1], kernel.shape[-1]), dtype=jnp.result_type(x, kernel))
)
mlir.register_lowering(_product_p, mlir.lower_fun(jnp.matmul, multiple_results=False))
ad.defbilinear(_product_p, lambda g, x, kernel: g @ kernel.T, _kernel_gradient)
batching.primitive_batchers[_product_p] = _product_batching
