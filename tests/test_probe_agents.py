"""Every agent on every probe: a failure names the probe, and the probe names the bug."""

from __future__ import annotations

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxq
from jaxq.envs.one_hot import one_hot
from jaxq.envs.probes import probes
from jaxq.presets import TabularSettings, presets
from jaxq.types import Env

PROBES, GAMMA = probes(), 0.8
TABLES = [p.name for p in presets() if isinstance(p.settings, TabularSettings)]
#: Enough for every agent: a few seconds each.
STEPS, SEEDS = 4000, 4
#: The agent that bootstraps through death, as the tutorial does: what the probes are there to find.
THROUGH_DEATH = "article-q"


def any_probe(which: int = 0) -> Env:
    """All probes as one environment, so that one program serves them all; surplus actions do as others do."""
    envs = [probe.env for probe in PROBES]

    def chosen(outcomes):
        return jax.tree.map(lambda *leaves: jnp.stack(leaves)[which], *outcomes)

    def reset(key):
        return chosen([env.reset(jax.random.fold_in(key, i)) for i, env in enumerate(envs)])

    def step(key, state, action):
        return chosen([env.step(jax.random.fold_in(key, i), state, action) for i, env in enumerate(envs)])

    states = max(env.num_states for env in envs)
    return Env(reset, step, lambda state: state.s, num_actions=2, obs_shape=(), num_states=states)


def any_one_hot(which: int = 0) -> Env:
    return one_hot(any_probe(which))


def wrong(preset, env, observations, **settings):
    """The probes that the preset fails, with its values: the mean over seeds of what it learned."""
    everywhere = {"gamma": GAMMA, "stop": "none", "max_env_steps": STEPS, "eval_episodes": 1, "env.which": [*range(6)]}
    runs = jaxq.sweep(preset, env=env, seeds=SEEDS, max_episodes=2_000_000_000, **everywhere, **settings)
    assert set(runs.lanes["status"].to_pylist()) == {"finished"}
    failed = {}
    for config, probe in enumerate(PROBES):
        q = np.mean([runs.policy(config=config, seed=seed).q_values(observations) for seed in range(SEEDS)], axis=0)
        exact = probe.q_star(GAMMA)
        found = q[: exact.shape[0], : exact.shape[1]]
        if np.max(np.abs(found - exact)) > 0.05 * np.ptp([0, *exact.ravel()]):
            failed[probe.name] = found.round(3).tolist()
    return failed


def by_table(preset, **settings):
    """With a step size that falls with visits: every agent of the table, whatever its schedule on CartPole."""
    numbers = {"alpha_max": 1.0, "alpha_min": 0.0, "visit_power": 0.7, "epsilon_min": 0.5, "decay_coeff": 0.01}
    return wrong(preset, any_probe, np.arange(2), step_size="visits", **{**numbers, **settings})


@pytest.mark.parametrize("preset", [name for name in TABLES if name != THROUGH_DEATH])
def test_tabular_agents_solve_every_probe(preset):
    assert by_table(preset) == {}


def test_true_online_sarsa_solves_every_probe():
    assert by_table("sarsa-lambda", traces="dutch", trace_decay=0.9) == {}


def test_the_tutorials_bootstrap_through_death_fails_where_a_termination_matters():
    failed = by_table(THROUGH_DEATH)
    assert set(failed) == {"value_only", "observation", "discounting", "action", "both"}
    assert np.isclose(failed["value_only"][0][0], 1 / (1 - GAMMA), rtol=0.05)  # as if it never ended


def test_double_dqn_solves_every_probe():
    numbers = {"learning_rate": 0.01, "tau": 0.05, "epsilon_start": 0.5, "epsilon_end": 0.5, "weight_decay": 0.0}
    shapes = {"hidden": (16,), "batch_size": 32, "learning_starts": 32, "buffer_size": 1000, "clip": "none"}
    assert wrong("article-dqn", any_one_hot, np.eye(2), **numbers, **shapes, double=True) == {}
