"""The engine when something goes wrong, or comes to its end: what has ended is handed on, and nobody is left behind."""

import threading

import pytest

from jaxq import executables, programs, sweeps
from jaxq import lanes as engine
from jaxq.plans import plan
from jaxq.runs import RunDirectory
from jaxq.tally import Lane

PRNG = "pcg4d"
SHORT = {"max_episodes": 60, "success_steps": 40, "success_streak": 2}


@pytest.fixture(scope="module")
def table():
    (one,) = plan("q-learning", **SHORT).settings
    numbers = programs.hypers(one)
    return executables.build(programs.program(one, PRNG), numbers, PRNG), numbers


def start(table, lanes, total, **options):
    return engine.run(table[0], iter(lanes), root_seed=0, impl=PRNG, total=total, **options)


def collect(results, into):
    for result in results:
        into.append(result.lane.seed)


def lanes_of(table, count):
    return (Lane(0, seed, table[1]) for seed in range(count))


def test_what_ended_before_an_error_is_handed_on(table):
    def failing():
        yield from lanes_of(table, 300)
        raise RuntimeError("no more")

    seen, got = [], []
    with pytest.raises(RuntimeError, match="no more"):
        collect(start(table, failing(), 1000, workers=2, on_progress=seen.append), got)
    assert len(got) == len(set(got)) == seen[-1].done  # the engine's own record, as it stands in the end
    assert 200 < len(got) <= 300


def test_ctrl_c_in_the_callers_thread_hands_on_what_ended(table, monkeypatch):
    class Interrupted(engine.queue.SimpleQueue):
        calls = 0

        def get(self, *args, **options):
            Interrupted.calls += 1
            if Interrupted.calls == 5:
                raise KeyboardInterrupt
            return super().get(*args, **options)

    monkeypatch.setattr(engine.queue, "SimpleQueue", Interrupted)
    seen, got = [], []
    with pytest.raises(KeyboardInterrupt):
        collect(start(table, lanes_of(table, 4000), 4000, on_progress=seen.append), got)
    assert 1 <= len(got) == seen[-1].done < 4000


def test_ctrl_c_in_a_sweep_keeps_what_ended(tmp_path):
    planned = plan("q-learning", seeds=4000, **SHORT)
    told = []

    def interrupt(result):
        told.append(result)
        if len(told) == 3:
            raise KeyboardInterrupt

    with RunDirectory.open(tmp_path / "run", planned) as directory:
        last = []
        with pytest.raises(KeyboardInterrupt):
            sweeps.run(planned, directory=directory, on_result=interrupt, on_progress=lambda p: last.append(p.done))
        kept = directory.rows("lanes")
    assert len(kept) == len({row["seed"] for row in kept}) == last[-1]
    assert 3 < len(kept) < 4000


def test_no_worker_outlives_a_caller_that_fails(table):
    before = threading.active_count()

    def fail(_):
        raise RuntimeError("boom")

    with pytest.raises(RuntimeError, match="boom"):
        list(start(table, lanes_of(table, 4000), 4000, on_progress=fail))
    assert threading.active_count() == before


def test_the_tail_begins_when_the_last_lane_has_its_slot(table):
    """With as many lanes as slots nobody ever waits: all of the run is its tail."""
    width = table[0].program.width
    for lanes in (width - 1, width):
        last = []
        assert len(list(start(table, lanes_of(table, lanes), lanes, workers=1, on_progress=last.append))) == lanes
        assert last[-1].pending_s == last[-1].useful_s == 0
        assert last[-1].queue_empty is not None


def test_env_steps_count_the_warm_up():
    tiny = {"hidden": (8,), "batch_size": 16, "learning_starts": 32, "buffer_size": 100, "max_env_steps": 300}
    done = []
    outcome = sweeps.run(plan("article-dqn", seeds=5, **tiny), on_progress=lambda p: done.append(p.env_steps))
    assert done[-1] == outcome.timing.env_steps == sum(row["env_steps"] for row in outcome.lanes) == 1500
    assert outcome.timing.updates == sum(row["updates"] for row in outcome.lanes)
