"""One training: what the agent is shown, how the clock runs, where a lane ends."""

import jax
import jax.numpy as jnp
import numpy as np
import probes
import pytest

from jaxq import experiment as module
from jaxq import prng, success
from jaxq.evaluation import greedy_returns
from jaxq.experiment import experiment
from jaxq.rounds import DIVERGED, FINISHED, RUNNING, SOLVED, Limits, Streams
from jaxq.types import Hypers, Metrics


def hypers(episodes=10**6, steps=10**6, success_steps=10**6, streak=0):
    limits = Limits(*(np.int32(n) for n in (episodes, steps, success_steps, streak)))
    return Hypers(env=(), agent=(), run=limits)


def train(h, *, length=3, truncates=False, rounds=8, seen=8, rule=None, **structure):
    """A segment of one lane beside another that ends soon, together as the engine runs them."""
    made = experiment(
        lambda _: probes.counter(length, truncates=truncates),
        lambda _, env: probes.recorder(seen),
        success=rule or success.streak(),
        rounds=rounds,
        **structure,
    )
    group = jax.tree.map(lambda *leaves: np.stack(leaves), h, hypers(steps=2))
    state, first = jax.jit(jax.vmap(made.init))(jax.random.split(prng.key(0)), group)
    state, log = jax.jit(jax.vmap(made.advance))(state, group)
    return jax.tree.map(lambda leaf: leaf[0], (state, log, first))


def test_the_stored_successor_is_the_true_one_and_termination_stops_the_bootstrap():
    state, _, _ = train(hypers(), length=3, rounds=6, seen=6)
    # obs, next obs, reward, continues, cut; the successor of a last step is 3, never the reset's 0.
    once = [[0, 1, 1, 1, 0], [1, 2, 1, 1, 0], [2, 3, 1, 0, 1]]
    assert state.agent.tolist() == once * 2


def test_truncation_cuts_the_trajectory_and_keeps_the_bootstrap():
    state, _, _ = train(hypers(), length=2, truncates=True, rounds=4, seen=4)
    assert state.agent.tolist() == [[0, 1, 1, 1, 0], [1, 2, 1, 1, 1]] * 2


def test_the_clock_counts_steps_episodes_and_updates():
    state, log, _ = train(hypers(), length=3, rounds=5, num_envs=2, steps_per_round=4)
    assert [int(n) for n in state.clock[:3]] == [5 * 4 * 2, 2 * (20 // 3), 5]
    assert log.over.shape == (5, 4, 2)
    assert int(log.over.sum()) == int(state.clock.episodes)
    np.testing.assert_array_equal(log.total[log.over], 3.0)


def test_warm_up_stores_without_learning_and_shows_its_episodes():
    state, log, first = train(hypers(), length=3, rounds=1, warm_up_steps=7, seen=7)
    assert first.over.shape == (6, 1, 1)
    assert first.over.ravel().tolist() == [False, False, True] * 2
    assert [int(n) for n in state.clock[:3]] == [7, 2, 1]
    assert state.agent[:, 0].tolist() == [0, 1, 2, 0, 1, 2, 0]
    assert bool(jnp.isnan(first.max_q).all())
    assert not bool(log.over.any())


@pytest.mark.parametrize(("num_envs", "steps"), [(1, 1), (2, 4)])
def test_an_update_sees_the_clock_under_which_its_transitions_were_chosen(num_envs, steps):
    made = experiment(
        lambda _: probes.counter(3),
        lambda _, env: probes.watch(9),
        success=success.never(),
        rounds=9,
        num_envs=num_envs,
        steps_per_round=steps,
    )
    h = hypers(steps=7 * steps * num_envs)
    state, _ = jax.jit(made.advance)(made.init(prng.key(0), h)[0], h)
    done = np.minimum(np.arange(9), 7)  # rounds before each update; the lane ends with the seventh
    expected = [done * steps * num_envs, done * steps // 3 * num_envs, done, np.arange(9) < 7]
    np.testing.assert_array_equal(state.agent, np.stack(expected, 1))


@pytest.mark.parametrize(
    ("limits", "status", "counts"),
    [
        (hypers(episodes=2), FINISHED, (6, 2, 6)),
        (hypers(steps=4), FINISHED, (4, 1, 4)),
        (hypers(success_steps=2, streak=1), SOLVED, (6, 2, 6)),
        (hypers(success_steps=3, streak=1), RUNNING, (8, 2, 8)),
    ],
)
def test_a_lane_stands_still_once_it_ends(limits, status, counts):
    state, _, _ = train(limits, length=3, rounds=8)
    assert int(state.status) == status
    assert tuple(int(n) for n in state.clock[:3]) == counts
    assert float(state.clock.live) == (status == RUNNING)


def test_success_weighs_more_than_the_limit_reached_in_the_same_round():
    state, _, _ = train(hypers(episodes=1, success_steps=2, streak=0), length=3)
    assert int(state.status) == SOLVED


def test_a_non_finite_loss_ends_the_lane_at_its_step():
    def poisoned(_, env):
        agent = probes.recorder(4)

        def update(key, state, experience, clock):
            state, _ = agent.update(key, state, experience, clock)
            return state, Metrics(jnp.where(clock.updates == 4, jnp.nan, 0.0), jnp.zeros(()))

        return agent.__class__(**{**vars(agent), "update": update})

    made = experiment(lambda _: probes.counter(3), poisoned, success=success.never(), rounds=9)
    state, _ = jax.jit(made.init)(prng.key(0), hypers())
    state, _ = jax.jit(made.advance)(state, hypers())
    assert int(state.status) == DIVERGED
    assert int(state.clock.env_steps) == 5


def test_a_group_advances_as_each_of_its_lanes_alone():
    """State and log, where both differ between lanes, where only one does, and where groups stand in groups."""
    made = experiment(
        lambda _: probes.counter(3),
        lambda _, env: probes.recorder(24, ("obs_tm1", "a_tm1", "obs_t", "r_t")),
        success=success.streak(),
        rounds=5,
        num_envs=2,
        steps_per_round=3,
    )
    settings = [hypers(steps=steps) for steps in (6, 17, 100, 1000)]
    states = [made.init(prng.key(seed), settings[0])[0] for seed in range(4)]

    def stacked(trees):
        return jax.tree.map(lambda *leaves: jnp.stack(leaves), *trees)

    def same(together, alone):
        jax.tree.map(np.testing.assert_array_equal, together, stacked(alone))

    advance = jax.jit(made.advance)
    both = [advance(state, h) for state, h in zip(states, settings, strict=True)]
    assert len({int(state.clock.env_steps) for state, _ in both}) == 4 - 1  # two never end
    same(jax.vmap(advance)(stacked(states), stacked(settings)), both)
    same(jax.vmap(advance, (0, None))(stacked(states), settings[1]), [advance(s, settings[1]) for s in states])
    same(jax.vmap(advance, (None, 0))(states[1], stacked(settings)), [advance(states[1], h) for h in settings])
    nested = jax.vmap(jax.vmap(advance))(
        *(jax.tree.map(lambda x: x.reshape(2, 2, *x.shape[1:]), stacked(t)) for t in (states, settings))
    )
    same(jax.tree.map(lambda x: x.reshape(4, *x.shape[2:]), nested), both)


def test_segments_continue_where_the_last_one_stopped():
    h = hypers()
    made = experiment(
        lambda _: probes.counter(5), lambda _, env: probes.recorder(12), success=success.streak(), rounds=4
    )
    twice = experiment(
        lambda _: probes.counter(5), lambda _, env: probes.recorder(12), success=success.streak(), rounds=8
    )
    state, _ = made.init(prng.key(1), h)
    short, _ = made.advance(made.advance(state, h)[0], h)
    long, _ = twice.advance(twice.init(prng.key(1), h)[0], h)
    jax.tree.map(np.testing.assert_array_equal, short, long)


def test_seeds_differ_in_everything_and_the_state_holds_no_typed_key():
    made = experiment(
        lambda _: probes.counter(5), lambda _, env: probes.recorder(4), success=success.never(), rounds=20
    )
    states = [made.init(prng.key(seed), hypers())[0] for seed in (0, 1)]
    assert float(states[0].env.noise[0]) != float(states[1].env.noise[0])
    for leaf in jax.tree.leaves(states[0]):
        assert not jnp.issubdtype(leaf.dtype, jax.dtypes.prng_key)


def play(*seeds):
    """Of trainings in which every key can be told: what the agent drew and was shown in 4 rounds of 5 steps of 3
    environments, and what its evaluation started from."""
    made = experiment(
        lambda _: probes.dice(),
        lambda _, env: probes.gambler(60, updates=4),
        success=success.never(),
        rounds=4,
        num_envs=3,
        steps_per_round=5,
    )

    @jax.jit
    def run(key):
        state, _ = made.advance(made.init(key, hypers())[0], hypers())
        return state.agent, made.evaluate(key, (), hypers())

    return [run(prng.key(seed)) for seed in seeds]


@pytest.fixture(scope="module")
def played():
    return play(0, 1)


def test_no_seed_no_environment_and_no_step_shares_a_key(played):
    drawn = np.concatenate([np.ravel(leaf) for leaf in jax.tree.leaves(played)])
    # The start and 4 updates; the observation, the action and the successor of each step; each evaluation's start.
    assert len(drawn) == 2 * (5 + 4 * 5 * 3 * 3 + 10)
    assert len(set(drawn.tolist())) == len(drawn)


@pytest.mark.parametrize("stream", Streams._fields)
def test_evaluation_alone_draws_from_its_stream(played, monkeypatch, stream):
    streams = module.streams_of
    monkeypatch.setattr(module, "streams_of", lambda *of: streams(*of)._replace(**{stream: prng.key(99)}))
    ((trained, evaluated),) = play(0)
    assert jax.tree.all(jax.tree.map(np.array_equal, trained, played[0][0])) == (stream == "evaluate")
    assert np.array_equal(evaluated, played[0][1]) == (stream != "evaluate")


def test_greedy_returns_are_of_whole_episodes():
    returns = greedy_returns(prng.key(0), probes.counter(7), lambda obs: jnp.zeros(2), episodes=3, max_steps=20)
    assert returns.tolist() == [7.0, 7.0, 7.0]
    cut = greedy_returns(prng.key(0), probes.counter(7), lambda obs: jnp.zeros(2), episodes=1, max_steps=4)
    assert cut.tolist() == [4.0]


@pytest.mark.parametrize("field", ["rounds", "num_envs", "steps_per_round", "eval_episodes", "eval_steps"])
def test_a_count_of_zero_is_refused(field):
    with pytest.raises(ValueError, match=f"{field}: 0"):
        experiment(lambda _: None, lambda _, e: None, success=success.never(), **{"rounds": 1, field: 0})


def test_the_window_rule_divides_by_the_window_even_before_it_is_full():
    rule = success.window_mean(4)
    limits = Limits(0, 0, np.float32(5.0), 0)
    state, lengths, solved = rule.init(), [10, 10, 1, 1, 6, 4, 30], []
    for length in lengths:
        state, met = rule.update(state, jnp.array(True), jnp.array(length), jnp.array(0.0), limits)
        solved.append(bool(met))
    expected = [sum(lengths[max(0, i - 3) : i + 1]) / 4 > 5.0 for i in range(len(lengths))]
    assert solved == expected
    unchanged, _ = rule.update(state, jnp.array(False), jnp.array(99), jnp.array(0.0), limits)
    jax.tree.map(np.testing.assert_array_equal, unchanged, state)


@pytest.mark.parametrize("window", [7, 13, 15, 50, 100])
def test_a_mean_equal_to_the_threshold_is_not_above_it_in_a_compiled_program_either(window):
    rule = success.window_mean(window)

    @jax.jit
    @jax.vmap
    def judged(lengths, threshold):
        def body(state, length):
            return rule.update(state, jnp.array(True), length, jnp.array(0.0), Limits(0, 0, threshold, 0))

        return jax.lax.scan(body, rule.init(), lengths)[1]

    thresholds = np.arange(1, 501)
    off = np.random.default_rng(window).integers(thresholds[:, None], size=(500, window // 2))
    lengths = np.concatenate([thresholds[:, None] + off, thresholds[:, None] - off], axis=1)
    lengths = np.concatenate([lengths, np.repeat(thresholds[:, None], window % 2, axis=1)], axis=1)
    np.testing.assert_array_equal(lengths.sum(1), thresholds * window)
    assert not judged(lengths, thresholds.astype(np.float32))[:, -1].any()
    lengths[:, 0] += 1
    assert judged(lengths, thresholds.astype(np.float32))[:, -1].all()


def test_the_streak_rule_wants_more_than_the_streak_and_starts_over_on_a_failure():
    rule = success.streak()
    limits = Limits(0, 0, np.int32(9), np.int32(2))
    count, solved = rule.init(), []
    for length in (10, 10, 9, 10, 10, 10, 10):  # length 10 ends at 0-based step 9
        count, met = rule.update(count, jnp.array(True), jnp.array(length), jnp.array(0.0), limits)
        solved.append(bool(met))
    assert solved == [False, False, False, False, False, True, True]
