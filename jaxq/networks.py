"""Networks: pairs of pure functions from an observation to action values.

A ``Network`` is any pair (init, apply); learners know nothing else about it. ``mlp`` makes one from a flax module with
PyTorch's default initialisation.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import flax.linen as nn
import jax
import jax.numpy as jnp

from jaxq.types import Array, Key, PyTree


@dataclass(frozen=True)
class Network:
    """Action values as pure functions of parameters and ONE observation; the caller vmaps.

    ``init(key, obs) -> params``, where ``obs`` is one observation of the right shape and dtype; the key is consumed.
    ``apply(params, obs) -> q`` with q [A].
    """

    init: Callable[[Key, PyTree], PyTree]
    apply: Callable[[PyTree, PyTree], Array]


def mlp(hidden: Sequence[int], num_actions: int, *, num_states: int | None = None) -> Network:
    """A multilayer perceptron with ReLU between its layers; ``hidden=()`` is a linear function.

    q = W_n relu(... relu(W_1 x + b_1) ...) + b_n, x the flattened observation; with ``num_states`` an observation is
    one of the integers 0 .. num_states - 1, and x[k] = 1(k = obs). Shapes: obs any, q [A].
    """
    module = MLP(tuple(hidden), num_actions)
    if num_states is None:
        return Network(init=module.init, apply=module.apply)

    def one_hot(obs: PyTree) -> Array:  # here, not in the environment: a replay of integers is that much smaller
        return (jnp.arange(num_states) == obs).astype(jnp.float32)

    return Network(
        init=lambda key, obs: module.init(key, one_hot(obs)),
        apply=lambda params, obs: module.apply(params, one_hot(obs)),
    )


#: So few inputs or outputs are written out, term by term, instead of left to a product.
FEW = 8


class MLP(nn.Module):
    """Multilayer perceptron on one flattened observation. Shapes: obs any -> [num_outputs].

    >>> params = MLP(hidden=(8,), num_outputs=2).init(jax.random.key(0), jnp.zeros((3, 3)))
    >>> jax.tree.map(jnp.shape, params)["params"]["Linear_0"]
    {'bias': (8,), 'kernel': (9, 8)}
    """

    hidden: tuple[int, ...]
    num_outputs: int

    @nn.compact  # type: ignore[untyped-decorator]
    def __call__(self, obs: Array) -> Array:
        x = jnp.ravel(obs)
        x = x.astype(jnp.promote_types(x.dtype, jnp.float32))
        turned = None
        for width in self.hidden:
            y, turned = Linear(width)(x, turned)
            x, turned = nn.relu(y), None if turned is None else nn.relu(turned)
        return Linear(self.num_outputs)(x, turned)[0]


class Linear(nn.Module):
    """Affine layer that starts as PyTorch's ``torch.nn.Linear``.

    y = x W + b; W, b ~ Uniform(-1/sqrt(I), 1/sqrt(I)), I the number of inputs. Shapes: x [I] -> [O], W [I, O], b [O].
    PyTorch documentation, ``torch.nn.Linear``; LeCun et al., *Efficient BackProp*, 1998.

    Two more values are for speed alone (see ``wide``): ``turned`` is [x, 1], or None, and beside y comes [y, 1], or
    None where it is not cheap.
    """

    num_outputs: int

    @nn.compact  # type: ignore[untyped-decorator]
    def __call__(self, x: Array, turned: Array | None = None) -> tuple[Array, Array | None]:
        num_inputs = x.shape[-1]
        bound = num_inputs**-0.5

        def uniform(key: Key, shape: tuple[int, ...]) -> Array:
            return jax.random.uniform(key, shape, jnp.float32, minval=-bound, maxval=bound)

        kernel = self.param("kernel", uniform, (num_inputs, self.num_outputs))
        bias = self.param("bias", uniform, (self.num_outputs,))
        # This order: XLA 0.10 aborts the process on some networks with two ``narrow`` layers in a row.
        if num_inputs <= FEW:
            rows = jnp.pad(jnp.column_stack([kernel.T, bias]), ((0, 1), (0, 0))).at[-1, -1].set(1)
            return spread(x, kernel, bias), jax.lax.optimization_barrier(rows) @ with_one(x)
        if self.num_outputs <= FEW:
            return narrow(x, jax.lax.optimization_barrier(kernel.T), bias), None
        return x @ kernel + bias if turned is None else wide(x, turned, kernel, bias), None


# One function in three forms, y = x W + b, each with a derivative of its own. Over a batch the gradient of W is x^T g,
# and XLA on a CPU is slow where the left matrix of a product lies the other way round: it turns it first, or hands the
# product to Eigen, which cuts it into tasks for a pool that all workers share. A vmapped ``matrix @ vector`` is [O, B],
# not [B, O], so what is needed turned is computed that way, where that is cheap. Barriers keep XLA from seeing through.
# docs/performance.md has the figures.


@jax.custom_jvp
def wide(x: Array, turned: Array, kernel: Array, bias: Array) -> Array:
    """y = x W + b, whose gradient of W and b is one product, [x, 1]^T g.

    ``turned`` holds the values [x, 1]; its own derivative is left out, since x has it. Shapes: x [I], turned [I + 1],
    kernel [I, O], bias [O] -> [O].
    """
    return x @ kernel + bias


@wide.defjvp
def _(primals: tuple[Array, ...], tangents: tuple[Array, ...]) -> tuple[Array, Array]:
    x, turned, kernel, bias = primals
    dx, _, dkernel, dbias = tangents
    return wide(x, turned, kernel, bias), dx @ kernel + turned @ jnp.concatenate([dkernel, dbias[None]])


@jax.custom_jvp
def spread(x: Array, kernel: Array, bias: Array) -> Array:
    """y = x W + b for few inputs, a sum of terms that XLA fuses with what reads y.

    Shapes: x [I], kernel [I, O], bias [O] -> [O].
    """
    return sum((x[i] * row for i, row in enumerate(kernel)), bias)


@spread.defjvp
def _(primals: tuple[Array, ...], tangents: tuple[Array, ...]) -> tuple[Array, Array]:
    x, kernel, bias = primals
    dx, dkernel, dbias = tangents
    return spread(x, kernel, bias), dx @ kernel + with_one(x) @ jnp.concatenate([dkernel, dbias[None]])


@jax.custom_jvp
def narrow(x: Array, rows: Array, bias: Array) -> Array:
    """y = x W + b for few outputs, whose gradient of x is a sum of terms that XLA fuses with what reads it.

    ``rows`` is W^T. Shapes: x [I], rows [O, I], bias [O] -> [O].
    """
    return rows @ x + bias


@narrow.defjvp
def _(primals: tuple[Array, ...], tangents: tuple[Array, ...]) -> tuple[Array, Array]:
    x, rows, bias = primals
    dx, drows, dbias = tangents
    along = jnp.stack([jnp.sum(row * dx) for row in rows])
    return narrow(x, rows, bias), along + drows @ x + dbias


def with_one(x: Array) -> Array:
    """[x, 1]. Shapes: x [I] -> [I + 1]."""
    return jnp.concatenate([x, jnp.ones(1, x.dtype)])
