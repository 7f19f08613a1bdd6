"""The precision that an environment computes in."""

from __future__ import annotations

import jax
import jax.numpy as jnp
from jax.typing import DTypeLike


def float_dtype(name: str, dtype: DTypeLike) -> jnp.dtype:
    """float32 or float64; raises ValueError for another dtype, and for float64 without ``jax_enable_x64``."""
    dtype = jnp.dtype(dtype)
    if dtype not in (jnp.float32, jnp.float64):
        raise ValueError(f"{name}: {dtype} is not one of float32, float64")
    if dtype == jnp.float64 and not jax.config.read("jax_enable_x64"):
        raise ValueError(f'{name}: float64 needs jax.config.update("jax_enable_x64", True) first')
    return dtype
