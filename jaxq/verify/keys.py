"""Key streams: threefry's beside JAX's own, pcg4d's beside the published hash in plain Python."""

from __future__ import annotations

import functools
import math
from collections.abc import Callable, Iterator
from importlib import metadata
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from jaxq import prng
from jaxq.verify.checks import Found, Job

SEED, MASK, HIGH = 7, 2**32 - 1, 2**31 + 5
Drawn = dict[str, Any]
Draw = Callable[[jax.Array, str], jax.Array]


def _bits(shape: tuple[int, ...], dtype: Any) -> Draw:
    return lambda key, impl: jax.random.bits(key, shape, dtype)


#: What is one hash or two, and nothing else. Few words are made in another way than many.
WORDS: dict[str, Draw] = {
    "key_data": lambda key, impl: jax.random.key_data(key),
    "split 2": lambda key, impl: jax.random.key_data(jax.random.split(key)),
    "split": lambda key, impl: jax.random.key_data(jax.random.split(key, 9)),
    "fold_in": lambda key, impl: jax.random.key_data(jax.random.fold_in(key, 123)),
    "fold_in high": lambda key, impl: jax.random.key_data(jax.random.fold_in(key, np.uint32(HIGH))),
    "wrap": lambda key, impl: jax.random.bits(_wrapped(jax.random.key_data(key), impl), (2,)),
    "bits of 8": _bits((4, 3), jnp.uint8),
    "bits of 16": _bits((4, 3), jnp.uint16),
    "bits of 32": _bits((4, 3), jnp.uint32),
    "bits of shape ()": _bits((), jnp.uint32),
    "bits of shape (3,)": _bits((3,), jnp.uint32),
}
#: Where x64 is on.
WIDE: dict[str, Draw] = {"bits of 64": _bits((2, 3), jnp.uint64)}
#: What else is drawn from a key.
DRAWS: dict[str, Draw] = {
    "uniform": lambda key, impl: jax.random.uniform(key, (5,)),
    "normal": lambda key, impl: jax.random.normal(key, (5,)),
    "randint": lambda key, impl: jax.random.randint(key, (5,), -3, 1000),
    "bernoulli": lambda key, impl: jax.random.bernoulli(key, 0.3, (5,)),
    "permutation": lambda key, impl: jax.random.permutation(key, 9),
    "categorical": lambda key, impl: jax.random.categorical(key, jnp.log(jnp.arange(1.0, 5.0)), shape=(5,)),
    "truncated_normal": lambda key, impl: jax.random.truncated_normal(key, -1.0, 2.0, (5,)),
}
#: JAX's own family, which prng has under another name.
JAXS = "threefry2x32"


def jobs(cases: int) -> Iterator[Job]:
    """A check for each thing that is drawn, from ``cases`` keys."""
    said = f"jax {metadata.version('jax')}"
    few, seeds = _seeds(min(cases, 200)), _seeds(cases)
    # All that is drawn of a family is one program, for the first of its checks to compile.
    narrow = {impl: functools.cache(functools.partial(_all, impl, seeds)) for impl in ("threefry", JAXS)}
    wide = {impl: functools.cache(functools.partial(_all_wide, impl, seeds)) for impl in ("threefry", JAXS)}
    for name in (*WORDS, *WIDE, *DRAWS):
        found = wide if name in WIDE else narrow
        yield Job(
            "keys",
            f"threefry: {name}",
            said,
            lambda name=name, found=found: _different(found["threefry"]()[name], found[JAXS]()[name], seeds),  # type: ignore[misc]
            cost=6 if name == "key_data" else 0.02,
        )
    narrow["pcg4d"] = functools.cache(functools.partial(_all, "pcg4d", few, published=True))
    wide["pcg4d"] = functools.cache(functools.partial(_all_wide, "pcg4d", few))
    for name in (*WORDS, *WIDE):
        found = wide if name in WIDE else narrow
        yield Job(
            "keys",
            f"pcg4d: {name}",
            "Jarzynski and Olano, 2020",
            lambda name=name, found=found: _as_published(name, found["pcg4d"]()[name], few),  # type: ignore[misc]
            cost=0.05,
        )
    yield Job("keys", "pcg4d: one by one and together", "jaxq, without jit", lambda: _together(min(cases, 5)), 1)


def _key(seed: Any, impl: str) -> jax.Array:
    return jax.random.key(seed, impl=impl) if impl == JAXS else prng.key(seed, impl)


def _wrapped(data: jax.Array, impl: str) -> jax.Array:
    return jax.random.wrap_key_data(data, impl=impl) if impl == JAXS else prng.wrap(data, impl)


def _all(impl: str, seeds: np.ndarray, published: bool = False) -> Drawn:
    """All that is drawn in 32 bits or fewer, by name; ``published``: the words alone."""
    draws = WORDS if published else {**WORDS, **DRAWS}
    drawn: Drawn = jax.jit(jax.vmap(lambda seed: _drawn_of(draws, seed, impl)))(seeds)
    return drawn


def _all_wide(impl: str, seeds: np.ndarray) -> Drawn:
    with jax.enable_x64(True):
        drawn: Drawn = jax.jit(jax.vmap(lambda seed: _drawn_of(WIDE, seed, impl)))(seeds)
        return {name: np.asarray(leaf) for name, leaf in drawn.items()}


def _drawn_of(draws: dict[str, Draw], seed: Any, impl: str) -> Drawn:
    return {name: draw(_key(seed, impl), impl) for name, draw in draws.items()}


def _seeds(cases: int) -> np.ndarray:
    return np.random.default_rng(SEED).integers(-(2**31), 2**31, cases).astype(np.int32)


def _different(ours: Any, theirs: Any, seeds: np.ndarray) -> Found:
    """Counts numbers of which a bit differs."""
    ours, theirs = np.asarray(ours), np.asarray(theirs)
    if ours.shape != theirs.shape or ours.dtype != theirs.dtype:
        return Found(len(seeds), np.inf, 0, f"ours {ours.dtype}{ours.shape}, theirs {theirs.dtype}{theirs.shape}")
    words = np.dtype(f"u{ours.dtype.itemsize}")
    off = (ours.view(words) != theirs.view(words)).reshape(len(seeds), -1).any(1)
    if not off.any():
        return Found(len(seeds), 0, 0)
    i = int(np.flatnonzero(off)[0])
    told = f"seed {seeds[i]}: ours {ours[i].tolist()}, theirs {theirs[i].tolist()}"
    return Found(len(seeds), int(off.sum()), 0, told)


def _together(cases: int) -> Found:
    seeds = _seeds(cases)

    def draw(seed: Any) -> jax.Array:
        drawn = _drawn_of(WORDS, seed, "pcg4d")
        return jnp.concatenate([drawn[name].ravel().astype(jnp.uint32) for name in WORDS])

    together = jax.jit(jax.vmap(draw))(seeds)
    with jax.disable_jit():
        alone = np.stack([draw(jnp.int32(seed)) for seed in seeds])
    return _different(together, alone, seeds)


def _as_published(name: str, ours: Any, seeds: np.ndarray) -> Found:
    shape = np.shape(ours)
    words = np.array([_drawn(name, int(seed), math.prod(shape[1:])) for seed in seeds], np.uint64)
    return _different(ours, words.astype(np.asarray(ours).dtype).reshape(shape), seeds)


def _pcg4d(*words: int) -> list[int]:
    """The hash as it is published: a multiplier and an increment, cross terms, a shift, and the cross terms again."""

    def cross(x: int, y: int, z: int, w: int) -> list[int]:
        x = (x + y * w) & MASK
        y = (y + z * x) & MASK
        z = (z + x * y) & MASK
        w = (w + y * z) & MASK
        return [x, y, z, w]

    return cross(*(v ^ (v >> 16) for v in cross(*((v * 1664525 + 1013904223) & MASK for v in words))))


def _twice(*words: int) -> list[int]:
    return _pcg4d(*_pcg4d(*words))


def _drawn(name: str, seed: int, count: int) -> list[int]:
    """What ``WORDS`` should give: two passes over key, counter and the operation's name, one for a fold. Narrow words
    are the low bits of a word each, wide ones two words, the high one first."""
    key = _twice(0, seed & MASK, 0, int.from_bytes(b"seed", "big"))[:2]
    if name == "key_data":
        return key
    if name.startswith("fold_in"):
        return _pcg4d(*key, HIGH if name.endswith("high") else 123, int.from_bytes(b"fold", "big"))[:2]
    operation = int.from_bytes(b"splt" if name.startswith("split") else b"rand", "big")
    wide = name in WIDE
    size = count * (1 + wide)
    words = [word for i in range(-(-size // 4)) for word in _twice(*key, i, operation)][:size]
    return [high << 32 | low for high, low in zip(words[::2], words[1::2], strict=True)] if wide else words
