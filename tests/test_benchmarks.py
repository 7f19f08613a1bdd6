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

    start = jax.jit(jax.vmap(plain_jax.init))(jax.random.split(jax.random.key(0), 4))
    state, over = jax.jit(jax.vmap(lambda lane: plain_jax.segment(lane, 8000)))(start)
    over = np.asarray(over)
    untrained, later = 1000 / over[:, :1000].sum(1).mean(), 3000 / (over[:, 5000:].sum(1).min() + 1)
    assert 8 < untrained < 40  # steps per episode: an untrained policy falls within some twenty
    assert later > 2 * untrained  # the best of four: a seed may need longer to start learning
    assert all(np.isfinite(leaf).all() for leaf in jax.tree.leaves(state.params))
