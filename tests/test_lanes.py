"""The engine's promises: a lane's result depends on its setting and seed alone, and one program serves all."""

import threading
import time
from collections import Counter

import jax
import numpy as np
import probes
import pytest

from jaxq import executables, prng, programs, success, workers
from jaxq import lanes as engine
from jaxq.agents.dqn import DQNHypers
from jaxq.experiment import Log, experiment
from jaxq.plans import plan
from jaxq.rounds import Limits
from jaxq.tally import Lane
from jaxq.types import Hypers

pytestmark = pytest.mark.usefixtures("programs_are_compiled_once")

PRNG = "pcg4d"
#: Short runs: every lane ends at its episode limit or, where alpha is high, by success of three episodes.
TABLE = {"max_episodes": 120, "success_steps": 40, "success_streak": 2}
NETWORK = {"hidden": (16, 16), "batch_size": 16, "learning_starts": 32, "buffer_size": 200, "max_env_steps": 700}


def settings_of(name, **values):
    return plan(name, **values).settings


@pytest.fixture(scope="module", params=["q-learning", "article-dqn"])
def bench(request):
    """A compiled program, its settings and their lanes."""
    if request.param == "q-learning":
        settings = settings_of("q-learning", gamma=[0.9, 0.95, 0.99], alpha_max=[0.2, 0.5], **TABLE)
    else:
        settings = settings_of("article-dqn", learning_rate=[1e-3, 1e-2], gamma=[0.9, 0.95, 0.99], **NETWORK)
    made = programs.program(settings[0], PRNG)
    numbers = [programs.hypers(one) for one in settings]
    compiled = executables.build(made, numbers[0], PRNG)
    return compiled, [Lane(c, s, h) for c, h in enumerate(numbers) for s in range(30)]


def finish(compiled, lanes, root_seed=0, **options):
    results = engine.run(compiled, iter(lanes), root_seed=root_seed, impl=PRNG, total=len(lanes), **options)
    return {(r.lane.config, r.lane.seed): r for r in results}


def assert_same(a, b):
    assert (a.status, a.env_steps, a.updates) == (b.status, b.env_steps, b.updates)
    jax.tree.map(np.testing.assert_array_equal, (a.policy, a.episodes, a.curve), (b.policy, b.episodes, b.curve))
    np.testing.assert_array_equal(a.eval_returns, b.eval_returns)


@pytest.fixture(scope="module")
def everyone(bench):
    compiled, lanes = bench
    return finish(compiled, lanes)


def test_every_lane_ends_once_with_its_counts(bench, everyone):
    _, lanes = bench
    assert sorted(everyone) == [(lane.config, lane.seed) for lane in lanes]
    for result in everyone.values():
        assert result.status in ("solved", "finished")
        assert result.episodes.length.sum() <= result.env_steps
        assert result.episodes.env_steps[-1] <= result.env_steps
        np.testing.assert_array_equal(result.episodes.total, result.episodes.length)  # CartPole pays 1 a step
        assert np.all(np.cumsum(result.episodes.length) == result.episodes.env_steps)


def test_updates_start_when_enough_is_stored_and_the_learning_rate_ends_with_the_last(bench, everyone):
    _, lanes = bench
    network = isinstance(lanes[0].hypers.agent, DQNHypers)
    for result in everyone.values():
        assert result.updates == result.env_steps - (NETWORK["learning_starts"] - 1 if network else 0)
        if network:
            assert result.env_steps == NETWORK["max_env_steps"]
            assert result.lane.hypers.agent.anneal_updates == result.updates - 1  # as many were before the last


def test_the_step_size_falls_over_its_own_number_of_env_steps():
    changed = NETWORK | {"num_envs": 2, "steps_per_update": 3, "max_env_steps": 2000, "learning_rate_end": 1e-5}
    fell, all_along = (
        programs.hypers(settings_of("article-dqn", **changed, learning_rate_decay=steps)[0]).agent
        for steps in (1000, None)
    )
    assert fell.anneal_updates == (1000 - changed["learning_starts"]) // 6
    assert all_along.anneal_updates == (2000 - changed["learning_starts"]) // 6
    assert fell._replace(anneal_updates=0) == all_along._replace(anneal_updates=0)
    steps = changed["learning_starts"]  # before the first update
    early = programs.hypers(settings_of("article-dqn", **changed, learning_rate_decay=steps)[0]).agent
    assert early.anneal_updates == 1


def test_episodes_of_many_environments_and_steps_in_a_round_are_told_apart():
    envs, steps, starts = 3, 5, 40
    changed = {"num_envs": envs, "steps_per_update": steps, "learning_starts": starts, "max_env_steps": 2000}
    one = settings_of("article-dqn", **{**NETWORK, "hidden": (4,), **changed})[0]
    compiled = executables.build(programs.program(one, PRNG), programs.hypers(one), PRNG)
    for result in finish(compiled, [Lane(0, seed, programs.hypers(one)) for seed in range(5)]).values():
        told = result.episodes
        np.testing.assert_array_equal(told.total, told.length)  # CartPole pays 1 a step
        assert np.all(np.diff(told.env_steps) >= 0)
        assert told.env_steps[-1] <= result.env_steps
        assert len(told.length) == result.curve.episodes[-1]
        # Each environment's episodes follow one another from its step 0 on.
        assert np.all(told.env_steps % envs == 0)
        ends = Counter((told.env_steps // envs).tolist())
        begins = Counter((told.env_steps // envs - told.length).tolist())
        assert begins - ends == {0: envs}
        assert (ends - begins).total() == envs
        # The first update is that of the first round with enough; max_q is of updates alone.
        assert result.updates == (result.env_steps - starts) // (envs * steps) + 1
        warm_up = result.env_steps - result.updates * envs * steps
        np.testing.assert_array_equal(np.isnan(told.max_q), told.env_steps <= warm_up)
        # The learning rate ends with the last update or, since the last round may go past the limit, the one before.
        assert result.updates - 1 - result.lane.hypers.agent.anneal_updates in (0, 1)


def test_episodes_are_told_as_they_come(bench, everyone):
    compiled, lanes = bench
    told = {}
    watched = finish(compiled, lanes[:3], on_episodes=lambda lane, so_far: told.setdefault(lane[:2], []).append(so_far))
    for key, result in watched.items():
        assert_same(result, everyone[key])
        assert len(told[key]) == (np.diff(result.curve.updates, prepend=0) > 0).sum()  # once a segment
        for so_far in told[key]:
            for part, whole in zip(so_far, result.episodes, strict=True):
                np.testing.assert_array_equal(part, whole[: len(part)])
        jax.tree.map(np.testing.assert_array_equal, told[key][-1], result.episodes)


def test_a_lane_alone_in_another_slot_and_on_one_core_gives_the_same_bits(bench, everyone):
    compiled, lanes = bench
    for chosen in (lanes[7:8], lanes[100:103], lanes[::-17]):
        alone = finish(compiled, chosen, workers=1)
        for key, result in alone.items():
            assert_same(result, everyone[key])


def test_the_order_of_the_queue_and_the_number_of_workers_change_nothing(bench, everyone):
    compiled, lanes = bench
    shuffled = [lanes[i] for i in np.random.default_rng(0).permutation(len(lanes))]
    for result in finish(compiled, shuffled, workers=3).values():
        assert_same(result, everyone[result.lane.config, result.lane.seed])


def test_seeds_of_a_setting_differ(everyone):
    first = [r for (config, _), r in everyone.items() if config == 0]
    weights = {np.asarray(jax.tree.leaves(r.policy)[0]).tobytes() for r in first}
    assert len(weights) == len(first)


@pytest.fixture(scope="module")
def game():
    """A compiled program whose evaluation returns what its resets drew, and lanes of two settings and five seeds."""
    made = experiment(
        lambda _: probes.dice(),
        lambda _, env: probes.gambler(4, updates=4),
        success=success.never(),
        rounds=8,
        impl=PRNG,
    )
    numbers = [Hypers((), (), Limits(*np.int32([9, limit, 0, 0]))) for limit in (5, 7)]
    compiled = executables.build(programs.Program(made, width=4, num_envs=1), numbers[0], PRNG)
    return compiled, [Lane(c, s, h) for c, h in enumerate(numbers) for s in range(5)]


def test_settings_of_a_seed_are_evaluated_from_the_same_start_states_and_seeds_from_others(game):
    results = finish(*game)
    starts = {key: result.eval_returns.tolist() for key, result in results.items()}
    for seed in range(5):
        assert starts[0, seed] == starts[1, seed]
    drawn = [number for seed in range(5) for number in starts[0, seed]]
    assert len(set(drawn)) == len(drawn)


def test_the_root_seed_changes_every_lane_and_alone_decides_it(game):
    first, again, other = (finish(*game, root_seed=root) for root in (3, 3, 4))
    for key, result in first.items():
        assert_same(result, again[key])
        for leaf, leaf_so in zip(jax.tree.leaves(result.policy), jax.tree.leaves(other[key].policy), strict=True):
            assert not np.intersect1d(leaf, leaf_so).size
        assert not np.intersect1d(result.eval_returns, other[key].eval_returns).size


def test_ended_lanes_are_evaluated_together_each_with_its_own_numbers():
    # No pole falls in fewer than 8 steps, so each episode is as long as its setting lets it be.
    settings = settings_of("q-learning", **{"env.max_episode_steps": [3, 4, 5, 6, 7]}, **TABLE)
    numbers = [programs.hypers(one) for one in settings]
    compiled = executables.build(programs.program(settings[0], PRNG), numbers[0], PRNG)
    results = finish(compiled, [Lane(c, s, h) for s in range(4) for c, h in enumerate(numbers)], workers=1)
    for (config, _), result in results.items():
        np.testing.assert_array_equal(result.eval_returns, settings[config].env.max_episode_steps)


def test_a_diverging_lane_is_reported_and_changes_no_other_by_a_bit():
    calm = settings_of("article-dqn", **NETWORK)[0]
    wild = settings_of("article-dqn", **{**NETWORK, "learning_rate": 1e30})[0]
    compiled = executables.build(programs.program(calm, PRNG), programs.hypers(calm), PRNG)
    lanes = [Lane(0, seed, programs.hypers(calm)) for seed in range(7)]
    bad = Lane(1, 3, programs.hypers(wild))
    together = finish(compiled, [*lanes[:2], bad, *lanes[2:]])
    for result in finish(compiled, lanes).values():
        assert_same(result, together[result.lane.config, result.lane.seed])
    lost = together[1, 3]
    assert lost.status == "diverged"
    assert lost.eval_returns is None
    assert lost.env_steps < NETWORK["max_env_steps"]


@pytest.mark.parametrize(
    ("name", "values"),
    [
        (
            "q-learning",
            {
                "gamma": [0.5, 0.9],
                "alpha_min": [0.0, 0.1],
                "angle_bound": [0.3, 0.42],
                "env.max_episode_steps": [9, 500],
            },
        ),
        ("article-dqn", {"learning_rate": [1e-4, 1e-2], "tau": [0.1, 1.0], "target_period": [1, 7], **NETWORK}),
    ],
)
def test_numbers_share_one_trace(name, values):
    settings = settings_of(name, **values)
    made = programs.program(settings[0], PRNG)
    assert len({one.structural() for one in settings}) == 1
    shapes = {str(jax.tree.map(lambda leaf: (leaf.shape, leaf.dtype), programs.hypers(one))) for one in settings}
    assert len(shapes) == 1
    traces = 0

    def advance(state, hypers):
        nonlocal traces
        traces += 1
        return made.experiment.advance(state, hypers)

    counted = jax.jit(advance)
    for one in settings:
        h = programs.hypers(one)
        state, _ = jax.eval_shape(made.experiment.init, prng.key(0, PRNG), h)
        counted.lower(state, h)
    assert traces == 1


def test_a_stopped_run_hands_on_what_ended_and_ends():
    one = settings_of("q-learning", **TABLE)[0]
    compiled = executables.build(programs.program(one, PRNG), programs.hypers(one), PRNG)
    lanes = [Lane(0, seed, programs.hypers(one)) for seed in range(2000)]
    stop, got = threading.Event(), []
    for result in engine.run(compiled, iter(lanes), root_seed=0, impl=PRNG, total=len(lanes), stop=stop):
        got.append(result)
        stop.set()
    assert 1 <= len(got) < len(lanes)


def test_an_error_in_a_worker_reaches_the_caller():
    one = settings_of("q-learning", **TABLE)[0]
    compiled = executables.build(programs.program(one, PRNG), programs.hypers(one), PRNG)
    with pytest.raises(ValueError, match="seed"):
        finish(compiled, [Lane(0, "seed", programs.hypers(one))])


def test_a_slot_is_useful_for_as_much_of_a_segment_as_its_lane_lived():
    over = np.zeros((10, 4, 2, 3), bool)  # rounds, slots, steps, environments
    log = Log(over, *(None,) * 4)
    segment = workers._Segment(0.0, [], np.ones(4, bool), None, log, pending=True, sent=1.0, running=3.0)
    assert segment.useful_s(4 * 10 * 2 * 3) == 2.0
    assert segment.useful_s((10 + 10 + 5) * 2 * 3) == 2.0 * 25 / 40  # a slot stood free, and a lane ended half way


def test_time_with_lanes_waiting_is_counted_apart_from_the_tail():
    kept = []
    planned = plan("article-q", max_episodes=30, seeds=100)
    numbers = programs.hypers(planned.settings[0])
    built = executables.build(programs.program(planned.settings[0], "pcg4d"), numbers, "pcg4d")
    lanes = (Lane(0, seed, numbers) for seed in range(100))
    began = time.monotonic()
    results = list(engine.run(built, lanes, root_seed=0, impl="pcg4d", total=100, workers=2, on_progress=kept.append))
    took = time.monotonic() - began
    last = kept[-1]
    assert len(results) == 100
    assert 0 < last.useful_s < last.pending_s < 2 * took
    assert began < last.queue_empty < began + took
