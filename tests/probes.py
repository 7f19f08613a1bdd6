"""Small environments and agents whose behaviour is known by heart, for tests of the machinery."""

from typing import NamedTuple

import jax
import jax.numpy as jnp

from jaxq.types import Agent, Env, Metrics, Step


class Count(NamedTuple):
    t: jax.Array
    noise: jax.Array


def counter(length: int, *, truncates: bool = False) -> Env:
    """Episodes of ``length`` steps, reward 1 each, observation the step; ends by termination or by truncation."""

    def reset(key):
        return Count(jnp.zeros((), jnp.int32), jax.random.uniform(key))

    def observe(state):
        return state.t

    def step(key, state, action):
        del key, action
        after = Count(state.t + 1, state.noise)
        over = after.t >= length
        return after, Step(observe(after), jnp.ones(()), over & (not truncates), over & truncates)

    return Env(reset, step, observe, num_actions=2, obs_shape=(), num_states=length + 1)


def recorder(seen: int) -> Agent:
    """Learns nothing: its state is the last ``seen`` transitions' (obs, next obs, reward, continues, cut)."""

    def init(key, example):
        del key, example
        return jnp.full((seen, 5), -1.0)

    def act(key, state, obs, clock):
        del state, obs, clock
        return jax.random.randint(key, (), 0, 2)

    def observe(state, experience):
        rows = jnp.stack(
            [experience.obs_tm1, experience.obs_t, experience.r_t, experience.continues_t, experience.cut_t], -1
        ).reshape(-1, 5)
        return jnp.concatenate([state, rows])[-seen:]

    def update(key, state, experience, clock):
        del key
        return observe(state, experience), Metrics(clock.live * 0.0, jnp.zeros(()))

    return Agent(
        init=init,
        act=act,
        exploration=lambda clock: clock.live,
        update=update,
        observe=observe,
        policy=lambda state: state,
        q_values=lambda policy, obs: jnp.zeros(2),
    )
