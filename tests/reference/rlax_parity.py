"""Our rules beside rlax's, on random draws: the values and the gradients, in float64 and in float32.

``make parity`` runs it in an environment that has rlax, and fails where a rule is off. With ``--write`` it remakes
``rlax.npz``, a few draws and what rlax makes of them in float64; with ``--kept`` it compares with that file and needs
no rlax, as ``tests/test_parity.py`` does:

    PYTHONPATH=tests .venv-peers-rlax/bin/python -m reference.rlax_parity --write

The inputs are float32's numbers, and the truth for both precisions is what rlax makes of them in float64. An error is
relative to the larger of 1 and the true number. Where numbers above 10 go in, an error in float32 is relative to the
largest of them as well, as the difference of two numbers of size 1000 has no more digits. Gradients are those of a
weighted sum of what a rule returns, with respect to every value or logit that goes in: those through a target that is a
constant must be 0.
"""

from __future__ import annotations

import argparse
import importlib
import importlib.util
import itertools
import platform
import sys
from collections.abc import Callable, Iterator
from importlib import metadata
from pathlib import Path
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from reference.rlax_rules import PAIR, RULES, Group, groups, moving

from jaxq import rules

KEPT = Path(__file__).with_name("rlax.npz")
DRAWS = 80  # of each shape
KEPT_DRAWS, KEPT_SHAPES = 2, 3  # one with ties, and n-step returns beyond the trajectory's end
TOLERANCE_64, TOLERANCE_32 = 1e-6, 1e-5
ORDINARY = 10  # up to this size of what goes in, float32 is held to the value's own size

#: What differs on purpose: what, in rlax 0.1.9, here, why.
DIFFERENCES = (
    (
        "signed_parabolic, and what is built on it, in float32",
        "the paper's formula: h^-1(0.001) is 0.001954, h^-1(30) is 904.72565",
        "the same function without a difference of near numbers: 0.001997002, 904.72552 (truth: 904.72554)",
        "three of float32's seven digits; and eps may be 0, by which rlax divides",
    ),
    (
        "slope of signed_hyperbolic and signed_parabolic at exactly 0",
        "eps and 0, from the derivative of sign",
        "1/2 + eps and 1 / (1/2 + eps)",
        "the true slopes, so that a value of 0 learns",
    ),
    (
        "an action outside 0 .. A - 1",
        "clamped, -1 is the last one; NaN in rules of trajectories",
        "its value is 0",
        "padding may use any index, and none reads another action's value",
    ),
    (
        "an infinite value of weight 0: a masked action that is never taken, or all of them behind a termination",
        "NaN",
        "nothing",
        "a masked action need not be given a number first",
    ),
    (
        "stop_target_gradients",
        "a flag, by default False for returns; in quantile_regression_loss it stops nothing of the target",
        "no flag: rules with an error stop the gradient; returns and quantile_regression_loss do not",
        "the same by default; a residual gradient is one line of the caller's, from td_target",
    ),
    (
        "cut_t",
        "absent: a trajectory must not go on behind a truncated episode",
        "an argument of every return",
        "with auto-reset it does go on",
    ),
    ("huber_param", "a Python number", "may be traced", "settings that differ in it share a program"),
    (
        "atoms that are equal",
        "allowed, but the projection on 0, 1, 1 of 0.5 is 0.5, 0.5, 1",
        "not allowed: atoms increase strictly",
        "such a result is no distribution",
    ),
    (
        "shapes and dtypes",
        "AssertionError; integer rewards are refused, rows q_tm1 and q_t of different lengths are not",
        "ValueError and TypeError in one line; integer rewards pass",
        "a mistake is told where it is made",
    ),
    ("c_t of off_policy_returns", "[T]", "[] or [T], as lambda_ elsewhere", "one number is the usual case"),
    (
        "dtype of n-step returns under jax_enable_x64",
        "float64 for float32; without the flag float32 for bfloat16",
        "that of the arguments",
        "a rule does not choose the precision",
    ),
)


def through(library: Any, name: str, group: Group, dtype: type) -> list[np.ndarray]:
    """What a library's rule returns for each draw, and the gradients; all [draws, ...]."""
    options = {word: getattr(library, PAIR) if value is PAIR else value for word, value in group.options.items()}
    words = [argument.partition(":")[0] for argument in group.rule.arguments.split()]
    named = {word: value for word, value in options.items() if word not in words}
    learnt = [word for word in group.inputs if moving(word)]

    def weighted(some: dict, others: dict) -> tuple[jax.Array, jax.Array]:
        given = options | some | others
        value = getattr(library, name)(*(given[word] for word in words), **named)
        return jnp.sum(value * jnp.cos(jnp.arange(value.size)).reshape(value.shape)), value

    with jax.enable_x64(dtype is np.float64):
        inputs = {
            word: jnp.asarray(value, None if value.dtype == np.int32 else dtype) for word, value in group.inputs.items()
        }
        some = {word: inputs.pop(word) for word in learnt}
        gradients, value = jax.jit(jax.vmap(jax.grad(weighted, has_aux=True)))(some, inputs)
        return [np.asarray(array) for array in (value, *(gradients[word] for word in learnt))]


def of_ours(title: str, group: Group, dtype: type) -> list[np.ndarray]:
    return through(rules, title.partition(",")[0], group, dtype)


def of_theirs(group: Group, dtype: type) -> list[np.ndarray]:
    library, _, name = group.rule.theirs.partition(".")
    return through(importlib.import_module(library), name, group, dtype)


def error(found: list[np.ndarray], truth: list[np.ndarray], group: Group) -> float:
    """The largest error of the value and the gradients; what is no number comes out as no number."""
    largest = 0.0
    for index, (ours, true) in enumerate(zip(found, truth, strict=True)):
        scale = np.maximum(1, np.abs(true))
        if ours.dtype == np.float32:
            around = [true] if index else [group.inputs[word] for word in group.inputs if moving(word)]
            sizes = np.max([np.abs(array.reshape(len(true), -1)).max(axis=1) for array in around], axis=0)
            sizes = np.where(sizes > ORDINARY, sizes, 1)
            scale = np.maximum(scale, sizes.reshape(-1, *(1 for _ in true.shape[1:])))
        largest = np.maximum(largest, np.max(np.abs(ours - true) / scale))
    return float(largest)


class Row(NamedTuple):
    """The largest errors of one rule over all draws."""

    title: str
    draws: int
    error_64: float
    error_32: float
    rlax_32: float | None = None

    @property
    def right(self) -> bool:
        return self.error_64 <= TOLERANCE_64 and self.error_32 <= TOLERANCE_32

    def line(self) -> str:
        errors = (f"{self.error_64:.1e}", f"{self.error_32:.1e}", "" if self.rlax_32 is None else f"{self.rlax_32:.1e}")
        cells = (f"{self.draws:5}", *(f"{one:>12}" for one in errors), "same" if self.right else "OFF ")
        return f"| {self.title:38} | {' | '.join(cells)} |"


HEADING = f"| {'rule':38} | draws | {'float64':>12} | {'float32':>12} | rlax float32 |      |"


def beside_rlax(title: str) -> Row:
    """A rule beside rlax's own."""
    errors, drawn = [], 0
    for group in groups(title, DRAWS):
        truth = of_theirs(group, np.float64)
        found = of_ours(title, group, np.float64), of_ours(title, group, np.float32), of_theirs(group, np.float32)
        errors.append([error(one, truth, group) for one in found])
        drawn += len(truth[0])
    return Row(title, drawn, *np.max(errors, axis=0).tolist())


def few(title: str) -> Iterator[Group]:
    """The draws of a rule that are kept."""
    return itertools.islice(groups(title, KEPT_DRAWS), KEPT_SHAPES)


def beside_kept(title: str) -> Row:
    """A rule beside what is kept of rlax's."""
    errors, drawn = [], 0
    with np.load(KEPT) as kept:
        for index, group in enumerate(few(title)):
            inputs = unpacked(kept[f"{title}/{index}/inputs"], list(group.inputs.values()))
            group = group._replace(inputs=dict(zip(group.inputs, inputs, strict=True)))
            found = of_ours(title, group, np.float64), of_ours(title, group, np.float32)
            truth = unpacked(kept[f"{title}/{index}/truth"], found[0])
            errors.append([error(one, truth, group) for one in found])
            drawn += len(truth[0])
    return Row(title, drawn, *np.max(errors, axis=0).tolist())


def write() -> None:
    """Keeps a few draws of every rule, what rlax makes of them, and the versions."""
    arrays = {"versions": np.array(versions("rlax", "optax", "jax", "jaxlib", "numpy"))}
    for title in RULES:
        for index, group in enumerate(few(title)):
            arrays[f"{title}/{index}/inputs"] = packed(list(group.inputs.values())).astype(np.float32)
            arrays[f"{title}/{index}/truth"] = packed(of_theirs(group, np.float64))
    np.savez_compressed(KEPT, **arrays)
    print(f"{KEPT.name}: {KEPT.stat().st_size / 1000:.0f} kB")


def packed(arrays: list[np.ndarray]) -> np.ndarray:
    """Arrays [draws, ...] as one [draws, numbers]."""
    return np.concatenate([array.reshape(len(array), -1) for array in arrays], axis=1)


def unpacked(numbers: np.ndarray, like: list[np.ndarray]) -> list[np.ndarray]:
    """What ``packed`` made one, in the shapes of others; whole numbers where they are."""
    ends = np.cumsum([array[0].size for array in like])
    parts = np.split(numbers, ends[:-1], axis=1)
    dtypes = [array.dtype if array.dtype == np.int32 else numbers.dtype for array in like]
    return [part.reshape(one.shape).astype(dtype) for part, one, dtype in zip(parts, like, dtypes, strict=True)]


def versions(*names: str) -> list[str]:
    return [f"python {platform.python_version()}", *(f"{name} {metadata.version(name)}" for name in names)]


def main(words: list[str] | None = None) -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    mode = parser.add_mutually_exclusive_group()
    mode.add_argument("--write", action="store_true", help="remake rlax.npz")
    mode.add_argument("--kept", action="store_true", help="compare with rlax.npz")
    args = parser.parse_args(words)
    missing = [name for name in ("rlax", "optax") if not args.kept and importlib.util.find_spec(name) is None]
    if missing:
        parser.error(f"{missing[0]} is not in this environment, which make parity makes")
    if args.write:
        write()
        return 0
    compare: Callable[[str], Row] = beside_kept if args.kept else beside_rlax
    if args.kept:
        with np.load(KEPT) as kept:
            print(f"Kept of {', '.join(kept['versions'])}.\n")
    else:
        print(f"{', '.join(versions('rlax', 'optax', 'jax', 'jaxlib', 'numpy'))}.\n")
    print(HEADING)
    print("| --- | ---: | ---: | ---: | ---: | --- |")
    off = []
    for title in RULES:
        row = compare(title)
        print(row.line(), flush=True)
        off += [] if row.right else [title]
    print("\nDifferent on purpose:\n")
    for what, there, here, why in DIFFERENCES:
        print(f"- {what}. rlax: {there}. Here: {here}. Why: {why}.")
    print(f"\n{len(RULES)} rules, {len(off)} off{': ' if off else ''}{'; '.join(off)}")
    return 1 if off else 0


if __name__ == "__main__":
    sys.exit(main())
