"""Our rules beside rlax's: how long a batch of each takes, in an environment that has rlax (``make parity`` makes it).

    PYTHONPATH=tests .venv-peers-rlax/bin/python -m reference.rlax_speed

A batch goes through ``jax.jit(jax.vmap(rule))`` in float32, once for the values and once for values and gradients. The
two libraries take turns, and a ratio is of their quickest turns: above 1 where ours is quicker.
"""

from __future__ import annotations

import importlib
import time
from collections.abc import Callable

import jax
import jax.numpy as jnp
import numpy as np
from reference.rlax_parity import versions
from reference.rlax_rules import PAIR, RULES, Group, draw, moving

from jaxq import rules

#: A usual batch: 1,024 trajectories of 32 steps, 51 atoms or quantiles.
BATCH, SHAPE = 1024, {"A": 4, "T": 32, "N": 51, "K": 51, "L": 51}
TURNS, CALLS = 15, 10


def programs(library: str, name: str, group: Group) -> list[Callable[[], object]]:
    """A rule on a batch, and its gradient on it: compiled, to be called."""
    module = rules if library == "jaxq.rules" else importlib.import_module(library)
    options = {word: getattr(module, PAIR) if value is PAIR else value for word, value in group.options.items()}
    words = [argument.partition(":")[0] for argument in group.rule.arguments.split()]
    named = {word: value for word, value in options.items() if word not in words}
    inputs = {word: jnp.asarray(value) for word, value in group.inputs.items()}
    some = {word: inputs.pop(word) for word in group.inputs if moving(word)}

    def batch(some: dict, others: dict) -> jax.Array:
        def one(some: dict, others: dict) -> jax.Array:
            given = options | some | others
            return getattr(module, name)(*(given[word] for word in words), **named)

        return jax.vmap(one)(some, others)

    def loss(some: dict, others: dict) -> jax.Array:
        return jnp.sum(jnp.square(batch(some, others)))

    compiled = [jax.jit(program).lower(some, inputs).compile() for program in (batch, jax.grad(loss))]
    return [lambda one=one: jax.block_until_ready(one(some, inputs)) for one in compiled]


def seconds(program: Callable[[], object]) -> float:
    """The time of a call, of a few in a row."""
    start = time.perf_counter()
    for _ in range(CALLS):
        program()
    return (time.perf_counter() - start) / CALLS


def main() -> None:
    print(f"{', '.join(versions('rlax', 'optax', 'jax', 'jaxlib', 'numpy'))}; {jax.default_backend()}.\n")
    print(f"| {'rule':38} | ours, us | rlax, us | ratio | ours, gradient | rlax, gradient | ratio |")
    print("| --- | ---: | ---: | ---: | ---: | ---: | ---: |")
    ratios = []
    for title, rule in RULES.items():
        if rule.theirs.startswith("optax"):
            continue  # a step of the whole network's weights, not of a batch
        rng = np.random.default_rng(0)
        group = Group(rule, rule.options[0], draw(rng, rule, rule.options[0], SHAPE, BATCH))
        library, _, name = rule.theirs.partition(".")
        ours, theirs = programs("jaxq.rules", title.partition(",")[0], group), programs(library, name, group)
        turns = [[[seconds(one) for one in pair] for pair in zip(ours, theirs, strict=True)] for _ in range(TURNS)]
        quickest = np.min(turns, axis=0)  # [values or gradients, ours or theirs]
        ratios.append(quickest[:, 1] / quickest[:, 0])
        cells = [f"{mine * 1e6:8.0f} | {other * 1e6:8.0f} | {other / mine:5.2f}" for mine, other in quickest.tolist()]
        print(f"| {title:38} | {' | '.join(cells)} |", flush=True)
    middle, least = np.median(ratios, axis=0), np.min(ratios, axis=0)
    print(f"\nratio of values: median {middle[0]:.2f}, least {least[0]:.2f}", end="; ")
    print(f"of gradients: median {middle[1]:.2f}, least {least[1]:.2f}")


if __name__ == "__main__":
    main()
