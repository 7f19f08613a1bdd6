"""A model of an environment, learned from experience: what came of each action in each state, to plan with.

Sutton, *Integrated Architectures for Learning, Planning, and Reacting*, 1990; Sutton and Barto, 2018, section 8.2.
"""

from __future__ import annotations

from typing import NamedTuple

import jax
import jax.numpy as jnp

from jaxq import replay
from jaxq.types import Array, Key


class Model(NamedTuple):
    """The last K outcomes of every cell (state and action), of C cells, and the cells in the order of first visits."""

    r_t: Array  # [C, K]
    continues_t: Array  # [C, K]
    s_t: Array  # [C, K]
    tried: Array  # [C] how often
    known: Array  # [C] the first ``num_known`` are the cells that were tried
    num_known: Array  # []


class Imagined(NamedTuple):
    """A transition that the model made, all []."""

    s_tm1: Array
    a_tm1: Array
    r_t: Array
    continues_t: Array
    s_t: Array


def empty(num_states: int, num_actions: int, outcomes: int) -> Model:
    """The model that knows nothing."""
    cells = num_states * num_actions
    reward, states = jnp.zeros((cells, outcomes)), jnp.zeros((cells, outcomes), jnp.int32)
    tried = jnp.zeros(cells, jnp.int32)
    return Model(reward, reward, states, tried, tried, jnp.zeros((), jnp.int32))


def record(model: Model, cell: Array, r_t: Array, continues_t: Array, s_t: Array) -> Model:
    """The model with one more outcome of a cell, in the place of its oldest one. Shapes: all [].

    >>> model = record(empty(2, 1, 1), jnp.array(1), 5.0, 1.0, jnp.array(0))
    >>> model.r_t.tolist(), model.known[: model.num_known].tolist()
    ([[0.0], [5.0]], [1])
    """
    place = model.tried[cell] % model.r_t.shape[1]
    new = (model.tried[cell] == 0).astype(jnp.int32)
    return Model(
        r_t=model.r_t.at[cell, place].set(r_t),
        continues_t=model.continues_t.at[cell, place].set(continues_t),
        s_t=model.s_t.at[cell, place].set(s_t),
        tried=model.tried.at[cell].add(1),
        known=model.known.at[model.num_known].set(cell, mode="drop"),  # of one that is known it does not count
        num_known=model.num_known + new,
    )


def imagine(key: Key, model: Model, num_actions: int) -> Imagined:
    """A transition from a cell that was tried, all equally likely, to one of its outcomes, all equally likely.

    The key is consumed. At least one cell must have been tried.
    """
    words = jax.random.bits(key, (2,), jnp.uint32)
    cell = model.known[replay.bounded(words[0], model.num_known)]
    place = replay.bounded(words[1], jnp.minimum(model.tried[cell], model.r_t.shape[1]))
    return Imagined(
        s_tm1=cell // num_actions,
        a_tm1=cell % num_actions,
        r_t=model.r_t[cell, place],
        continues_t=model.continues_t[cell, place],
        s_t=model.s_t[cell, place],
    )
