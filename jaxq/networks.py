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

    hidden: tuple[int, ...]
    num_outputs: int

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
        if self.num_outputs < num_inputs:
            # Over a batch the kernel's gradient is h^T g, slow in XLA where g is narrow. The barrier keeps it g^T h
            # and turns the small result instead. It changes no value.
            return jax.lax.optimization_barrier(kernel.T) @ x + bias
        return x @ kernel + bias
