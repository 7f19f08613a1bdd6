"""Small environments and agents whose behaviour is known by heart, for tests of the machinery."""

from dataclasses import replace
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


def draw(key):
    """A number that tells keys apart: 24 bits, exact in float32."""
    return jax.random.randint(key, (), 0, 2**24).astype(jnp.float32)


def dice() -> Env:
    """Episodes of one step: observation and reward are what the reset drew, the successor is what the step drew."""

    def step(key, state, action):
        del action
        return state, Step(draw(key), state, jnp.array(True), jnp.array(False))

    return Env(draw, step, lambda state: state, num_actions=2, obs_shape=())


def recorder(seen: int, fields=("obs_tm1", "obs_t", "r_t", "continues_t", "cut_t")) -> Agent:
    """Learns nothing: its state is what the last ``seen`` transitions held in these fields."""

    def init(key, example):
        del key, example
        return jnp.full((seen, len(fields)), -1.0)

    def act(key, state, obs, clock):
        del state, obs, clock
        return jax.random.randint(key, (), 0, 2)

    def observe(state, experience):
        rows = jnp.stack([getattr(experience, field) for field in fields], -1).reshape(-1, len(fields))
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


def watch(seen: int) -> Agent:
    """Learns nothing: its state is the clock of the last ``seen`` updates."""

    def update(key, state, experience, clock):
        del key, experience
        return jnp.concatenate([state, jnp.stack(clock)[None]])[-seen:], Metrics(clock.live * 0.0, jnp.zeros(()))

    return replace(recorder(seen), init=lambda key, example: jnp.full((seen, 4), -1.0), update=update)


def gambler(seen: int, updates: int) -> Agent:
    """Learns nothing: it draws its start, its actions and something in each update, and its state is what the start and
    the last ``updates`` drew, and the last ``seen`` transitions' (obs, action, next obs)."""
    inner = recorder(seen, ("obs_tm1", "a_tm1", "obs_t"))

    def update(key, state, experience, clock):
        rows, metrics = inner.update(None, state[1], experience, clock)
        return (jnp.append(state[0], draw(key))[1:], rows), metrics

    return replace(
        inner,
        init=lambda key, example: (jnp.zeros(updates + 1).at[-1].set(draw(key)), inner.init(None, example)),
        act=lambda key, state, obs, clock: draw(key),
        update=update,
    )
