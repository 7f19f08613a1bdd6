"""The peers that the benchmarks run do the work that they stand for."""

import jax
import jax.numpy as jnp
import numpy as np

from benchmarks import plain_jax
from jaxq.envs import CartPoleParams, cartpole


def test_the_plain_jax_peer_plays_cartpole_and_learns():
    env = cartpole(CartPoleParams())
    for seed in range(20):
        start = env.reset(jax.random.key(seed))
        for action in (0, 1):
            _, happened = env.step(jax.random.key(0), start, jnp.int32(action))
            obs, fell = plain_jax.cartpole_step(env.observe(start), jnp.int32(action))
            np.testing.assert_allclose(obs, happened.obs, rtol=1e-5, atol=1e-6)
            assert bool(fell) == bool(happened.terminated)

    state, over = jax.jit(lambda key: plain_jax.segment(plain_jax.init(key), 3000))(jax.random.key(1))
    lengths = np.diff(np.flatnonzero(over))
    assert 5 < lengths[:20].mean() < 40  # an untrained policy falls within some twenty steps
    assert lengths[-5:].mean() > 2 * lengths[:20].mean()
    assert all(np.isfinite(leaf).all() for leaf in jax.tree.leaves(state.params))
