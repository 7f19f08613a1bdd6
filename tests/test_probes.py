"""The probes are the MDPs that they say they are, and their answers are the solutions of those."""

from dataclasses import replace
from functools import cache, partial

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy import stats

from jaxq import policies
from jaxq.envs import auto_reset, one_hot, probes, value_iteration
from jaxq.envs.probes import TRUNCATED_AFTER, discounting
from jaxq.types import Env, Step

PROBES = {probe.name: probe for probe in probes()}

#: The same MDPs as tensors, written by hand. Each ends in a last state of its own, which the probes do not show.
LEAVE = [[0.0, 1.0]]
HAND = {
    "value_only": ([LEAVE, LEAVE], [[1.0], [0.0]]),
    "observation": ([[[0, 0, 1]]] * 3, [[1.0], [-1.0], [0.0]]),
    "discounting": ([[[0, 1, 0]], [[0, 0, 1]], [[0, 0, 1]]], [[0.0], [1.0], [0.0]]),
    "action": ([LEAVE * 2, LEAVE * 2], [[1.0, -1.0], [0.0, 0.0]]),
    "both": ([[[0, 0, 1]] * 2] * 3, [[1.0, -1.0], [-1.0, 1.0], [0.0, 0.0]]),
    "truncation": ([[[1, 0]], [[0, 1]]], [[1.0], [0.0]]),  # a truncation is no end
}


@pytest.fixture(params=PROBES, ids=str)
def probe(request):
    return PROBES[request.param]


@cache
def rollout(name, steps=48, lanes=80):
    """Uniform actions with auto-reset: observation before, action, Step; [lanes, steps]."""
    env = auto_reset(PROBES[name].env)

    def one(key):
        start, rest = jax.random.split(key)

        def body(state, words):  # JAX takes the keys of a scan in a vmap for used, so these are words
            choose, act = jax.random.split(jax.random.wrap_key_data(words))
            a = jax.random.randint(choose, (), 0, env.num_actions)
            after, happened = env.step(act, state, a)
            return after, (env.observe(state), a, happened)

        return jax.lax.scan(body, env.reset(start), jax.random.key_data(jax.random.split(rest, steps)))[1]

    return jax.tree.map(np.asarray, jax.jit(jax.vmap(one))(jax.random.split(jax.random.key(3), lanes)))


@pytest.mark.parametrize("gamma", [0.0, 0.5, 0.99])
def test_the_answer_is_the_solution_of_the_mdp_written_by_hand(probe, gamma):
    transition, reward = (np.array(x, float) for x in HAND[probe.name])
    terminal = np.arange(len(transition)) == len(transition) - 1
    answer = probe.q_star(gamma)
    assert answer.dtype == np.float64
    assert answer.shape == (probe.env.num_states, probe.env.num_actions)
    with jax.enable_x64(True):
        solved = value_iteration(transition, reward, gamma, terminal)
    np.testing.assert_allclose(answer, solved[:-1], rtol=1e-12, atol=1e-12)


def test_the_answers_by_hand():
    assert {name: one.q_star(0.75).tolist() for name, one in PROBES.items()} == {
        "value_only": [[1.0]],
        "observation": [[1.0], [-1.0]],
        "discounting": [[0.75], [1.0]],
        "action": [[1.0, -1.0]],
        "both": [[1.0, -1.0], [-1.0, 1.0]],
        "truncation": [[4.0]],
    }
    assert PROBES["truncation"].q_star(1.0).tolist() == [[np.inf]]


def test_its_transitions_are_those_of_the_mdp_written_by_hand(probe):
    transition, reward = (np.array(x, float) for x in HAND[probe.name])
    end = len(transition) - 1
    before, actions, happened = rollout(probe.name)
    true_successor = np.where(happened.terminated, end, happened.obs)
    assert np.all(transition[before, actions, true_successor] == 1)
    np.testing.assert_array_equal(happened.reward, reward[before, actions])
    seen = set(zip(before.ravel().tolist(), actions.ravel().tolist(), strict=True))
    assert seen == {(s, a) for s in range(end) for a in range(probe.env.num_actions)}


def test_a_learner_of_its_transitions_finds_the_answer_and_one_that_takes_the_flags_wrongly_does_not(probe):
    before, actions, happened = (jax.tree.map(np.ravel, x) for x in rollout(probe.name))

    def learn(continues, gamma=0.5):
        q = np.zeros((probe.env.num_states, probe.env.num_actions))
        for _ in range(60):  # every step is certain, so the last transition of a cell is as good as all
            q[before, actions] = happened.reward + gamma * continues * q[happened.obs].max(-1)
        return q

    np.testing.assert_allclose(learn(~happened.terminated), probe.q_star(0.5), atol=1e-12)
    through_death = learn(np.ones(len(before)))
    cut_as_death = learn(~(happened.terminated | happened.truncated))
    if probe.name == "truncation":
        # The cells' last transition may be any of the four: what is bootstrapped from is a mixture.
        assert cut_as_death[0, 0] < 2 - 1e-6
    else:
        assert np.abs(through_death - probe.q_star(0.5)).max() > 0.1


def test_flags_and_lengths_of_episodes(probe):
    _, _, happened = rollout(probe.name)
    t = np.arange(1, 49)
    length = {"discounting": 2, "truncation": TRUNCATED_AFTER}.get(probe.name, 1)
    over = np.broadcast_to(t % length == 0, (80, 48))
    truncates = probe.name == "truncation"
    np.testing.assert_array_equal(happened.truncated, over & truncates)
    np.testing.assert_array_equal(happened.terminated, over & (not truncates))


def test_truncation_does_not_show_the_step():
    before, _, happened = rollout("truncation")
    assert not before.any()
    assert not happened.obs.any()


@pytest.mark.parametrize("name", ["observation", "both"])
def test_starts_are_fair_and_independent_of_the_episode_before(name):
    before, _, _ = rollout(name)
    flat = before.ravel()
    assert stats.binomtest(int(flat.sum()), flat.size, 0.5).pvalue > 1e-3
    same = before[:, 1:] == before[:, :-1]
    assert stats.binomtest(int(same.sum()), same.size, 0.5).pvalue > 1e-3


@pytest.mark.parametrize("wrapped", [lambda env: env, one_hot, auto_reset], ids=["plain", "one_hot", "auto_reset"])
def test_shapes_and_dtypes_are_those_that_the_record_says_alone_in_a_scan_and_in_a_batch(probe, wrapped):
    env = wrapped(probe.env)
    key = jax.random.key(0)
    state = jax.eval_shape(env.reset, key)
    after, happened = jax.eval_shape(env.step, key, state, jnp.int32(0))

    def strip(tree):
        return jax.tree.map(lambda x: (x.shape, x.dtype), tree)

    assert strip(after) == strip(state)
    obs = ((), np.int32) if env.num_states else ((probe.env.num_states,), np.float32)
    assert strip(happened) == Step(obs, ((), np.float32), ((), np.bool_), ((), np.bool_))
    assert strip(jax.eval_shape(env.observe, state)) == obs
    assert env.obs_shape == obs[0]
    # A scan refuses a state whose type changes, weak types included.
    out = jax.eval_shape(
        jax.vmap(lambda s: jax.lax.scan(lambda s, k: env.step(k, s, jnp.int32(0)), s, jax.random.split(key, 3))),
        jax.eval_shape(jax.vmap(env.reset), jax.random.split(key, 5)),
    )[1]
    assert out.obs.shape == (5, 3, *env.obs_shape)


def test_one_action_is_one_that_policies_can_take():
    draw = jax.jit(jax.vmap(partial(policies.epsilon_greedy, q=jnp.zeros(1), epsilon=jnp.float32(0.5))))
    assert not draw(jax.random.split(jax.random.key(0), 100)).any()


def test_one_hot_is_the_row_of_the_observation():
    env = one_hot(discounting())
    assert (env.obs_shape, env.num_states, env.num_actions, env.deterministic) == ((2,), None, 1, True)
    start = env.reset(jax.random.key(0))
    assert env.observe(start).tolist() == [1.0, 0.0]
    middle, happened = env.step(jax.random.key(1), start, jnp.int32(0))
    assert env.observe(middle).tolist() == happened.obs.tolist() == [0.0, 1.0]
    assert (float(happened.reward), bool(happened.terminated)) == (0.0, False)
    _, happened = env.step(jax.random.key(2), middle, jnp.int32(0))
    assert (float(happened.reward), bool(happened.terminated)) == (1.0, True)


def test_one_hot_of_a_vector_is_an_error():
    env: Env = replace(discounting(), num_states=None, obs_shape=(4,))
    with pytest.raises(ValueError, match=r"^env: num_states is None, but one_hot needs .* not shape \(4,\)$"):
        one_hot(env)
