"""FrozenLake, CliffWalking and Taxi are Gymnasium's tables, outcome by outcome, and are walked on as there."""

import gymnasium
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy import stats

import jaxq
from jaxq import cli, envs, worlds
from jaxq.envs import Outcomes, auto_reset, outcome_mdp, policy_evaluation, stationary_distribution, value_iteration
from jaxq.envs.mdp import MDPState
from jaxq.envs.outcomes import as_mdp
from jaxq.worlds import CartPole, CliffWalking, FrozenLake, FrozenLake8x8, Taxi

pytestmark = pytest.mark.usefixtures("programs_are_compiled_once")

CASES = [
    *((kind, {"is_slippery": slips}) for kind in (FrozenLake, FrozenLake8x8, CliffWalking) for slips in (False, True)),
    (FrozenLake, {"success_rate": 0.8}),
    (Taxi, {"is_rainy": False}),
    (Taxi, {"is_rainy": True}),
    (Taxi, {"is_rainy": True, "rainy_probability": 0.5}),
]
WORLDS = pytest.mark.parametrize("world", [kind(**options) for kind, options in CASES], ids=lambda w: repr(w)[:60])
ZERO = jnp.zeros((), jnp.int32)


def theirs(world):
    """Gymnasium's environment with the world's numbers."""
    names = {"is_slippery", "success_rate", "is_rainy", "rainy_probability"}
    if isinstance(world, CliffWalking):
        names = {"is_slippery"}
    return gymnasium.make(world.id, **{name: value for name, value in world.flat().items() if name in names})


def reachable(env):
    """States in which an episode of Gymnasium's table can be."""
    inner = env.unwrapped
    fresh = set(np.flatnonzero(inner.initial_state_distrib).tolist())
    found = set()
    while fresh:
        found |= fresh
        fresh = {
            int(s)
            for state in fresh
            for rows in inner.P[state].values()
            for p, s, _, ends in rows
            if p > 0 and not ends and s not in found
        }
    return sorted(found)


def after_action(env, s, action, count=4000):
    """Steps from one state, each with a key of its own."""
    keys = jax.random.split(jax.random.key(s), count)
    return jax.vmap(lambda key: env.step(key, MDPState(jnp.int32(s), ZERO), action))(keys)[1]


@WORLDS
def test_outcomes_come_as_often_as_gymnasiums_table_says(world):
    env, gym = envs.make(world.id, **dict(world)), theirs(world)
    draws = 2000 if not env.deterministic else 1
    states = np.array(reachable(gym))[:: 1 if len(reachable(gym)) < 100 else 7]
    cells = [(s, a) for s in states.tolist() for a in range(env.num_actions)]

    @jax.jit
    def outcomes(keys, s, a):
        def one(key):
            after, happened = env.step(key, MDPState(s, ZERO), a)
            return after.s, happened.reward, happened.terminated

        return jax.vmap(one)(keys)

    keys = jax.random.split(jax.random.key(1), len(cells) * draws).reshape(len(cells), draws)
    found = jax.vmap(outcomes)(keys, *(jnp.array(column, jnp.int32) for column in zip(*cells, strict=True)))
    found = [np.asarray(column) for column in found]
    p_values = []
    for i, (s, a) in enumerate(cells):
        table = {}
        for p, successor, reward, ends in gym.unwrapped.P[s][a]:
            outcome = (int(successor), float(reward), bool(ends))
            table[outcome] = table.get(outcome, 0) + p
        rows = [tuple(row) for row in zip(*(column[i].tolist() for column in found), strict=True)]
        assert set(rows) <= {outcome for outcome, p in table.items() if p > 0}, f"state {s}, action {a}"
        if len(table) > 1:
            counts = [rows.count(outcome) for outcome in table]
            p_values.append(stats.chisquare(counts, draws * np.array(list(table.values()))).pvalue)
    if p_values:
        assert min(p_values) > 1e-3 / len(p_values)


@WORLDS
def test_the_exact_arrays_are_gymnasiums_table_where_an_episode_can_be(world):
    gym, mdp = theirs(world), envs.exact(world)
    assert mdp.transition.dtype == mdp.reward.dtype == np.float64
    np.testing.assert_array_equal(mdp.start, gym.unwrapped.initial_state_distrib)
    np.testing.assert_allclose(mdp.transition.sum(-1), 1, atol=1e-15)
    for s in reachable(gym):
        assert not mdp.terminal[s]
        for a, rows in gym.unwrapped.P[s].items():
            expected, mean = np.zeros(len(mdp.start)), 0.0
            for p, successor, reward, ends in rows:
                expected[successor] += p
                mean += p * reward
                assert p == 0 or mdp.terminal[successor] == ends
            np.testing.assert_allclose(mdp.transition[s, a], expected, atol=1e-15)
            assert mdp.reward[s, a] == pytest.approx(mean, abs=1e-13)


@pytest.mark.parametrize("world", [FrozenLake(is_slippery=False), CliffWalking(), Taxi()], ids=str)
def test_whole_episodes_equal_gymnasiums_step_by_step(world):
    env = envs.make(world.id, **dict(world))
    step = jax.jit(env.step)
    rng = np.random.default_rng(0)
    limits = set()
    for seed in range(4):
        gym = theirs(world)
        obs, _ = gym.reset(seed=seed)
        state, over, t = MDPState(jnp.int32(obs), ZERO), False, 0
        while not over and t < 400:
            action = int(rng.integers(env.num_actions))
            obs, reward, terminated, truncated, _ = gym.step(action)
            state, happened = step(jax.random.key(0), state, action)
            t += 1
            assert (int(happened.obs), float(happened.reward)) == (obs, reward)
            assert (bool(happened.terminated), bool(happened.truncated)) == (terminated, truncated)
            over = terminated or truncated
            limits |= {t} if truncated else set()
    assert limits == ({200} if isinstance(world, Taxi) else set())


@pytest.mark.parametrize("world", [FrozenLake(), Taxi()], ids=str)
def test_a_reset_is_one_of_gymnasiums_first_states_equally_likely(world):
    env, gym = envs.make(world.id), theirs(world)
    keys = jax.random.split(jax.random.key(0), 30_000)
    counts = np.bincount(np.asarray(jax.vmap(env.reset)(keys).s), minlength=env.num_states)
    likely = gym.unwrapped.initial_state_distrib
    assert not np.any(counts[likely == 0])
    if np.sum(likely > 0) > 1:
        assert stats.chisquare(counts[likely > 0]).pvalue > 1e-3


def test_limits_and_rewards_are_numbers_that_may_be_batched():
    def told(rate, goal, hole, ice, limit):
        params = envs.FrozenLakeParams(rate, goal, hole, ice, limit)
        env = envs.frozen_lake(params)
        # State 14 is left of the goal, 6 between two holes; with rate 1 action 2 goes to the right.
        happened = [env.step(jax.random.key(0), MDPState(jnp.int32(s), jnp.int32(3)), 2)[1] for s in (14, 4, 9)]
        return [(h.obs, h.reward, h.terminated, h.truncated) for h in happened]

    ones = jnp.ones(2)
    goal, hole, ice = jax.vmap(told)(ones, 5 * ones, -3 * ones, -0.5 * ones, jnp.array([4, 5]))
    assert [np.asarray(x).tolist() for x in goal] == [[15, 15], [5, 5], [True, True], [True, False]]
    assert [np.asarray(x).tolist() for x in hole] == [[5, 5], [-3, -3], [True, True], [True, False]]
    assert [np.asarray(x).tolist() for x in ice] == [[10, 10], [-0.5, -0.5], [False, False], [True, False]]


# Exact values


def test_value_iteration_finds_the_known_answers():
    """The shortest walks, counted on the maps: 6 steps to the goal, 13 along the cliff."""
    for world, gamma, steps, last, each in (
        (FrozenLake(is_slippery=False), 0.9, 6, 1.0, 0.0),
        (CliffWalking(), 1.0, 13, -1.0, -1.0),
    ):
        mdp = envs.exact(world)
        q = value_iteration(mdp.transition, mdp.reward, gamma, mdp.terminal)
        expected = sum(each * gamma**t for t in range(steps - 1)) + last * gamma ** (steps - 1)
        assert float(mdp.start @ np.asarray(q).max(1)) == pytest.approx(expected, rel=1e-6)


def test_the_values_of_a_policy_are_the_mean_of_gymnasiums_returns():
    world, gamma = FrozenLake(success_rate=0.7), 0.95
    mdp, gym = envs.exact(world), theirs(world)
    q = np.asarray(value_iteration(mdp.transition, mdp.reward, gamma, mdp.terminal))
    policy = 0.7 * np.eye(4)[q.argmax(1)] + 0.3 / 4
    values = np.asarray(policy_evaluation(mdp.transition, mdp.reward, gamma, policy, mdp.terminal))
    rng, returns = np.random.default_rng(0), []
    gym = gym.unwrapped  # without a time limit, as the exact values are
    gym.reset(seed=0)
    for _ in range(3000):
        s, _ = gym.reset()
        weight, total, over = 1.0, 0.0, False
        while not over:
            s, reward, over, _, _ = gym.step(int(rng.choice(4, p=policy[s])))
            total += weight * reward
            weight *= gamma
        returns.append(total)
    expected = float(mdp.start @ (policy * values).sum(1))
    error = np.std(returns) / np.sqrt(len(returns))
    assert 0.2 < expected < 0.9
    assert abs(np.mean(returns) - expected) < 4 * error


@pytest.mark.parametrize(
    "world", [FrozenLake(), FrozenLake(is_slippery=False), CliffWalking()], ids=lambda w: repr(w)[:40]
)
def test_the_stationary_distribution_is_how_often_gymnasium_is_where(world):
    mdp, gym = envs.exact(world), theirs(world).unwrapped
    rng = np.random.default_rng(3)
    num_states, num_actions = mdp.reward.shape
    policy = rng.dirichlet(np.ones(num_actions), num_states)
    with jax.enable_x64(True):
        d = np.asarray(stationary_distribution(mdp.transition, policy, mdp.terminal, mdp.start))
    # The linear equations themselves, in NumPy: what flows into a state is what is there.
    flow = np.zeros(num_states)
    for s in range(num_states):
        for a in range(num_actions):
            share = d[s] * policy[s, a] * mdp.transition[s, a]
            flow += np.where(mdp.terminal, 0, share) + share[mdp.terminal].sum() * mdp.start
    np.testing.assert_allclose(flow, d, atol=1e-12)
    assert d.sum() == pytest.approx(1, abs=1e-12)
    assert np.all(d[mdp.terminal] == 0)
    visits, choices = np.zeros(num_states), rng.random(40_000)
    s, _ = gym.reset(seed=0)
    for u in choices:
        visits[s] += 1
        s, _, over, _, _ = gym.step(int((u > np.cumsum(policy[s])[:-1]).sum()))
        if over:
            s, _ = gym.reset()
    assert 0.5 * np.abs(visits / len(choices) - d).sum() < 0.05


def test_what_determines_no_distribution_is_nan_and_halves_are_refused():
    two_islands = np.eye(2)[:, None, :]
    assert np.all(np.isnan(stationary_distribution(two_islands, np.ones((2, 1)))))
    with pytest.raises(ValueError, match="start: an MDP with terminal states needs it"):
        stationary_distribution(two_islands, np.ones((2, 1)), terminal=np.array([False, True]))


def test_distributions_of_a_batch_are_those_of_each():
    mdp = envs.exact(FrozenLake())
    policies = np.random.default_rng(0).dirichlet(np.ones(4), (3, 16)).astype(np.float32)
    each = [stationary_distribution(mdp.transition, one, mdp.terminal, mdp.start) for one in policies]
    batch = jax.jit(jax.vmap(lambda pi: stationary_distribution(mdp.transition, pi, mdp.terminal, mdp.start)))(policies)
    np.testing.assert_allclose(batch, np.stack(each), atol=1e-6)


def test_two_states_have_the_values_worked_out_by_hand():
    """p = 1/2, gamma = 1/2: rich is worth 1 / (1 - 1/2) = 2, poor 1/2 * 2 / (1 - 1/4) = 4/3."""
    answer = envs.two_states_q_star(0.5, 0.5)
    np.testing.assert_allclose(answer, [[2 / 3, 4 / 3], [2, 4 / 3]], rtol=1e-6)
    for p, gamma in ((0.5, 0.5), (0.1, 0.9), (1.0, 0.3), (0.0, 0.7)):
        cross = [[1 - p, p], [p, 1 - p]]
        transition = np.stack([np.eye(2), cross], 1)
        reward = np.broadcast_to([0.0, 1.0], (2, 2, 2))
        with jax.enable_x64(True):
            expected = value_iteration(transition, reward, gamma)
        np.testing.assert_allclose(envs.two_states_q_star(p, gamma), expected, rtol=1e-6, atol=1e-7)
        for s in (0, 1):
            after = after_action(envs.two_states(p), s, 1)
            assert abs(float(jnp.mean(after.obs != s)) - p) < 0.04
            np.testing.assert_array_equal(after.reward, after.obs)


def test_two_states_begin_poor_and_end_at_their_limit_alone():
    env = envs.two_states(1.0, max_episode_steps=3)
    state = env.reset(jax.random.key(0))
    assert int(env.observe(state)) == 0
    told = []
    for k in range(3):
        state, happened = env.step(jax.random.key(k), state, 1)
        told.append((int(happened.obs), bool(happened.terminated), bool(happened.truncated)))
    assert told == [(1, False, False), (0, False, False), (1, False, True)]
    with pytest.raises(ValueError, match=r"^p: 1.5 is not allowed: from 0 to 1$"):
        envs.two_states(1.5)


# Learners


def test_tables_and_networks_learn_the_exact_values():
    swept = jaxq.sweep(
        "q-learning",
        env="FrozenLake-v1",
        **{"env.is_slippery": False, "env.max_episode_steps": 10_000},
        gamma=0.9,
        seeds=4,
        stop="none",
        epsilon_min=1.0,
        alpha_min=0.5,
        max_env_steps=60_000,
        max_episodes=10**6,
    )
    mdp = envs.exact(FrozenLake(is_slippery=False))
    expected = np.asarray(value_iteration(mdp.transition, mdp.reward, 0.9, mdp.terminal))
    for seed in range(4):
        values = swept.policy(0, seed).q_values(np.arange(16))
        np.testing.assert_allclose(values, expected, atol=1e-4)
    network = jaxq.sweep(
        "dqn",
        env="FrozenLake-v1",
        **{"env.is_slippery": False},
        gamma=0.9,
        seeds=2,
        hidden=(16,),
        max_env_steps=12_000,
        epsilon_decay=10_000,
        learning_rate=5e-3,
        stop="none",
        eval_episodes=2,
    )
    assert network.lanes["eval_return"].to_pylist() == [1.0, 1.0]
    policy = network.policy(0, 0)
    assert policy.about["num_states"] == 16
    on_the_way = expected.max(1) > 0
    np.testing.assert_allclose(policy.q_values(np.arange(16)).max(1)[on_the_way], expected.max(1)[on_the_way], atol=0.2)


@pytest.mark.parametrize(
    ("preset", "values", "said"),
    [
        (
            "q-learning",
            {"env": "MountainCar-v0", "velocity_bound": 0.3},
            "velocity_bound: 0.3 is not allowed: MountainCar-v0",
        ),
        ("q-learning", {"env": "MountainCar-v0", "num_buckets": (1, 1, 6, 3)}, "too many values, MountainCar-v0 has 2"),
        ("q-learning", {"env": "FrozenLake-v1", "env.success_rate": 1.5}, "env.success_rate: 1.5 is not allowed"),
        ("q-learning", {"env": "FrozenLake-v2"}, "did you mean 'FrozenLake-v1'"),
        ("q-learning", {"env": "Taxi-v4", "env.is_slippery": True}, "env.is_slippery"),
    ],
)
def test_what_a_world_cannot_be_is_one_line(preset, values, said):
    with pytest.raises(ValueError, match=r"^\w") as error:
        jaxq.plan(preset, **values)
    assert said in str(error.value)
    assert "\n" not in str(error.value)


def test_presets_for_cartpole_suit_other_worlds():
    settled = {w: jaxq.plan("q-learning", env=w).settings[0] for w in worlds.WORLDS}
    assert {w: one.stop for w, one in settled.items()} == {
        w: "streak" if w == "CartPole-v1" else "none" if kind.reward_threshold is None else "gymnasium"
        for w, kind in worlds.WORLDS.items()
    }
    assert settled["CartPole-v1"].num_buckets == (1, 1, 6, 3)
    assert settled["MountainCar-v0"].num_buckets == worlds.MountainCar.buckets
    assert jaxq.plan("q-learning", env="Taxi-v4", stop="streak").settings[0].stop == "streak"
    assert jaxq.plan("article-dqn", env="Acrobot-v1").settings[0].stop == "gymnasium"


# Outcomes


def one_outcome():
    zero = np.zeros((2, 1, 1), np.int32)
    return Outcomes(np.ones((2, 1, 1), np.int32), zero, zero == 1)


@pytest.mark.parametrize(
    ("changes", "probability", "rewards", "starts", "said"),
    [
        ({"successor": np.full((2, 1, 1), 2)}, np.ones(1), np.ones(1), np.array([0]), "successor: [2] is not allowed"),
        ({"reward": np.full((2, 1, 1), 1)}, np.ones(1), np.ones(1), np.array([0]), "reward: [1] is not allowed"),
        ({"reward": np.zeros((2, 1))}, np.ones(1), np.ones(1), np.array([0]), "reward: shape (2, 1) is not allowed"),
        ({}, np.array([0.5]), np.ones(1), np.array([0]), "probability: probabilities sum to 0.5"),
        ({}, np.ones(2), np.ones(1), np.array([0]), "probability: shape (2,) is not allowed"),
        ({}, np.ones(1), np.ones(1), np.array([-1]), "starts: [-1] is not allowed"),
        ({}, np.ones(1), np.ones(1), np.array([], int), "starts: [] is not allowed"),
        ({"successor": np.ones(3)}, np.ones(1), np.ones(1), np.array([0]), "successor: shape (3,) is not allowed"),
    ],
)
def test_outcomes_that_do_not_fit_are_refused(changes, probability, rewards, starts, said):
    with pytest.raises(ValueError, match=r"^\w") as error:
        outcome_mdp(one_outcome()._replace(**changes), probability, rewards, starts)
    assert said in str(error.value)


def test_an_end_that_belongs_to_the_transition_alone_has_no_arrays():
    """State 1 is entered with an end by action 0 and without one by action 1."""
    successor = np.ones((2, 2, 1), np.int32)
    ends = np.array([[[True], [False]], [[True], [True]]])
    outcomes = Outcomes(successor, np.zeros_like(successor), ends)
    env = outcome_mdp(outcomes, np.ones(1), np.ones(1), np.array([0]))
    flags = [bool(env.step(jax.random.key(0), MDPState(ZERO, ZERO), a)[1].terminated) for a in (0, 1)]
    assert flags == [True, False]
    with pytest.raises(ValueError, match=r"outcomes: \[0, 1, 0\] enters a state that ends other episodes"):
        as_mdp(outcomes, np.ones(1), np.ones(1), np.array([0]))


def test_probabilities_may_differ_between_states():
    successor = np.broadcast_to(np.array([0, 1], np.int32), (2, 1, 2))
    zero = np.zeros((2, 1, 2), np.int32)
    likely = np.array([[[0.9, 0.1]], [[0.2, 0.8]]])
    env = auto_reset(outcome_mdp(Outcomes(successor, zero, zero == 1), likely, np.zeros(1), np.array([0, 1])))
    for s in (0, 1):
        after = after_action(env, s, 0)
        assert float(jnp.mean(after.obs)) == pytest.approx(likely[s, 0, 1], abs=0.03)


def test_a_world_that_is_not_finite_has_no_arrays():
    with pytest.raises(ValueError, match="world: CartPole-v1 is not allowed: FrozenLake"):
        envs.exact(CartPole())


def test_training_a_finite_world_prints_a_row_per_state(tmp_path, capsys):
    words = ["--env", "FrozenLake-v1", "--max-episodes", "20", "--out", str(tmp_path / "run"), "--quiet"]
    assert cli.main(["train", "q-learning", *words]) == 0
    said = capsys.readouterr().out
    table = said.partition("final Q-table")[2].partition("]]")[0]
    assert table.count("\n") == 16
    assert table.count(".") == 16 * 4


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ({"successor": np.full((1, 1, 1), 0.5)}, "successor: float64 is not allowed: whole numbers"),
        ({"terminated": np.full((1, 1, 1), 5)}, "terminated: int64 is not allowed: bool"),
        ({"rewards": np.array([np.nan])}, "rewards: .* is not allowed: finite numbers"),
        ({"rewards": 1.0}, "rewards: 1.0 is not allowed"),
        ({"starts": np.zeros(1)}, "starts: float64 is not allowed: whole numbers"),
    ],
)
def test_outcomes_that_are_none_are_refused(changes, said):
    one = np.zeros((1, 1, 1), int)
    given = {"successor": one, "terminated": one == 0, "rewards": [1.0], "starts": [0], **changes}
    with pytest.raises(ValueError, match=said):
        outcome_mdp(
            Outcomes(given["successor"], one, given["terminated"]), np.ones(1), given["rewards"], given["starts"]
        )
