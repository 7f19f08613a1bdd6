"""Keys for ``jax.random``: JAX's own streams made fast on a CPU, and one faster family.

``threefry`` gives the bits of ``jax.random.key`` (Salmon et al., *Parallel random numbers: as easy as 1, 2, 3*, SC
2011). JAX lowers that generator to a rolled loop on a CPU, which nothing fuses with; here its 20 rounds are plain
arithmetic. ``pcg4d`` is a hash of four words (Jarzynski and Olano, *Hash Functions for GPU Rendering*, JCGT 9(3),
2020), about a third of the arithmetic. Neither is meant for secrets.

Both make typed keys that every function of ``jax.random`` takes, and both have the shape of JAX's default key, two
uint32 words. For pcg4d that leaves two of the hash's four inputs to a counter and to the name of the operation, so
nothing is mixed into a key by hand, and one hash makes two children; four-word keys were several times slower in a
scan, because a CPU fusion computes the whole hash again for each word it writes.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Hashable

import jax
import jax.numpy as jnp
import numpy as np
from jax.extend.random import define_prng_impl, threefry_prng_impl

from jaxq.families import FAMILIES
from jaxq.types import Array, Key

Word = Array | np.uint32
Words = tuple[Array, ...]
Shape = tuple[int, ...]


def key(seed: int | Array, impl: str = "threefry") -> Key:
    """Typed key of a seed, for every function of ``jax.random``.

    ``key(seed)`` draws what ``jax.random.key(seed)`` draws, bit for bit; ``impl`` is one of ``FAMILIES``.
    Shapes: seed [] -> []. A seed is an integer of 32 bits, or of 64 where x64 is on; wider ones are cut or refused as
    JAX does.
    Raises ValueError for an unknown ``impl``, TypeError for a seed that is no integer scalar.

    >>> bool(jax.random.bits(key(7)) == jax.random.bits(jax.random.key(7)))
    True
    """
    spec = _spec(impl)
    dtype = getattr(seed, "dtype", None)
    # bool is a subclass of int, and JAX refuses a boolean array: so does this, in either form.
    integer = type(seed) is not bool and isinstance(seed, int) if dtype is None else jnp.issubdtype(dtype, jnp.integer)
    if not integer:
        raise TypeError(f"seed must be an integer, got {seed!r}")
    return jax.random.key(seed, impl=spec)


def wrap(data: Array, impl: str = "threefry") -> Key:
    """Typed keys of raw words, the inverse of ``jax.random.key_data``: states hold words, never typed keys.

    Shapes: data [..., 2] uint32 -> [...]. Raises ValueError for an unknown ``impl``, TypeError for words of another
    shape or dtype.

    >>> bool(wrap(jax.random.key_data(key(7))) == key(7))
    True
    """
    return jax.random.wrap_key_data(data, impl=_spec(impl))


def _spec(impl: str) -> Hashable:
    if impl not in _SPECS:
        raise ValueError(f"impl must be one of {', '.join(map(repr, FAMILIES))}, got {impl!r}")
    return _SPECS[impl]


# ---- threefry ----

_ROTATIONS = ((13, 15, 26, 6), (17, 29, 16, 24))
_PARITY = np.uint32(0x1BD11BDA)


def threefry2x32(k0: Array, k1: Array, x0: Word, x1: Word) -> Words:
    """Threefry-2x32 with 20 rounds: the counter (x0, x1) enciphered under the key (k0, k1).

    A round is x0 += x1; x1 = (x1 rotated left by r) xor x0; after every fourth a part of the key is added. Shapes: all
    uint32, broadcast together. Salmon et al., *Parallel random numbers: as easy as 1, 2, 3*, SC 2011.
    """
    schedule = (k0, k1, k0 ^ k1 ^ _PARITY)
    x0, x1 = k0 + x0, k1 + x1
    for group in range(5):  # unrolled while tracing: a lax loop here is what stops XLA from fusing JAX's own
        for r in _ROTATIONS[group % 2]:
            x0 = x0 + x1
            x1 = x0 ^ ((x1 << np.uint32(r)) | (x1 >> np.uint32(32 - r)))
        x0 = x0 + schedule[(group + 1) % 3]
        x1 = x1 + schedule[(group + 2) % 3] + np.uint32(group + 1)
    return x0, x1


def _threefry_seed(seed: Array) -> Array:
    """Key of a seed: its high and its low word, unmixed. Shapes: [] integer -> [2]."""
    return jnp.stack(_halves(seed))


def _threefry_fold_in(key: Array, data: Array) -> Array:
    """Key of a key and a number: the number enciphered. Shapes: key [2], data [] uint32 -> [2]."""
    return jnp.stack(threefry2x32(key[0], key[1], np.uint32(0), data.astype(jnp.uint32)))


def _threefry_split(key: Array, shape: Shape) -> Array:
    """Children of a key: both words of the enciphered index. Shapes: [2] -> [*shape, 2]."""
    size = math.prod(shape)
    if not _counts_as_jax(shape):
        return threefry_prng_impl.split(key, shape)
    if 0 < size <= 4:  # few children: each alone, so that under vmap the arithmetic runs along the lanes
        pairs = (threefry2x32(key[0], key[1], np.uint32(0), np.uint32(i)) for i in range(size))
        return jnp.stack([word for pair in pairs for word in pair]).reshape(*shape, 2)
    return jnp.stack(threefry2x32(key[0], key[1], np.uint32(0), _iota(size)), axis=-1).reshape(*shape, 2)


def _threefry_bits(key: Array, bit_width: int, shape: Shape) -> Array:
    """Random words of 8, 16, 32 or 64 bits: word i is made of both words of i enciphered. Shapes: [2] -> shape."""
    if not _counts_as_jax(shape):
        return threefry_prng_impl.random_bits(key, bit_width, shape)
    high, low = threefry2x32(key[0], key[1], np.uint32(0), _iota(math.prod(shape)))
    return (_join(high, low) if bit_width == 64 else _narrow(high ^ low, bit_width)).reshape(shape)


def _counts_as_jax(shape: Shape) -> bool:
    """Whether the plain counter 0, 1, 2 ... is JAX's: not without ``jax_threefry_partitionable``, nor past 32 bits.

    Both are rare, and JAX's own slow code then gives the same bits.
    """
    return bool(jax.threefry_partitionable.value) and math.prod(shape) < 2**32


# ---- pcg4d ----

# The fourth input of every hash names the operation, so that no two operations on a key share an input. Any different
# numbers would do; these are the ASCII codes of the words. They are even, which makes the multiplier of the first
# cross term of the first pass odd and hence loses nothing.
_SEED, _SPLIT, _FOLD_IN, _BITS = (np.uint32(int.from_bytes(w, "big")) for w in (b"seed", b"splt", b"fold", b"rand"))


def pcg4d(x: Word, y: Word, z: Word, w: Word) -> Words:
    """One pass of the hash pcg4d, a bijection of four words.

    Each word v becomes 1664525 v + 1013904223; then x += y w, y += z x, z += x y, w += y z; then each v becomes
    v xor (v >> 16); then the four cross terms again. Shapes: all uint32, broadcast together.
    Jarzynski and Olano, *Hash Functions for GPU Rendering*, JCGT 9(3), 2020.
    """
    # asarray: NumPy warns of the overflow that is meant here, JAX does not.
    congruential = (jnp.asarray(v, jnp.uint32) * np.uint32(1664525) + np.uint32(1013904223) for v in (x, y, z, w))
    return _cross(*(v ^ (v >> np.uint32(16)) for v in _cross(*congruential)))


def _cross(x: Array, y: Array, z: Array, w: Array) -> Words:
    x = x + y * w
    y = y + z * x
    z = z + x * y
    w = w + y * z
    return x, y, z, w


def _hash(k0: Array, k1: Array, data: Word, operation: np.uint32) -> Words:
    """Two passes. After one, high input bits have not reached the low output bits, and single bits follow a pattern
    over the consecutive counters of one draw."""
    return pcg4d(*pcg4d(k0, k1, data, operation))


def _pcg4d_seed(seed: Array) -> Array:
    """Key of a seed. Shapes: [] integer -> [2]."""
    high, low = _halves(seed)
    return jnp.stack(_hash(high, low, np.uint32(0), _SEED)[:2])


def _pcg4d_fold_in(key: Array, data: Array) -> Array:
    """Key of a key and a number. Shapes: key [2], data [] uint32 -> [2].

    One pass: a key need only be another one for every number, in any nesting, and whatever is drawn or split from it
    goes through two passes more. Numbers that differ by exactly 2^31 meet in one key with a chance of about 2^-19, as
    the highest bit has nowhere to spread to; other pairs hardly more often than at random.
    """
    return jnp.stack(pcg4d(key[0], key[1], data.astype(jnp.uint32), _FOLD_IN)[:2])


def _pcg4d_split(key: Array, shape: Shape) -> Array:
    """Children of a key, two from each hash of the index. Shapes: [2] -> [*shape, 2]."""
    # A lane's six streams must stand alone: where they are picked, and each is split in its turn, XLA puts one choice
    # into the other and compiles for seconds what else takes half of one.
    return _stream(key, 2 * math.prod(shape), _SPLIT, unroll=12).reshape(*shape, 2)


def _pcg4d_bits(key: Array, bit_width: int, shape: Shape) -> Array:
    """Random words of 8, 16, 32 or 64 bits, four words of 32 bits from each hash of the counter. Shapes: [2] -> shape.

    Narrow ones are the low bits of a word each, wide ones take two.
    """
    size = math.prod(shape)
    if bit_width == 64:
        words = _stream(key, 2 * size, _BITS, unroll=4).reshape(size, 2)
        return _join(words[:, 0], words[:, 1]).reshape(shape)
    return _narrow(_stream(key, size, _BITS, unroll=4), bit_width).reshape(shape)


def _stream(key: Array, size: int, operation: np.uint32, unroll: int) -> Array:
    """Words 0 .. size - 1 of a key: word i is output i mod 4 of the hash of i div 4. Shapes: [2] -> [size].

    Two ways to the same bits. Up to ``unroll`` words each hash stands alone, so that under vmap the arithmetic runs
    along the lanes. For more, every word computes its hash and picks its output: a CPU fusion would compute the hash
    again for each of the four outputs in any case, and this way without a branch per word.
    """
    if size >= 2**32:
        raise ValueError(f"pcg4d makes fewer than 2**32 words from one key, got {size}")
    if 0 < size <= unroll:
        hashes = (_hash(key[0], key[1], np.uint32(i), operation) for i in range(-(-size // 4)))
        return jnp.stack([word for words in hashes for word in words][:size])
    i = _iota(size)
    x, y, z, w = _hash(key[0], key[1], i >> np.uint32(2), operation)
    odd, upper = (i & np.uint32(1)) != 0, (i & np.uint32(2)) != 0
    return jnp.where(upper, jnp.where(odd, w, z), jnp.where(odd, y, x))


# ---- words ----


def _iota(size: int) -> Array:
    return jax.lax.iota(jnp.uint32, size)


def _halves(seed: Array) -> tuple[Array, Array]:
    """High and low word of a seed, as JAX takes them: the high word of a seed of 32 bits is 0, negative or not."""
    low = seed.astype(jnp.uint32)
    return (seed >> 32).astype(jnp.uint32) if seed.dtype.itemsize == 8 else jnp.zeros_like(low), low


def _join(high: Array, low: Array) -> Array:
    return (high.astype(jnp.uint64) << np.uint64(32)) | low.astype(jnp.uint64)


def _narrow(words: Array, bit_width: int) -> Array:
    return words.astype({8: jnp.uint8, 16: jnp.uint16, 32: jnp.uint32}[bit_width])


def _define(
    name: str,
    tag: str,
    seed: Callable[[Array], Array],
    fold_in: Callable[[Array, Array], Array],
    split: Callable[[Array, Shape], Array],
    bits: Callable[[Array, int, Shape], Array],
) -> Hashable:
    # jit, as in JAX's own: without it a draw outside of a compiled function would send a hundred operations one by
    # one. inline leaves no trace of it inside of one.
    return define_prng_impl(
        key_shape=(2,),
        seed=jax.jit(seed, inline=True),
        fold_in=jax.jit(fold_in, inline=True),
        split=jax.jit(split, static_argnums=1, inline=True),
        random_bits=jax.jit(bits, static_argnums=(1, 2), inline=True),
        name=name,
        tag=tag,
    )


_SPECS: dict[str, Hashable] = {
    "threefry": _define(
        "jaxq_threefry", "jaxq_fry", _threefry_seed, _threefry_fold_in, _threefry_split, _threefry_bits
    ),
    "pcg4d": _define("jaxq_pcg4d", "jaxq_pcg", _pcg4d_seed, _pcg4d_fold_in, _pcg4d_split, _pcg4d_bits),
}
