"""From a program to its executables: traced and compiled once for all settings, seeds and roots of a structure."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import jax
import jax.numpy as jnp

from jaxq import prng
from jaxq.compile_cache import CompileCache
from jaxq.experiment import Log
from jaxq.programs import Program
from jaxq.types import Hypers, PyTree


@dataclass
class Executables:
    """The executables of one structure, each over a whole group, the seconds that it took to make them, and whether
    all of them came from a cache.

    ``start(root, state, fresh, seeds, hypers)`` puts new lanes into the fresh slots; ``advance(state, hypers)`` runs a
    segment; ``evaluate(root, seeds, policies, hypers)`` plays greedy episodes; ``policy(state, hypers)`` takes the
    policies out. The first two consume the state. Logs have the lanes on axis 1, as the loop writes them.
    """

    program: Program
    start: Callable[..., Any]
    advance: Callable[..., Any]
    evaluate: Callable[..., Any]
    policy: Callable[..., Any]
    empty: PyTree  # the shapes of a group's state
    seconds: float
    cached: bool


def build(program: Program, example: Hypers, impl: str, cache: CompileCache | None = None) -> Executables:
    """Traces and compiles a structure, once for all settings, seeds and roots. ``example``: any setting's hypers.

    With a ``cache``, what it holds is not compiled again.
    """
    began = time.perf_counter()
    made, width = program.experiment, program.width

    def lane_key(root: jax.Array, seed: jax.Array) -> jax.Array:
        return jax.random.fold_in(prng.wrap(root, impl), seed)

    def start(root: jax.Array, state: PyTree, fresh: jax.Array, seed: jax.Array, hypers: Hypers) -> Any:
        new, log = made.init(lane_key(root, seed), hypers)
        return jax.tree.map(lambda a, b: jnp.where(fresh, a, b), new, state), log

    def evaluate(root: jax.Array, seed: jax.Array, policy: PyTree, hypers: Hypers) -> jax.Array:
        return made.evaluate(lane_key(root, seed), policy, hypers)

    def shapes(tree: PyTree) -> PyTree:
        return jax.tree.map(lambda leaf: jax.ShapeDtypeStruct((width, *leaf.shape), leaf.dtype), tree)

    root = jax.eval_shape(lambda: jax.random.key_data(prng.key(0, impl)))
    seed = jax.ShapeDtypeStruct((), jnp.uint32)
    one = jax.eval_shape(lambda r, s, h: made.init(lane_key(r, s), h)[0], root, seed, example)
    state, hypers, seeds = shapes(one), shapes(example), shapes(seed)
    policy = shapes(jax.eval_shape(made.policy, one, example))
    fresh = jax.ShapeDtypeStruct((width,), bool)
    log_axes: Any = Log(*(1, 1, 1, 1, 0))  # type: ignore[arg-type]

    jobs: dict[str, tuple[Any, Any, tuple[int, ...]]] = {
        "start": (jax.vmap(start, (None, 0, 0, 0, 0), (0, log_axes)), (root, state, fresh, seeds, hypers), (1,)),
        "advance": (jax.vmap(made.advance, out_axes=(0, log_axes)), (state, hypers), (0,)),
        "evaluate": (jax.vmap(evaluate, (None, 0, 0, 0)), (root, seeds, policy, hypers), ()),
        "policy": (jax.vmap(made.policy), (state, hypers), ()),
    }
    built, found = {}, []
    for name, (fn, args, donated) in jobs.items():
        # keep_unused: a program that drops arguments cannot be cached.
        traced = jax.jit(fn, donate_argnums=donated, keep_unused=True).trace(*args)
        built[name], hit = cache.compile(traced) if cache else (traced.lower().compile(), False)
        found.append(hit)
    seconds = time.perf_counter() - began
    return Executables(program=program, empty=state, seconds=seconds, cached=all(found), **built)
