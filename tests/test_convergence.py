"""On a small MDP every tabular agent comes to the action values that can be computed exactly.

The reference is NumPy in float64: value iteration for Q*, the same with a policy for Q^pi, and the operator of n-step
Q-learning. Each agent is swept once, with a behaviour that is uniform and with one that is greedy but for 0.2, and with
episodes that are cut after 7 steps: a truncation that did not bootstrap would be seen.
"""

from __future__ import annotations

import jax
import jax.numpy as jnp
import numpy as np
import optax
import pytest

import jaxq
from jaxq import networks
from jaxq.agents.dqn import DQNHypers, dqn
from jaxq.agents.tabular import TabularHypers, tabular
from jaxq.envs.mdp import MDP, finite_mdp, random_mdp
from jaxq.types import Clock, Transition

GAMMA, SEEDS, LIMIT = 0.8, 16, 7
UNIFORM, MOSTLY_GREEDY = 0, 1  # settings of the sweep
WORLD: MDP = random_mdp(np.random.default_rng(29), 6, 2)
#: Of the span of Q*, about 3.6: how far the mean of 16 seeds may be from the truth after 100,000 steps.
CLOSE = 0.015


def backup(v):
    return WORLD.reward + GAMMA * WORLD.transition @ np.where(WORLD.terminal, 0, v)


def fixed_point(operator):
    q = np.zeros(WORLD.reward.shape)
    for _ in range(500):
        q = operator(q)
    return q


def optimal():
    return fixed_point(lambda q: backup(q.max(axis=1)))


def of_policy(pi):
    return fixed_point(lambda q: backup((pi * q).sum(axis=1)))


def of_n_steps(pi, n):
    """What n-step Q-learning comes to: n - 1 steps of the behaviour before the greedy value."""

    def operator(q):
        v = q.max(axis=1)
        for _ in range(n - 1):
            v = (pi * backup(v)).sum(axis=1)
        return backup(v)

    return fixed_point(operator)


def epsilon_greedy(q, epsilon):
    actions = q.shape[1]
    return epsilon / actions + (1 - epsilon) * (np.arange(actions) == q.argmax(axis=1)[:, None])


def make_env(limit: int = LIMIT):
    return finite_mdp(*WORLD[:3], terminal=WORLD.terminal, max_episode_steps=limit)


def learned(preset, **changes):
    """The mean table over the seeds, by setting: a behaviour that is uniform, and one that is greedy but for 0.2."""
    numbers = {"gamma": GAMMA, "alpha_max": 1.0, "alpha_min": 0.0, "epsilon_max": 1.0, "decay_coeff": 0.01}
    parts = {"step_size": "visits", "visit_power": 0.75, "max_env_steps": 100_000, "max_episodes": 2_000_000_000}
    settings = {**numbers, **parts, "stop": "none", "eval_episodes": 1, **changes}
    runs = jaxq.sweep(preset, env=make_env, epsilon_min=[1.0, 0.2], seeds=SEEDS, **settings)
    assert set(runs.lanes["status"].to_pylist()) == {"finished"}
    return np.array([
        np.mean([runs.policy(config=config, seed=seed).weights["table"] for seed in range(SEEDS)], axis=0)
        for config in (UNIFORM, MOSTLY_GREEDY)
    ])  # fmt: skip


def error(found, exact):
    """Largest error over the states in which actions are taken, relative to the span of Q*."""
    return np.max(np.abs(found - exact)[~WORLD.terminal]) / np.ptp(optimal())


def test_the_truths_are_far_apart():
    uniform = np.full(WORLD.reward.shape, 0.5)
    truths = [optimal(), of_policy(uniform), of_n_steps(uniform, 4), of_policy(epsilon_greedy(optimal(), 0.2))]
    apart = [error(a, b) for i, a in enumerate(truths) for b in truths[:i]]
    assert min(apart) > 5 * CLOSE, apart


@pytest.mark.parametrize(
    ("preset", "parts"),
    [
        ("q-learning", {}),
        ("double-q-learning", {}),
        ("q-lambda", {}),
        ("dyna-q", {"model_outcomes": 1000}),
        ("q-learning", {"initial_value": 10.0}),
    ],
    ids=["q-learning", "double", "q-lambda", "dyna-q", "optimism"],
)
def test_off_policy_agents_come_to_the_optimal_values(preset, parts):
    for found in learned(preset, **parts):
        assert error(found, optimal()) < CLOSE


@pytest.mark.parametrize(
    ("preset", "parts"),
    [
        ("sarsa", {}),
        ("expected-sarsa", {}),
        ("sarsa-lambda", {}),
        ("sarsa-lambda", {"traces": "dutch", "trace_decay": 0.8}),
        ("monte-carlo", {"visit_power": 1.0}),
    ],
    ids=["sarsa", "expected", "sarsa-lambda", "true online", "monte-carlo"],
)
def test_on_policy_agents_come_to_the_values_of_their_own_policy(preset, parts):
    found = learned(preset, **parts)
    assert error(found[UNIFORM], of_policy(np.full(WORLD.reward.shape, 0.5))) < CLOSE
    own = of_policy(epsilon_greedy(found[MOSTLY_GREEDY], 0.2))
    assert error(found[MOSTLY_GREEDY], own) < 2 * CLOSE
    assert error(own, of_policy(epsilon_greedy(optimal(), 0.2))) < 1e-9  # and that policy is the greedy one of Q*


def test_n_step_q_learning_comes_to_its_own_fixed_point():
    """Without a time limit: where it cuts, windows are shorter, and less of the behaviour is in their returns."""
    found = learned("n-step-q-learning", **{"env.limit": 1_000_000})
    assert error(found[UNIFORM], of_n_steps(np.full(WORLD.reward.shape, 0.5), 4)) < CLOSE


# A network that is a table


def test_dqn_with_a_table_for_a_network_is_tabular_q_learning_step_by_step():
    """SGD, no hidden layer, a replay of one transition, tau 1: the same table after every one of 200 transitions."""
    states, actions = WORLD.reward.shape
    numbers = dict.fromkeys(TabularHypers._fields, 0.0) | {"alpha_min": 0.3, "alpha_max": 0.3, "gamma": GAMMA}
    table = tabular(TabularHypers(**{**numbers, "decay_coeff": 1.0}), num_states=states, num_actions=actions)
    zeros = dict.fromkeys(DQNHypers._fields, 0.0)
    given = {"learning_rate": 0.3, "learning_rate_end": 0.3, "gamma": GAMMA, "tau": 1.0, "target_period": 1}
    network = dqn(
        DQNHypers(**{**zeros, **given, "anneal_updates": 1, "epsilon_decay": 1.0, "huber_delta": 1.0}),
        network=networks.Network(lambda key, obs: jnp.zeros((states, actions)), lambda params, obs: obs @ params),
        num_actions=actions,
        batch_size=1,
        buffer_size=1,
        loss="squared",
        optimiser=lambda learning_rate, weight_decay: optax.sgd(learning_rate),
    )
    rng, eye = np.random.default_rng(0), np.eye(states, dtype=np.float32)

    def drawn():
        s, s_t = rng.integers(states, size=2)
        given = (s, rng.integers(actions), np.float32(rng.normal()), np.float32(rng.random() > 0.2), s_t, False)
        one = Transition(*(jnp.asarray(leaf)[None, None] for leaf in given))
        return one, one._replace(obs_tm1=eye[one.obs_tm1], obs_t=eye[one.obs_t])

    def at_rest(batch):
        return jax.tree.map(lambda leaf: leaf[0, 0], batch)

    first = drawn()
    by_table, by_network = (a.init(jax.random.key(0), at_rest(b)) for a, b in zip((table, network), first, strict=True))
    learn_table, learn_network = jax.jit(table.update), jax.jit(network.update)
    for step in range(200):
        of_table, of_network = drawn()
        clock = Clock(jnp.int32(step), jnp.int32(0), jnp.int32(step), jnp.float32(1))
        by_table, ours = learn_table(jax.random.key(step), by_table, of_table, clock)
        by_network, theirs = learn_network(jax.random.key(step), by_network, of_network, clock)
        np.testing.assert_allclose(by_network.online, table.policy(by_table), atol=2e-6)
        np.testing.assert_allclose(theirs, ours, atol=1e-5)
    assert np.all(table.policy(by_table) != 0)
