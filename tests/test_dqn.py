"""DQN: the update against PyTorch, against tabular Q-learning, and its properties one by one."""

import pathlib

import flax.linen as nn
import jax
import jax.numpy as jnp
import numpy as np
import optax
import pytest
from flax import nnx

from jaxq import networks, optimisers
from jaxq.agents import dqn
from jaxq.types import Clock, Transition

FIXTURE = pathlib.Path(__file__).parent / "reference" / "torch_updates.npz"
FIELDS = ("obs_tm1", "a_tm1", "r_t", "continues_t", "obs_t")
HYPERS = dqn.DQNHypers(
    learning_rate=1e-2,
    learning_rate_end=1e-2,
    anneal_updates=100,
    weight_decay=0.01,
    gamma=0.9,
    tau=0.1,
    target_period=1,
    epsilon_start=0.9,
    epsilon_end=0.05,
    epsilon_decay=1000.0,
    huber_delta=1.0,
    clip_at=100.0,
)


def make_batch(seed, size=16, obs_size=3, num_actions=2):
    rng = np.random.default_rng(seed)
    return Transition(
        obs_tm1=jnp.asarray(rng.normal(size=(size, obs_size)), jnp.float32),
        a_tm1=jnp.asarray(rng.integers(0, num_actions, size), jnp.int32),
        r_t=jnp.asarray(rng.normal(size=size), jnp.float32),
        continues_t=jnp.asarray(rng.random(size) > 0.2, jnp.float32),
        obs_t=jnp.asarray(rng.normal(size=(size, obs_size)), jnp.float32),
        cut_t=jnp.asarray(rng.random(size) > 0.7),
    )


def clock(env_steps=0, updates=0, live=1.0):
    return Clock(jnp.int32(env_steps), jnp.int32(0), jnp.int32(updates), jnp.float32(live))


def linear_apply(params, obs):
    return obs @ params


def assert_trees_close(actual, expected, **tolerance):
    jax.tree.map(lambda a, b: np.testing.assert_allclose(a, b, **tolerance), actual, expected)


def assert_same_bits(actual, expected):
    jax.tree.map(lambda a, b: np.testing.assert_array_equal(np.asarray(a), np.asarray(b)), actual, expected)


def make_agent(hypers=HYPERS, network=None, **structure):
    defaults = {"num_actions": 2, "batch_size": 8, "buffer_size": 32}
    return dqn.dqn(hypers, network=network or networks.mlp((16,), 2), **(defaults | structure))


def start(agent, seed=0, rows=16):
    """A state after warm-up, with the target moved away from the online network."""
    batch = make_batch(seed, size=rows)
    state = agent.init(jax.random.key(seed), jax.tree.map(lambda x: x[0], batch))
    state = state._replace(target=jax.tree.map(lambda x: x + 0.1, state.target))
    return agent.observe(state, jax.tree.map(lambda x: x[:, None], batch))


def experience(seed):
    return jax.tree.map(lambda x: x[:, None], make_batch(seed, size=2))


# --- the update alone


@pytest.mark.parametrize("setting", ["tutorial", "fast"])
def test_equals_pytorch_over_200_updates(setting):
    stored = np.load(FIXTURE)

    def params(prefix):
        names = ((f"{prefix}.{2 * i}.weight", f"{prefix}.{2 * i}.bias") for i in range(3))
        layers = [{"kernel": jnp.asarray(stored[w].T), "bias": jnp.asarray(stored[b])} for w, b in names]
        return {"params": {f"Linear_{i}": layer for i, layer in enumerate(layers)}}

    batches = {name: jnp.asarray(stored[name]) for name in FIELDS}
    optimiser = optax.chain(
        optax.clip(stored[f"{setting}.clip"]), optimisers.adamw(stored[f"{setting}.learning_rate"], 0.01)
    )

    def step(carry, index):
        batch = {name: values[index % values.shape[0]] for name, values in batches.items()}
        new = dqn.update(
            *carry,
            Transition(**batch, cut_t=batch["continues_t"] == 0),
            apply=networks.mlp((128, 128), 2).apply,
            optimiser=optimiser,
            gamma=0.99,
            tau=stored[f"{setting}.tau"],
            loss=optax.losses.huber_loss,
        )
        return (new.online, new.target, new.opt_state), new.metrics.loss

    initial, losses = params("initial"), stored[f"{setting}.losses"]
    carry = (initial, initial, optimiser.init(initial))
    (online, target, _), actual_losses = jax.jit(lambda c: jax.lax.scan(step, c, jnp.arange(len(losses))))(carry)
    assert_trees_close(online, params(f"{setting}.online"), rtol=0, atol=1e-4)
    assert_trees_close(target, params(f"{setting}.target"), rtol=0, atol=1e-4)
    np.testing.assert_allclose(actual_losses, losses, atol=1e-5)


def test_equals_numpy_on_one_batch():
    batch = make_batch(0)
    online, target = (np.random.default_rng(i).normal(size=(3, 2)).astype(np.float32) for i in (1, 2))
    for double in (False, True):
        new = dqn.update(
            jnp.asarray(online),
            jnp.asarray(target),
            optax.sgd(0.1).init(online),
            batch,
            apply=linear_apply,
            optimiser=optax.sgd(0.1),
            gamma=0.9,
            tau=0.25,
            double=double,
        )
        b = jax.tree.map(np.asarray, batch)
        rows = np.arange(len(b.r_t))
        q_tm1, q_t = b.obs_tm1 @ online, b.obs_t @ target
        selected = (b.obs_t @ online if double else q_t).argmax(axis=1)
        error = b.r_t + 0.9 * b.continues_t * q_t[rows, selected] - q_tm1[rows, b.a_tm1]
        gradient = np.zeros_like(online)
        for row in rows:
            gradient[:, b.a_tm1[row]] -= error[row] * b.obs_tm1[row] / len(rows)
        expected = online - 0.1 * gradient
        np.testing.assert_allclose(new.online, expected, atol=1e-6)
        np.testing.assert_allclose(new.target, 0.75 * target + 0.25 * expected, atol=1e-6)
        np.testing.assert_allclose(new.metrics.loss, np.mean(0.5 * error**2), rtol=1e-5)
        np.testing.assert_allclose(new.metrics.max_q, q_t.max(axis=1).mean(), rtol=1e-5)


class LinenNetwork(nn.Module):
    @nn.compact
    def __call__(self, obs):
        hidden = nn.tanh(nn.Dense(8)(obs))
        return nn.Dense(2)(hidden)


class NnxNetwork(nnx.Module):
    def __init__(self, rngs):
        self.first, self.second = nnx.Linear(3, 8, rngs=rngs), nnx.Linear(8, 2, rngs=rngs)

    def __call__(self, obs):
        return self.second(nnx.tanh(self.first(obs)))


def any_network(kind):
    """(apply, params) of the same function: an nnx module split into state, a flax module, a plain function."""
    graph, state = nnx.split(NnxNetwork(nnx.Rngs(0)))
    if kind == "nnx":
        return lambda state, obs: nnx.merge(graph, state)(obs), state
    layers = [
        {"kernel": jnp.array(layer.kernel[...]), "bias": jnp.array(layer.bias[...])}
        for layer in (nnx.merge(graph, state).first, nnx.merge(graph, state).second)
    ]
    if kind == "linen":
        return LinenNetwork().apply, {"params": {"Dense_0": layers[0], "Dense_1": layers[1]}}

    def plain(layers, obs):
        return jnp.tanh(obs @ layers[0]["kernel"] + layers[0]["bias"]) @ layers[1]["kernel"] + layers[1]["bias"]

    return plain, layers


@pytest.mark.parametrize("kind", ["linen", "nnx"])
def test_any_apply_fits(kind):
    def train(apply, params):
        optimiser = optimisers.adamw(0.01, 0.01)
        new = (params, params, optimiser.init(params))
        for seed in range(3):
            new = dqn.update(*new[:3], make_batch(seed), apply=apply, optimiser=optimiser, gamma=0.9, tau=0.5)
        assert jax.tree.structure(new.online) == jax.tree.structure(params)
        return [apply(p, make_batch(9).obs_t[0]) for p in (new.online, new.target)], new.metrics

    assert_trees_close(train(*any_network(kind)), train(*any_network("plain")), rtol=1e-5, atol=1e-6)


def test_gradient_flows_through_the_online_values_of_the_left_state_only():
    batch = make_batch(0)._replace(obs_tm1=jnp.zeros((16, 3)))
    params = {"kernel": jnp.ones((3, 2)), "bias": jnp.array([0.5, -0.5])}

    def apply(params, obs):
        return obs @ params["kernel"] + params["bias"]

    for double in (False, True):
        new = dqn.update(
            params,
            params,
            optax.sgd(1.0).init(params),
            batch,
            apply=apply,
            optimiser=optax.sgd(1.0),
            gamma=0.9,
            tau=0.0,
            double=double,
        )
        # obs_tm1 is 0, so any change of the kernel would have come through obs_t.
        assert_same_bits(new.online["kernel"], params["kernel"])
        assert np.abs(new.online["bias"] - params["bias"]).min() > 1e-3
        assert_same_bits(new.target, params)


def update_linear(batch, online=None, target=None, **changes):
    online = jnp.ones((3, 2)) * jnp.array([1.0, -0.5]) if online is None else online
    arguments = {"apply": linear_apply, "optimiser": optax.sgd(0.1), "gamma": 0.9, "tau": 0.1} | changes
    target = online if target is None else target
    return dqn.update(online, target, optax.sgd(0.1).init(online), batch, **arguments)


def test_double_with_equal_networks_is_greedy():
    batch = make_batch(1)
    assert_same_bits(update_linear(batch, double=True), update_linear(batch, double=False))
    other = jnp.ones((3, 2)) * jnp.array([-0.5, 1.0])
    different = [update_linear(batch, target=other, double=double).online for double in (True, False)]
    assert np.abs(different[0] - different[1]).max() > 1e-3


def test_tau_one_copies_and_tau_zero_keeps():
    online, target = jax.random.normal(jax.random.key(0), (2, 3, 2)) * jnp.array([[[1e-3]], [[1e3]]])
    new = update_linear(make_batch(1), online=online, target=target, tau=1.0)
    assert_same_bits(new.target, new.online)
    assert_same_bits(update_linear(make_batch(1), online=online, target=target, tau=0.0).target, target)


def test_truncation_bootstraps_and_termination_does_not():
    batch = make_batch(2)._replace(continues_t=jnp.ones(16))
    further = batch._replace(obs_t=batch.obs_t + 1)
    for cut in (True, False):
        cuts = {"cut_t": jnp.full(16, cut)}
        assert_same_bits(update_linear(batch._replace(**cuts)), update_linear(batch))
        moved = update_linear(further._replace(**cuts)).online - update_linear(batch).online
        assert np.abs(moved).max() > 1e-3
    ended, ended_further = (b._replace(continues_t=jnp.zeros(16)) for b in (batch, further))
    assert_same_bits(update_linear(ended).online, update_linear(ended_further).online)


# --- the learner


def test_a_table_network_is_tabular_q_learning():
    """One-hot observations, no hidden layer, SGD, a replay of one transition and tau 1."""
    num_states, alpha, gamma = 5, 0.3, 0.9
    table_network = networks.Network(
        init=lambda key, obs: jnp.zeros((num_states, 2)), apply=lambda table, obs: obs @ table
    )
    agent = make_agent(
        HYPERS._replace(learning_rate=alpha, learning_rate_end=alpha, gamma=gamma, tau=1.0),
        network=table_network,
        batch_size=1,
        buffer_size=1,
        loss="squared",
        optimiser=lambda learning_rate, weight_decay: optax.sgd(learning_rate),
    )
    rng, eye = np.random.default_rng(0), np.eye(num_states, dtype=np.float32)
    table = np.zeros((num_states, 2))
    rows = [
        (rng.integers(num_states), rng.integers(2), rng.normal(), rng.random() > 0.2, rng.integers(num_states))
        for _ in range(100)
    ]

    def as_transition(s, a, r, continues, successor):
        return Transition(
            eye[s], np.int32(a), np.float32(r), np.float32(continues), eye[successor], np.bool_(not continues)
        )

    state = agent.init(jax.random.key(0), as_transition(*rows[0]))
    learn = jax.jit(agent.update)
    for index, (s, a, r, continues, successor) in enumerate(rows):
        one = jax.tree.map(lambda x: jnp.asarray(x)[None, None], as_transition(s, a, r, continues, successor))
        state, metrics = learn(jax.random.key(index), state, one, clock(updates=index))
        best = table[successor].max()
        error = r + gamma * continues * best - table[s, a]
        table[s, a] += alpha * error
        np.testing.assert_allclose(state.online, table, atol=1e-5)
        np.testing.assert_allclose(metrics.loss, 0.5 * error**2, atol=1e-5)
        np.testing.assert_allclose(metrics.max_q, best, atol=1e-5)


@pytest.mark.parametrize("clip", ["value", "norm", "none"])
@pytest.mark.parametrize("double", [False, True])
def test_an_ended_lane_stands_still_to_the_bit(clip, double):
    agent = make_agent(HYPERS._replace(tau=0.5, weight_decay=0.9), clip=clip, double=double)
    learn = jax.jit(agent.update)
    state = start(agent)
    for index in range(3):
        state, _ = learn(jax.random.key(index), state, experience(index), clock(updates=index))
    ended = state
    for index in range(3):
        ended, _ = learn(jax.random.key(index), ended, experience(index), clock(updates=3, live=0.0))
        assert_same_bits((ended.online, ended.target), (state.online, state.target))
    alive, _ = learn(jax.random.key(0), state, experience(0), clock(updates=3))
    for before, after in zip(jax.tree.leaves(state.online), jax.tree.leaves(alive.online), strict=True):
        assert not np.array_equal(before, after)


def test_target_moves_every_period():
    agent = make_agent(HYPERS._replace(tau=1.0, target_period=3))
    learn = jax.jit(agent.update)
    state = start(agent)
    for updates in range(7):
        before = state
        state, _ = learn(jax.random.key(updates), state, experience(updates), clock(updates=updates))
        assert_same_bits(state.target, state.online if updates % 3 == 0 else before.target)


def test_learning_rate_anneals_to_its_end():
    def moved(updates, **changes):
        agent = make_agent(
            HYPERS._replace(**changes),
            optimiser=lambda learning_rate, weight_decay: optax.sgd(learning_rate),
        )
        before = start(agent)
        after, _ = agent.update(jax.random.key(0), before, experience(0), clock(updates=updates))
        return jax.tree.map(jnp.subtract, after.online, before.online)

    full = moved(0)
    half = moved(50, learning_rate_end=0.0)
    assert_trees_close(half, jax.tree.map(lambda x: 0.5 * x, full), rtol=1e-3, atol=1e-6)
    assert_trees_close(moved(500, learning_rate_end=0.0), jax.tree.map(jnp.zeros_like, full), atol=0)


def test_update_stores_then_samples_the_new_transitions():
    agent = make_agent(batch_size=2, buffer_size=2)
    state = start(agent, rows=2)
    new, _ = agent.update(jax.random.key(0), state, experience(5), clock())
    observed = agent.observe(state, experience(5))
    assert_same_bits(new.replay, observed.replay)
    assert_same_bits(observed.replay.storage, make_batch(5, size=2))
    assert_same_bits(observed._replace(replay=None), state._replace(replay=None))
    direct = dqn.update(
        state.online,
        state.target,
        state.opt_state,
        make_batch(5, size=2),
        apply=agent.q_values,
        optimiser=optimisers.adamw(HYPERS.learning_rate, HYPERS.weight_decay),
        gamma=HYPERS.gamma,
        tau=HYPERS.tau,
        loss=optax.losses.huber_loss,
    )
    assert_trees_close(new.online, direct.online, rtol=1e-5, atol=1e-6)


def test_experience_of_many_steps_and_environments_is_flattened_in_order_of_time():
    agent = make_agent()
    batch = make_batch(0, size=6)
    state = agent.init(jax.random.key(0), jax.tree.map(lambda x: x[0], batch))
    state = agent.observe(state, jax.tree.map(lambda x: x.reshape(3, 2, *x.shape[1:]), batch))
    assert int(state.replay.size) == 6
    assert_same_bits(jax.tree.map(lambda x: x[:6], state.replay.storage), batch)


def test_vmapped_lanes_equal_single_ones():
    def train(seed, learning_rate, gamma):
        agent = make_agent(HYPERS._replace(learning_rate=learning_rate, gamma=gamma), clip="norm", double=True)
        batch = make_batch(0)
        state = agent.init(jax.random.key(seed), jax.tree.map(lambda x: x[0], batch))
        state = agent.observe(state, jax.tree.map(lambda x: x[:, None], batch))

        def learn(state, given):
            index, one = given
            return agent.update(jax.random.key(10 * seed + index), state, one, clock(updates=index))

        each = jax.tree.map(lambda *leaves: jnp.stack(leaves), *map(experience, range(3)))
        return jax.lax.scan(learn, state, (np.arange(3), each))

    settings = (jnp.arange(3), jnp.array([1e-2, 1e-3, 0.0]), jnp.array([0.9, 0.5, 0.99]))
    lanes = jax.jit(jax.vmap(train))(*settings)
    for lane in range(3):
        single = jax.jit(train)(*(column[lane] for column in settings))
        assert_trees_close(jax.tree.map(lambda x, lane=lane: x[lane], lanes), single, rtol=1e-4, atol=1e-6)


def learned(**changes):
    structure = {name: changes.pop(name) for name in ("loss", "clip", "double") if name in changes}
    agent = make_agent(HYPERS._replace(**changes), **structure, optimiser=lambda rate, _: optax.sgd(rate))
    return agent.update(jax.random.key(0), start(agent), experience(0), clock())[0].online


def test_huber_is_squared_where_errors_are_small():
    assert_trees_close(learned(loss="huber", huber_delta=1e3), learned(loss="squared"), rtol=1e-5, atol=1e-7)
    small, squared = learned(loss="huber", huber_delta=1e-2), learned(loss="squared")
    assert max(jax.tree.leaves(jax.tree.map(lambda a, b: float(jnp.abs(a - b).max()), small, squared))) > 1e-4


def test_clips_bound_the_gradient_in_their_own_norm():
    rate, at = HYPERS.learning_rate, 1e-3
    agent = make_agent()
    before = start(agent).online

    def gradient(**changes):
        steps = jax.tree.map(lambda a, b: (b - a) / rate, learned(**changes), before)
        return np.concatenate([np.ravel(x) for x in jax.tree.leaves(steps)])

    free = gradient(clip="none")
    assert np.abs(free).max() > 2 * at
    np.testing.assert_allclose(gradient(clip="value", clip_at=at), np.clip(free, -at, at), atol=2e-5)
    np.testing.assert_allclose(gradient(clip="norm", clip_at=at), free * at / np.linalg.norm(free), atol=2e-5)
    for clip in ("value", "norm"):
        np.testing.assert_allclose(gradient(clip=clip, clip_at=1e3), free, atol=2e-5)


@pytest.mark.parametrize(("schedule", "steps", "epsilon"), [("exponential", 700, None), ("linear", 500, 0.475)])
def test_acting_is_epsilon_greedy_on_the_environment_steps(schedule, steps, epsilon):
    """With 4 actions the greedy one has share 1 - epsilon + epsilon / 4."""
    epsilon = 0.05 + 0.85 * np.exp(-steps / 1000) if epsilon is None else epsilon
    network = networks.mlp((16,), 4)
    agent = make_agent(network=network, num_actions=4, epsilon_schedule=schedule)
    state, obs = start(agent), jnp.ones(3)
    keys = jax.random.split(jax.random.key(1), 20_000)
    actions = jax.jit(jax.vmap(lambda key: agent.act(key, state, obs, clock(env_steps=steps))))(keys)
    share = np.bincount(actions, minlength=4) / len(actions)
    best = int(jnp.argmax(agent.q_values(agent.policy(state), obs)))
    expected = np.full(4, epsilon / 4)
    expected[best] += 1 - epsilon
    assert np.abs(share - expected).max() < 5 * np.sqrt(0.25 / len(actions))


def test_policy_is_the_online_network():
    agent = make_agent()
    state = start(agent)
    assert_same_bits(agent.policy(state), state.online)
    fresh = agent.init(jax.random.key(3), jax.tree.map(lambda x: x[0], make_batch(0)))
    assert_same_bits(fresh.online, fresh.target)


@pytest.mark.parametrize(
    ("structure", "message"),
    [
        ({"loss": "l1"}, "loss must be one of huber, squared, got 'l1'"),
        ({"clip": "all"}, "clip must be one of value, norm, none, got 'all'"),
        ({"epsilon_schedule": "cosine"}, "epsilon_schedule must be one of exponential, linear, got 'cosine'"),
        ({"batch_size": 33}, "batch_size must be between 1 and the capacity 32, got 33"),
    ],
)
def test_unknown_structure_is_refused(structure, message):
    with pytest.raises(ValueError, match=message):
        make_agent(**structure)


def test_a_network_of_another_width_is_refused():
    agent = make_agent(num_actions=3)
    with pytest.raises(ValueError, match=r"shape \(3,\), got \(2,\)"):
        agent.init(jax.random.key(0), jax.tree.map(lambda x: x[0], make_batch(0)))
