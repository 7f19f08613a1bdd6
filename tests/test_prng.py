"""Keys: threefry is JAX's bit for bit; pcg4d is random enough as it is used, and the tests that say so can fail."""

from __future__ import annotations

from unittest import mock

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import stats

from jaxq import prng
from jaxq.families import FAMILIES

# Beyond 32 bits a seed is cut without x64, as JAX does; 2**63 - 1 is the largest that JAX takes.
SEEDS = (0, 1, -1, 12345, 2**31 - 1, 2**31, 2**32 - 1, 2**32 + 5, -(2**31), 2**63 - 1, -(2**63))
SHAPES = ((), (1,), (7,), (3, 5), (2, 0, 3), (1001,))


@pytest.fixture(autouse=True)
def keys_may_be_reused():
    """These tests ask one key for many things, on purpose."""
    with jax.debug_key_reuse(False):
        yield


def words(key):
    return np.asarray(jax.random.key_data(key))


def draws(key, shape, wide):
    """One of everything that the identity covers; ``wide`` adds what only exists under x64."""
    sizes = (jnp.uint8, jnp.uint16, jnp.uint32) + ((jnp.uint64,) if wide else ())
    floats = (jnp.float32,) + ((jnp.float64,) if wide else ())
    return (
        [jax.random.bits(key, shape, dtype) for dtype in sizes]
        + [jax.random.uniform(key, shape, dtype, -2.0, 3.0) for dtype in floats]
        + [jax.random.normal(key, shape, dtype) for dtype in floats]
        + [jax.random.randint(key, shape, -5, 1000), jax.random.randint(key, shape, 0, 2, jnp.uint8)]
        + [
            jax.random.key_data(jax.random.split(key, shape or 3)),
            jax.random.key_data(jax.random.fold_in(key, 2**32 - 1)),
        ]
    )


def assert_same(ours, theirs):
    for a, b in zip(ours, theirs, strict=True):
        assert a.dtype == b.dtype
        np.testing.assert_array_equal(np.asarray(a), np.asarray(b))


# ---- threefry: the bits of JAX ----


@pytest.mark.parametrize("wide", [False, True])
@pytest.mark.parametrize("shape", SHAPES, ids=str)
def test_threefry_draws_what_jax_draws(shape, wide):
    with jax.enable_x64(wide):
        draw = jax.jit(draws, static_argnums=(1, 2))
        for seed in SEEDS:
            assert_same(draw(prng.key(seed), shape, wide), draw(jax.random.key(seed), shape, wide))


def test_threefry_draws_what_jax_draws_outside_of_jit():
    assert_same(draws(prng.key(3), (5,), False), draws(jax.random.key(3), (5,), False))


@pytest.mark.parametrize("shape", [(), (3,), (4, 2)], ids=str)
def test_threefry_draws_what_jax_draws_under_vmap(shape):
    ours, theirs = (jax.random.split(key, (2, 3)) for key in (prng.key(5), jax.random.key(5)))
    batched = jax.jit(jax.vmap(jax.vmap(lambda k: draws(k, shape, False))))
    assert_same(batched(ours), batched(theirs))
    seeds = jnp.arange(-3, 3)
    assert_same([words(jax.vmap(prng.key)(seeds))], [words(jax.vmap(jax.random.key)(seeds))])


@settings(max_examples=60, deadline=None)
@given(st.integers(-(2**63), 2**63 - 1), st.integers(0, 2**32 - 1), st.booleans())
def test_threefry_keys_are_those_of_jax(seed, data, wide):
    with jax.enable_x64(wide):
        ours, theirs = prng.key(seed), jax.random.key(seed)
        np.testing.assert_array_equal(words(ours), words(theirs))
        np.testing.assert_array_equal(words(jax.random.fold_in(ours, data)), words(jax.random.fold_in(theirs, data)))


@pytest.mark.parametrize("dtype", ["int8", "uint8", "int16", "int32", "uint32"])
def test_threefry_takes_seeds_of_every_integer_type_as_jax_does(dtype):
    for seed in (np.iinfo(dtype).min, np.iinfo(dtype).max):
        seed = np.asarray(seed, dtype)[()]
        np.testing.assert_array_equal(words(prng.key(seed)), words(jax.random.key(seed)))


def test_threefry_follows_jax_when_it_is_not_partitionable():
    with jax.threefry_partitionable(False):
        off = draws(prng.key(3), (7,), False)
        assert_same(off, draws(jax.random.key(3), (7,), False))
    assert (np.asarray(off[2]) != np.asarray(jax.random.bits(prng.key(3), (7,)))).any()


def hot_loop(key):
    def step(total, t):
        a, b = jax.random.split(jax.random.fold_in(key, t))
        return total + jax.random.uniform(a) + jnp.sum(jax.random.uniform(b, (6,))), None

    return jax.lax.scan(step, jax.random.uniform(key), jnp.arange(9))[0]


@pytest.mark.parametrize("impl", FAMILIES)
def test_no_loop_is_left_in_the_compiled_program(impl):
    # XLA fuses nothing with a while loop: the one that JAX's own threefry becomes on a CPU is the reason for this
    # module. That one is looked at too, so that this test is known to see a loop; once it has none, the module's
    # threefry has lost its purpose.
    def loops(key):
        return jax.jit(lambda k: draws(k, (33,), False)).lower(key).compile().as_text().count(" while(")

    assert loops(prng.key(0, impl)) == 0
    if jax.default_backend() == "cpu":
        assert loops(jax.random.key(0)) > 0


# ---- both families: the contract of a typed key ----


@pytest.mark.parametrize("impl", FAMILIES)
def test_one_lane_alone_draws_what_it_draws_among_others(impl):
    keys = jax.random.split(prng.key(1, impl), 5)
    together = jax.jit(jax.vmap(lambda k: draws(k, (6,), False)))(keys)
    for i in range(5):
        assert_same([x[i] for x in together], draws(keys[i], (6,), False))


@pytest.mark.parametrize("impl", FAMILIES)
def test_keys_work_under_scan_and_shard_map(impl):
    mesh = jax.sharding.Mesh(np.array(jax.devices()), ("lanes",))
    spec = jax.sharding.PartitionSpec("lanes")
    keys = jax.random.split(prng.key(1, impl), 3 * len(jax.devices()))
    sharded = jax.jit(jax.shard_map(jax.vmap(hot_loop), mesh=mesh, in_specs=spec, out_specs=spec))
    alone = jnp.stack([jax.jit(hot_loop)(k) for k in keys])
    np.testing.assert_allclose(np.asarray(sharded(keys)), np.asarray(alone), rtol=1e-6)  # sums: the order may differ


@pytest.mark.parametrize("impl", FAMILIES)
def test_reuse_of_a_key_is_seen(impl):
    with jax.debug_key_reuse(True):
        jax.jit(lambda k: [jax.random.bits(child) for child in jax.random.split(k, 3)])(prng.key(0, impl))
        with pytest.raises(jax.errors.KeyReuseError):
            jax.jit(lambda k: jax.random.bits(k) + jax.random.bits(k))(prng.key(0, impl))


@pytest.mark.parametrize("impl", FAMILIES)
def test_wrap_undoes_key_data(impl):
    keys = jax.random.split(prng.key(2, impl), (2, 3))
    data = jax.random.key_data(keys)
    assert data.dtype == jnp.uint32
    assert data.shape == (2, 3, 2)
    again = prng.wrap(data, impl)
    assert again.dtype == keys.dtype
    assert bool((again == keys).all())
    assert jax.random.key_impl(again) == jax.random.key_impl(keys)
    np.testing.assert_array_equal(words(jax.jit(lambda d: prng.wrap(d, impl))(data)), data)


def test_jax_own_keys_go_through_the_same_code():
    theirs = jax.random.key(4)
    np.testing.assert_array_equal(hot_loop(theirs), hot_loop(prng.key(4)))
    np.testing.assert_array_equal(words(prng.wrap(jax.random.key_data(theirs))), words(theirs))


@pytest.mark.parametrize("make", [lambda i: prng.key(0, i), lambda i: prng.wrap(jnp.zeros(2, jnp.uint32), i)])
@pytest.mark.parametrize("impl", ["philox", "threefry2x32", "", None])
def test_unknown_impl_is_named_with_the_allowed_ones(make, impl):
    with pytest.raises(ValueError, match=f"'threefry', 'pcg4d', got {impl!r}"):
        make(impl)


@pytest.mark.parametrize("impl", FAMILIES)
@pytest.mark.parametrize("seed", [1.0, "1", None, True, np.bool_(True), np.float32(1), np.zeros(2), jax.random.key(0)])
def test_seed_that_is_no_integer_is_refused(seed, impl):
    with pytest.raises(TypeError, match="seed must be an integer"):
        prng.key(seed, impl)


def test_seed_and_words_of_a_wrong_shape_are_refused():
    with pytest.raises(TypeError, match="scalar seed"):
        prng.key(np.arange(3))
    with pytest.raises(TypeError, match="key data"):
        prng.wrap(jnp.zeros(4, jnp.uint32), "pcg4d")
    with pytest.raises(ValueError, match="fewer than"):
        jax.jit(lambda k: jax.random.bits(k, (2**16, 2**16))).lower(prng.key(0, "pcg4d"))


# ---- pcg4d: the hash, and what is made of it ----


def published_pcg4d(v):
    """The listing of Jarzynski and Olano in Python integers."""
    m = 2**32
    x, y, z, w = ((a * 1664525 + 1013904223) % m for a in v)
    for last in (False, True):
        x = (x + y * w) % m
        y = (y + z * x) % m
        z = (z + x * y) % m
        w = (w + y * z) % m
        if not last:
            x, y, z, w = (a ^ (a >> 16) for a in (x, y, z, w))
    return [x, y, z, w]


@settings(max_examples=50, deadline=None)
@given(st.lists(st.integers(0, 2**32 - 1), min_size=4, max_size=4))
def test_pcg4d_is_the_published_hash(v):
    assert [int(a) for a in prng.pcg4d(*np.array(v, np.uint32))] == published_pcg4d(v)


def test_pcg4d_words_are_two_passes_over_key_counter_and_operation():
    key = prng.key(-7, "pcg4d")
    k = [int(a) for a in words(key)]
    operation = int.from_bytes(b"rand", "big")
    expected = [a for i in range(3) for a in published_pcg4d(published_pcg4d([*k, i, operation]))]
    assert jax.random.bits(key, (12,)).tolist() == expected
    with jax.enable_x64(True):
        assert jax.random.bits(key, (2,), jnp.uint64).tolist() == [
            a << 32 | b for a, b in np.reshape(expected[:4], (2, 2)).tolist()
        ]
    assert jax.random.bits(key, (2, 2), jnp.uint8).ravel().tolist() == [a % 256 for a in expected[:4]]


@pytest.mark.parametrize("size", [0, 1, 3, 4, 5, 8, 9, 100])
def test_pcg4d_words_do_not_depend_on_how_many_are_drawn(size):
    key = prng.key(1, "pcg4d")  # small and large draws are computed in two ways
    np.testing.assert_array_equal(jax.random.bits(key, (size,)), jax.random.bits(key, (101,))[:size])
    np.testing.assert_array_equal(words(jax.random.split(key, size)), words(jax.random.split(key, 101))[:size])


def test_pcg4d_takes_both_words_of_a_seed():
    with jax.enable_x64(True):
        assert (words(prng.key(5, "pcg4d")) != words(prng.key(2**32 + 5, "pcg4d"))).any()
        np.testing.assert_array_equal(words(prng.key(np.int32(5), "pcg4d")), words(prng.key(5, "pcg4d")))


# ---- pcg4d: statistics. Every check takes an implementation and returns p-values, so that bad ones go through too ----

# Chance that one check refuses a perfect generator, over all of its p-values together (Bonferroni). Inputs are fixed,
# so a check that passes once passes always; the bad generators miss the bound by hundreds of orders of magnitude.
ALPHA = 1e-4
LANES = 2**16  # keys of a check: 256 cells then expect 256 counts each, far above the 5 that chi-square asks for
FLIPS = 2**12  # inputs of an avalanche check: a probability of 0.5 + 0.05 is 6 standard deviations away


def uniform_cells(cells, count):
    """Two-sided p-value of chi-square: cells filled too evenly are as suspect as cells filled too unevenly."""
    upper = stats.chisquare(np.bincount(cells.ravel(), minlength=count)).pvalue
    return 2 * min(upper, 1 - upper)


def fair_bits(flips):
    """p-values of 'each of the 32 bits is 1 with probability 0.5'. Shapes: [samples, ...] uint32 -> flat."""
    ones = np.stack([((flips >> np.uint32(b)) & np.uint32(1)).sum(axis=0) for b in range(32)])
    z = (2.0 * ones - len(flips)) / np.sqrt(len(flips))  # binomial, near normal at 2**12 samples
    return 2 * stats.norm.sf(np.abs(z)).ravel()


def independent(a, b):
    """p-values for two columns of words: pairs of nibbles, low, middle and high, and the 32 bits of the xor."""
    a, b = np.asarray(a).ravel(), np.asarray(b).ravel()
    nibbles = [[((v >> np.uint32(s)) & np.uint32(15)).astype(int) for s in (0, 14, 28)] for v in (a, b)]
    pairs = [uniform_cells(16 * x + y, 256) for x in nibbles[0] for y in nibbles[1]]
    return np.concatenate([pairs, fair_bits(a ^ b)])


def lanes(impl, count=LANES):
    """Keys as the engine makes them: fold_in(key(root), index)."""
    root = jax.random.key(2024, impl=impl)
    return jax.jit(jax.vmap(lambda i: jax.random.fold_in(root, i)))(jnp.arange(count, dtype=jnp.uint32))


def drawn(keys, size):
    return np.asarray(jax.jit(jax.vmap(lambda k: jax.random.bits(k, (size,))))(keys))


def uniformity(impl):
    """Bytes of words, high and low bits of uniforms, of keys that were folded in and split."""
    children = jax.jit(jax.vmap(jax.random.split))(lanes(impl))
    w = drawn(children[:, 0], 4)
    u = np.asarray(jax.jit(jax.vmap(lambda k: jax.random.uniform(k, (4,))))(children[:, 1]))
    high, low = (u * 256).astype(int), (u * 2.0**23).astype(int) % 256  # a uniform is made of 23 bits
    by_byte = [uniform_cells((w[:, i] >> np.uint32(s)) & np.uint32(255), 256) for i in range(4) for s in (0, 8, 16, 24)]
    return np.array(by_byte + [uniform_cells(v[:, i], 256) for v in (high, low) for i in range(4)])


def serial(impl):
    """One long draw of one key, and the first word of every key in a sequence of fold_in, at several lags."""
    keys = lanes(impl)
    long = np.asarray(jax.jit(lambda k: jax.random.bits(k, (2**17,)))(keys[3]))
    sequences = (long, drawn(keys, 1)[:, 0])
    return np.concatenate([independent(s[:-lag], s[lag:]) for s in sequences for lag in (1, 2, 3, 4, 8, 64, 1024)])


def within_a_draw(impl):
    """Words of one draw: pairs, and each bit of each of the hash's four outputs over eight counters."""
    w = drawn(lanes(impl), 32)
    pairs = [
        independent(w[:, i], w[:, j]) for i, j in ((0, 1), (0, 2), (0, 3), (1, 2), (2, 3), (0, 4), (3, 4), (1, 31))
    ]
    powers = 2 ** np.arange(8)
    patterns = [
        uniform_cells((((w[:, output::4] >> np.uint32(b)) & np.uint32(1)) * powers).sum(axis=1), 256)
        for output in range(4)
        for b in range(32)
    ]
    return np.concatenate([*pairs, patterns])


def between_children(impl):
    """Children of one split, one another and their parent."""
    keys = lanes(impl)
    children = jax.jit(jax.vmap(lambda k: jax.random.split(k, 4)))(keys)
    d, first = words(children), [drawn(children[:, i], 1) for i in range(4)]
    pairs = ((0, 1), (0, 2), (1, 2), (2, 3))
    by_key = [independent(d[:, i, a], d[:, j, b]) for i, j in pairs for a in (0, 1) for b in (0, 1)]
    by_draw = [independent(first[i], first[j]) for i, j in pairs]
    return np.concatenate(
        [*by_key, *by_draw, independent(first[0], drawn(keys, 1)), independent(d[:, 0, 0], drawn(keys, 1))]
    )


def between_neighbours(impl):
    """Draws of neighbouring seeds, and of neighbouring counters folded in."""
    seeds = jax.jit(jax.vmap(lambda s: jax.random.key(s, impl=impl)))(jnp.arange(LANES))
    first = [drawn(keys, 2) for keys in (seeds, lanes(impl))]
    return np.concatenate(
        [independent(w[:-step, i], w[step:, i]) for w in first for step in (1, 2, 256) for i in (0, 1)]
    )


def between_operations(impl):
    """One key asked for a child, for words of a number folded in, and for words."""
    keys = lanes(impl)
    child = words(jax.jit(jax.vmap(jax.random.split))(keys))[:, 0]
    folded = [drawn(jax.jit(jax.vmap(lambda k, n=n: jax.random.fold_in(k, n)))(keys), 2) for n in (0, 1)]
    views = (child, *folded, drawn(keys, 2))
    return np.concatenate(
        [independent(a[:, i], b[:, i]) for n, a in enumerate(views) for b in views[:n] for i in (0, 1)]
    )


def avalanche(function, *inputs):
    """p-values of 'flipping an input bit flips each output bit with probability 0.5', for every bit of every input.

    Shapes: inputs [FLIPS] uint32 each; function maps scalars to [words].
    """
    run = jax.jit(jax.vmap(function))
    before = np.asarray(run(*inputs))
    p = []
    for i in range(len(inputs)):
        for b in range(32):
            flipped = [v ^ np.uint32(1 << b) if i == j else v for j, v in enumerate(inputs)]
            p.append(fair_bits(before ^ np.asarray(run(*flipped))))
    return np.concatenate(p)


def random_words(count):
    return list(np.random.default_rng(0).integers(0, 2**32, (count, FLIPS), np.uint32))


def avalanche_of_seed(impl):
    return avalanche(lambda s: jax.random.key_data(jax.random.key(s, impl=impl)), *random_words(1))


def avalanche_of_small_seed(impl):
    seeds = np.arange(FLIPS, dtype=np.uint32)
    return avalanche(lambda s: jax.random.key_data(jax.random.key(s, impl=impl)), seeds)


def avalanche_of_wide_seed(impl):
    with jax.enable_x64(True):

        def of_halves(high, low):
            seed = (high.astype(jnp.int64) << 32) | low.astype(jnp.int64)
            return jax.random.key_data(jax.random.key(seed, impl=impl))

        return avalanche(of_halves, *random_words(2))


def of_words(impl, function):
    return lambda k0, k1, *data: function(jax.random.wrap_key_data(jnp.stack([k0, k1]), impl=impl), *data)


def avalanche_of_what_follows_fold_in(impl):
    """Both words of the key, and the number, for draws from the folded key, its children, and a key folded again."""

    def follows(key, data):
        folded = jax.random.fold_in(key, data)
        child, again = jax.random.split(folded)[1], jax.random.fold_in(folded, 7)
        return jnp.concatenate(
            [jax.random.bits(folded, (5,)), jax.random.key_data(child), jax.random.bits(again, (1,))]
        )

    return avalanche(of_words(impl, follows), *random_words(3))


def after_small_numbers(impl):
    """First words of keys that small numbers, neighbours, were folded into twice."""
    grid = jnp.arange(256, dtype=jnp.uint32)
    root = jax.random.key(1, impl=impl)
    twice = jax.vmap(lambda a: jax.vmap(lambda b: jax.random.fold_in(jax.random.fold_in(root, a), b))(grid))(grid)
    first = drawn(twice.ravel(), 1)[:, 0].reshape(256, 256)
    return np.concatenate([independent(first[1:], first[:-1]), independent(first[:, 1:], first[:, :-1])])


def avalanche_of_split(impl):
    """Both words of the key, for children 0 and 5; then the index, as far as a split can be made."""
    split = of_words(impl, lambda key: jax.random.key_data(jax.random.split(key, 6))[jnp.array([0, 5])].ravel())
    children = words(jax.jit(lambda k: jax.random.split(k, LANES))(lanes(impl, 2)[1]))
    index = np.arange(LANES)
    by_index = [fair_bits(children ^ children[index ^ (1 << b)]) for b in range(16)]
    return np.concatenate([avalanche(split, *random_words(2)), *by_index])


def avalanche_of_bits(impl):
    """Both words of the key, for the words 0 to 3 and 20 of a draw."""
    bits = of_words(impl, lambda key: jax.random.bits(key, (21,))[jnp.array([0, 1, 2, 3, 20])])
    return avalanche(bits, *random_words(2))


CHECKS = (
    uniformity,
    serial,
    within_a_draw,
    between_children,
    between_neighbours,
    between_operations,
    avalanche_of_seed,
    avalanche_of_small_seed,
    avalanche_of_wide_seed,
    avalanche_of_what_follows_fold_in,
    after_small_numbers,
    avalanche_of_split,
    avalanche_of_bits,
)


def looks_random(p):
    return bool(p.min() >= ALPHA / p.size)


def one_pass(*inputs):
    return prng.pcg4d(*inputs)


def weakened(function):
    """A function of prng with one pass of the hash for two."""

    def traced(*args):
        with mock.patch.object(prng, "_hash", one_pass):
            return function(*args)

    return traced


PCG4D = prng._SPECS["pcg4d"]
PCG4D_FUNCTIONS = {
    "seed": prng._pcg4d_seed,
    "fold_in": prng._pcg4d_fold_in,
    "split": prng._pcg4d_split,
    "bits": prng._pcg4d_bits,
}
ONE_PASS = prng._define("one_pass", "one_pass", **{n: weakened(f) for n, f in PCG4D_FUNCTIONS.items()})


def lcg(v):
    return v * np.uint32(1664525) + np.uint32(1013904223)


LCG = prng._define(
    "lcg",
    "lcg",
    seed=lambda seed: lcg(jnp.stack(prng._halves(seed)[::-1])),
    fold_in=lambda key, data: lcg(key ^ data.astype(jnp.uint32)),
    split=lambda key, shape: lcg(key + prng._iota(2 * int(np.prod(shape))).reshape(*shape, 2)),
    bits=lambda key, bit_width, shape: lcg(key[0] + key[1] * prng._iota(int(np.prod(shape)))).reshape(shape),
)


@pytest.mark.parametrize("check", CHECKS, ids=lambda c: c.__name__)
def test_pcg4d_looks_random(check):
    p = check(PCG4D)
    assert looks_random(p), f"smallest of {p.size} p-values is {p.min():.1e}, allowed is {ALPHA / p.size:.1e}"


@pytest.mark.parametrize("check", CHECKS, ids=lambda c: c.__name__)
def test_congruential_generator_fails(check):
    assert not looks_random(check(LCG))


# One pass does well where keys are mixed and one hash of each is read, so only some checks see it.
@pytest.mark.parametrize(
    "check",
    [c for c in CHECKS if c.__name__.startswith(("serial", "within", "avalanche")) and "fold_in" not in c.__name__],
)
def test_one_pass_of_pcg4d_fails(check):
    assert not looks_random(check(ONE_PASS))


@pytest.mark.parametrize("operation", ["split", "seed", "bits"])
def test_one_pass_in_one_operation_is_caught(operation):
    functions = PCG4D_FUNCTIONS | {operation: weakened(PCG4D_FUNCTIONS[operation])}
    weak = prng._define(f"weak_{operation}", f"weak_{operation}", **functions)
    check = {
        "split": avalanche_of_split,
        "seed": avalanche_of_seed,
        "bits": within_a_draw,
    }
    assert not looks_random(check[operation](weak))


@pytest.mark.parametrize(("hashed", "good"), [(prng._hash, True), (one_pass, False)], ids=["two passes", "one pass"])
def test_avalanche_of_every_bit_of_a_split_index_and_a_draw_counter(hashed, good):
    # No split is large enough to reach the high bits of the index, so the hash is asked itself.
    for operation in (prng._SPLIT, prng._BITS):
        assert looks_random(avalanche(lambda *v, o=operation: jnp.stack(hashed(*v, o)), *random_words(3))) == good


def folded_twice(impl, seed):
    """All keys of pairs of numbers folded into a key, small ones and large; each as one integer of 64 bits."""
    numbers = jnp.concatenate([jnp.arange(512, dtype=jnp.uint32), jnp.arange(2**32 - 512, 2**32, dtype=jnp.uint32)])
    root = jax.random.key(seed, impl=impl)

    def fold(a, b):
        return jax.random.fold_in(jax.random.fold_in(root, a), b)

    w = words(jax.jit(jax.vmap(jax.vmap(fold, (None, 0)), (0, None)))(numbers, numbers)).reshape(-1, 2)
    return w[:, 0].astype(np.uint64) << np.uint64(32) | w[:, 1]


@pytest.mark.parametrize("seed", [0, 1, 2**31])
def test_no_two_pairs_of_numbers_fold_into_one_key(seed):
    # 2^20 keys of 64 bits: the chance of any collision is 3e-8.
    folded = folded_twice(PCG4D, seed)
    assert len(np.unique(folded)) == len(folded) == 2**20


def test_numbers_mixed_in_by_hand_collide():
    by_hand = PCG4D_FUNCTIONS | {"fold_in": lambda key, data: key ^ jnp.stack([data, data * np.uint32(2654435761)])}
    folded = folded_twice(prng._define("by_hand", "by_hand", **by_hand), 0)
    assert len(np.unique(folded)) < len(folded)
