"""The engine when something goes wrong, or comes to its end: what has ended is handed on, and nobody is left behind."""

import itertools
import threading
from dataclasses import replace

import pytest

from jaxq import executables, programs, shared, sweeps, tally, workers
from jaxq import lanes as engine
from jaxq.plans import plan
from jaxq.runs import RunDirectory
from jaxq.tally import Lane

pytestmark = pytest.mark.usefixtures("programs_are_compiled_once")

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


def failing_on(call, work):
    """The same work, which fails when it is called for this time."""
    calls = itertools.count(1)

    def counted(*arguments):
        if next(calls) == call:
            raise RuntimeError("no memory")
        return work(*arguments)

    return counted


def test_an_evaluation_that_fails_costs_its_own_group_alone(table):
    built = replace(table[0], evaluate=failing_on(2, table[0].evaluate))
    seen, got = [], []
    with pytest.raises(RuntimeError, match="no memory"):
        collect(start((built, table[1]), lanes_of(table, 1000), 1000, workers=1, on_progress=seen.append), got)
    assert len(got) == len(set(got)) == seen[-1].done - built.program.width
    assert len(got) > built.program.width


def test_what_ended_in_the_segment_that_runs_when_books_fail_is_handed_on(table, monkeypatch):
    def ended(segments):
        """The lanes that end within so many segments."""
        stop, calls, got = threading.Event(), itertools.count(1), []

        def advance(*arguments):
            if next(calls) == segments:
                stop.set()
            return table[0].advance(*arguments)

        built = replace(table[0], advance=advance)
        collect(start((built, table[1]), lanes_of(table, 4000), 4000, workers=1, stop=stop), got)
        return set(got)

    got = []
    with monkeypatch.context() as patch:
        patch.setattr(tally.Tally, "shares", failing_on(6, tally.Tally.shares))  # in the books of the sixth segment
        with pytest.raises(RuntimeError, match="no memory"):
            collect(start(table, lanes_of(table, 4000), 4000, workers=1), got)
    assert ended(6) < set(got) == ended(7)


@pytest.mark.parametrize("error", [KeyboardInterrupt, RuntimeError])
def test_a_listener_that_fails_loses_nothing_that_ended(table, error):
    seen, got = [], []

    def listen(progress):
        seen.append(progress.done)
        if len(seen) == 20:
            raise error

    with pytest.raises(error):
        collect(start(table, lanes_of(table, 4000), 4000, on_progress=listen), got)
    assert len(got) == len(set(got)) == seen[-1]
    assert 0 < len(got) < 4000


def test_ctrl_c_that_swallows_a_last_word_hangs_nobody(table, monkeypatch):
    class Swallowing(shared.queue.SimpleQueue):
        def get(self, *args, **options):
            item = super().get(*args, **options)
            if isinstance(item, shared.Ended):
                raise KeyboardInterrupt
            return item

    monkeypatch.setattr(shared.queue, "SimpleQueue", Swallowing)
    got = []
    with pytest.raises(KeyboardInterrupt):
        collect(start(table, lanes_of(table, 100), 100, workers=2), got)
    assert sorted(got) == list(range(100))


@pytest.mark.parametrize(("seconds", "waits"), [(-1.0, False), (1e9, True)])
def test_after_a_long_segment_nobody_waits_for_company(table, monkeypatch, seconds, waits):
    left, books = [], workers.Worker._do_books

    def watched(worker):
        books(worker)
        left.append(len(worker.waiting) + len(worker.evaluated))

    monkeypatch.setattr(workers, "WAIT_SECONDS", seconds)
    monkeypatch.setattr(workers.Worker, "_do_books", watched)
    got = []
    collect(start(table, lanes_of(table, 200), 200, workers=1), got)
    assert sorted(got) == list(range(200))
    assert any(left) == waits


def test_ctrl_c_in_the_callers_thread_hands_on_what_ended(table, monkeypatch):
    class Interrupted(shared.queue.SimpleQueue):
        calls = 0

        def get(self, *args, **options):
            Interrupted.calls += 1
            if Interrupted.calls == 5:
                raise KeyboardInterrupt
            return super().get(*args, **options)

    monkeypatch.setattr(shared.queue, "SimpleQueue", Interrupted)
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
        tell = sweeps.Listeners(result=interrupt, progress=lambda p: last.append(p.done))
        with pytest.raises(KeyboardInterrupt):
            sweeps.run(planned, directory=directory, tell=tell)
        kept = directory.table("lanes").to_pylist()
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
    outcome = sweeps.run(
        plan("article-dqn", seeds=5, **tiny), tell=sweeps.Listeners(progress=lambda p: done.append(p.env_steps))
    )
    assert done[-1] == outcome.timing.env_steps == sum(outcome.lanes["env_steps"].to_pylist()) == 1500
    assert outcome.timing.updates == sum(outcome.lanes["updates"].to_pylist())
