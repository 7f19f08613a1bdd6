"""The engine's promises: a lane's result depends on its setting and seed alone, and one program serves all."""

import threading
import time

import jax
import numpy as np
import pytest

from jaxq import executables, prng, programs
from jaxq import lanes as engine
from jaxq.plans import plan
from jaxq.tally import Lane

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


def finish(compiled, lanes, **options):
    results = engine.run(compiled, iter(lanes), root_seed=0, impl=PRNG, total=len(lanes), **options)
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
            {"gamma": [0.5, 0.9], "alpha_min": [0.0, 0.1], "angle_bound": [0.3, 0.42], "max_steps": [9, 500]},
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
        state, _ = made.experiment.init(prng.key(0, PRNG), h)
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
