"""What holds of every tabular agent, whichever parts it is put together from."""

from __future__ import annotations

import functools
import itertools

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from numpy_agents import ACTIONS, FAST_COMPILE, STATES, clock, example, numbers, record, transitions

from jaxq.agents.tabular import tabular
from jaxq.table_parts import unfit

UPDATES, ENVS, LANES = 20, 2, 4
CHOICES = {
    "target": ("greedy", "sarsa", "expected"),
    "double": (False, True),
    "n_steps": (1, 3),
    "traces": ("none", "accumulating", "replacing", "dutch"),
    "offline": (False, True),
    "planning_steps": (0, 2),
    "model_outcomes": (2,),
    "step_size": ("episodes", "visits"),
}
EVERY = [dict(zip(CHOICES, chosen, strict=True)) for chosen in itertools.product(*CHOICES.values())]
ALLOWED = [parts for parts in EVERY if not unfit(**parts)]


def backup(parts):
    return [parts[name] for name in ("target", "double", "n_steps", "traces", "offline")]


#: Every target with every backup; planning and step sizes, which neither of them sees, in turn.
GROUPS = [list(group) for _, group in itertools.groupby(ALLOWED, backup)]
RUN = [group[i % len(group)] for i, group in enumerate(GROUPS)]
RECORD = record(1, UPDATES, ENVS)


def name(parts):
    return " ".join(f"{value}" for value in parts.values())


def agent_of(parts, hypers=None, dtype=np.float32):
    sizes = {"num_states": STATES, "num_actions": ACTIONS, "num_envs": ENVS, "dtype": dtype}
    return tabular(numbers(dtype) if hypers is None else hypers, **sizes, **parts)


def hypers_of_lanes():
    """Numbers of each lane, all different."""
    alphas, epsilons = jnp.linspace(0.1, 0.4, LANES), jnp.linspace(0.0, 0.3, LANES)
    all_of_it = jax.tree.map(lambda number: jnp.full(LANES, number), numbers(np.float32))
    return all_of_it._replace(
        alpha_min=alphas,
        alpha_max=2 * alphas,
        epsilon_min=epsilons,
        epsilon_max=epsilons,
        gamma=jnp.linspace(0.5, 1.0, LANES),
    )


def train(parts, hypers, key, live):
    """One lane: the table at the start and after each of 20 updates, and all that the last one left."""
    agent, experience = agent_of(parts, hypers), transitions(RECORD, np.float32)
    state = agent.init(jax.random.key(0), example(experience))
    first = state._replace(table=jax.random.normal(jax.random.fold_in(key, 99), state.table.shape))

    def update(state, given):
        index, live, one = given
        one = jax.tree.map(lambda leaf: leaf[None], one)
        state, metrics = agent.update(jax.random.fold_in(key, index), state, one, clock()._replace(live=live))
        return state, (state.table, metrics)

    last, (tables, metrics) = jax.lax.scan(update, first, (jnp.arange(UPDATES), live, experience))
    return jnp.concatenate([first.table[None], tables]), last, metrics


#: Two lanes that live, one that ends after half of the updates, one that never lived.
LIVES = np.array([[1.0] * 20, [1.0] * 20, [1.0] * 10 + [0.0] * 10, [0.0] * 20], np.float32)


@functools.cache
def lanes(at):
    run = jax.jit(jax.vmap(functools.partial(train, RUN[at])), compiler_options=FAST_COMPILE)
    return jax.device_get(run(hypers_of_lanes(), jax.random.split(jax.random.key(1), LANES), jnp.asarray(LIVES)))


def bits(values):
    return np.ascontiguousarray(values).view(np.uint32)


def test_there_are_as_many_agents_as_parts_that_go_together():
    """48 without traces, and with them 3 targets of 3 kinds, each with planning and step sizes or offline."""
    assert len(ALLOWED) == 3 * 16 + 3 * (3 * 4 + 2 * 2)
    assert len(RUN) == 3 * (4 + 3 + 2)
    for part, values in CHOICES.items():  # nothing is left out
        assert {parts[part] for parts in RUN} == set(values)


@pytest.mark.parametrize("target", CHOICES["target"])
def test_an_update_keeps_the_structure_shapes_and_dtypes_of_the_state_and_uses_no_key_twice(target):
    """Of every agent there is, over lanes; equal to the weak types too, so that a second update is not traced again."""
    experience = transitions(RECORD, np.float32)
    for parts in (parts for parts in ALLOWED if parts["target"] == target):
        agent = agent_of(parts)
        keys = jax.random.split(jax.random.key(0), LANES)
        init = jax.vmap(lambda key, agent=agent: agent.init(key, example(experience)))
        update = jax.vmap(agent.update, in_axes=(0, 0, None, None))
        before = jax.eval_shape(init, keys)
        after, metrics = jax.eval_shape(update, keys, before, experience, clock())
        assert jax.tree.structure(before) == jax.tree.structure(after), name(parts)
        kinds = [
            [(leaf.shape, leaf.dtype, leaf.weak_type) for leaf in jax.tree.leaves(tree)] for tree in (before, after)
        ]
        assert kinds[0] == kinds[1], name(parts)
        assert {(leaf.shape, leaf.dtype.name) for leaf in metrics} == {((LANES,), "float32")}, name(parts)


@pytest.mark.parametrize("at", range(len(RUN)), ids=[name(parts) for parts in RUN])
def test_it_learns_finite_values_while_it_lives_and_stands_still_once_it_has_ended(at):
    tables, last, metrics = lanes(at)
    assert all(np.all(np.isfinite(leaf)) for leaf in jax.tree.leaves((tables, last, metrics)))
    moves = np.any(bits(tables[:, 1:]) != bits(tables[:, :-1]), axis=(2, 3))
    assert np.all(moves[:2].sum(1) >= 5)
    assert moves[2, :10].any()
    assert not moves[2, 10:].any()
    assert not moves[3].any()


@pytest.mark.parametrize("at", range(0, len(RUN), 3))
def test_lanes_under_vmap_equal_a_loop(at):
    tables, last, metrics = lanes(at)
    alone = jax.jit(functools.partial(train, RUN[at]), compiler_options=FAST_COMPILE)
    keys = jax.random.split(jax.random.key(1), LANES)
    for lane in range(LANES):
        hypers = jax.tree.map(lambda leaf, lane=lane: leaf[lane], hypers_of_lanes())
        ours = alone(hypers, keys[lane], jnp.asarray(LIVES[lane]))
        theirs = jax.tree.map(lambda leaf, lane=lane: leaf[lane], (tables, last, metrics))
        jax.tree.map(lambda x, y: np.testing.assert_allclose(x, y, rtol=1e-4, atol=1e-5), ours, theirs)
    assert not np.allclose(tables[0, -1], tables[1, -1], atol=0.01)


@pytest.mark.parametrize(
    "parts",
    [
        {"target": "sarsa", "n_steps": 3},
        {"target": "expected", "traces": "dutch", "step_size": "visits"},
        {"target": "greedy", "double": True, "n_steps": 2, "planning_steps": 2, "step_size": "visits"},
        {"target": "sarsa", "traces": "replacing", "offline": True},
    ],
    ids=name,
)
@pytest.mark.parametrize("dtype", [np.float32, np.float64])
def test_two_updates_are_traced_once_and_keep_the_dtype(parts, dtype):
    with jax.enable_x64(dtype == np.float64):
        agent, experience, traced = agent_of(parts, dtype=dtype), transitions(RECORD, dtype), []

        def update(*given):
            traced.append(given)
            return agent.update(*given)

        step = jax.jit(update, compiler_options=FAST_COMPILE)
        state = agent.init(jax.random.key(0), example(experience))
        before = [leaf.dtype for leaf in jax.tree.leaves(state)]
        for t in range(2):
            state, metrics = step(jax.random.key(t), state, experience, clock())
        assert [leaf.dtype for leaf in jax.tree.leaves(state)] == before
        assert state.table.dtype == metrics.loss.dtype == metrics.max_q.dtype == dtype
        assert len(traced) == 1


# Errors


MEMORIES = [{"target": "sarsa"}, {"n_steps": 2}, {"traces": "accumulating"}, {"traces": "dutch"}]


@pytest.mark.parametrize("parts", MEMORIES, ids=name)
def test_an_agent_with_a_memory_says_how_many_environments_it_was_made_for(parts):
    agent, experience = agent_of(parts), transitions(record(0, 2, 3), np.float32)
    state = agent.init(jax.random.key(0), example(experience))
    with pytest.raises(ValueError, match=r"^experience: 3 environments, where num_envs is 2$"):
        agent.update(jax.random.key(0), state, experience, clock())


@pytest.mark.parametrize("parts", [{}, {"double": True}, {"planning_steps": 1}], ids=["plain", "double", "planning"])
def test_an_agent_without_one_takes_any_number_of_environments(parts):
    agent, experience = agent_of(parts), transitions(record(0, 2, 3), np.float32)
    state = agent.init(jax.random.key(0), example(experience))
    after, _ = jax.eval_shape(agent.update, jax.random.key(0), state, experience, clock())
    assert after.table.shape == state.table.shape


REFUSED = [
    ({"target": "best"}, "target: 'best' is not allowed: greedy, sarsa, expected"),
    ({"traces": "eternal"}, "traces: 'eternal' is not allowed: none, accumulating, replacing, dutch"),
    ({"step_size": "steps"}, "step_size: 'steps' is not allowed: episodes, visits"),
    ({"n_steps": 0}, "n_steps: 0 is not allowed: at least 1"),
    ({"planning_steps": -1}, "planning_steps: -1 is not allowed: at least 0"),
    ({"model_outcomes": 0}, "model_outcomes: 0 is not allowed: at least 1"),
    ({"n_steps": 2, "traces": "replacing"}, "n_steps: 2 is not allowed with traces (replacing): 1"),
    ({"double": True, "traces": "dutch"}, "double: True is not allowed with traces (dutch), whose errors"),
    ({"offline": True}, "offline: True is not allowed with traces (none): accumulating or replacing ones"),
    ({"offline": True, "traces": "dutch"}, "offline: True is not allowed with traces (dutch): accumulating or"),
    ({"offline": True, "traces": "accumulating", "planning_steps": 1}, "planning_steps: 1 is not allowed with offline"),
    ({"num_envs": 0}, "num_envs: 0 must be at least 1"),
    ({"num_states": 0}, "num_states: 0 must be at least 1"),
]


@pytest.mark.parametrize(("parts", "line"), REFUSED, ids=[line for _, line in REFUSED])
def test_parts_that_do_not_go_together_are_an_error_of_one_line(parts, line):
    with pytest.raises(ValueError, match="^" + line.replace("(", r"\(").replace(")", r"\)")) as error:
        tabular(numbers(np.float32), **{"num_states": STATES, "num_actions": ACTIONS} | parts)
    assert "\n" not in str(error.value)
