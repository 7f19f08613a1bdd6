"""The suites of ``scaling``: what they count, the memory that they tell, and how flat their results are."""

import os
import sys
import threading
from contextlib import nullcontext
from types import SimpleNamespace

import jax
import numpy as np
import pytest

from benchmarks import beside, bounds, flatness, page
from benchmarks.limits import products
from jaxq import lanes, machine
from jaxq.bench import affinity, command, equal_lanes, full_replay, memory, scaling, suites
from jaxq.cli import main


@pytest.fixture
def runs(monkeypatch):
    """What the engine was asked for and what it yielded, a pair for each run."""
    seen = []

    def run(*args, **kwargs):
        results = list(lanes.run(*args, **kwargs))
        seen.append((kwargs, results))
        yield from results

    monkeypatch.setattr(equal_lanes, "engine", type("Engine", (), {"run": staticmethod(run)}))
    monkeypatch.setattr(scaling, "_notes", {})
    return seen


def test_every_number_of_lanes_makes_all_its_updates_and_tells_its_memory(runs, monkeypatch):
    monkeypatch.setitem(scaling.UPDATES, ("lanes", "article-q"), 6000)
    width = equal_lanes.unevaluated(equal_lanes.setting("article-q"), "pcg4d").program.width
    for count in (5, 2 * width * machine.cores() + 3):
        bout = scaling.prepare(str(count), "lanes", "article-q")
        assert bout() == count * 6000
        kwargs, results = runs[-1]
        assert [result.updates for result in results] == [6000] * count
        assert len({result.lane.seed for result in results}) == count
        told = scaling.notes(str(count))
        assert told["slots"] == width * kwargs["workers"]
        assert memory.peak_mib() is None or told["first_peak_mib"] > 50
        bout()
        assert scaling.notes(str(count)) is told  # the first bout's
    monkeypatch.setattr(memory, "PROCESS", memory.PROCESS / "none")
    scaling.prepare("1", "lanes", "article-q")()
    assert scaling.notes("1")["first_peak_mib"] is None


def test_any_number_of_cores_shares_the_same_lanes_evenly(runs, monkeypatch):
    monkeypatch.setitem(scaling.UPDATES, ("cores", "article-q"), 1000)
    monkeypatch.setattr(machine, "cores", lambda: 6)
    assert machine.core_counts() == (1, 2, 4, 6)
    width = equal_lanes.unevaluated(equal_lanes.setting("article-q"), "pcg4d").program.width
    for count in (1, 4):
        assert scaling.prepare(str(count), "cores", "article-q")() == 12 * width * 1000
        assert runs[-1][0]["workers"] == count
    assert scaling.notes("4") == {}
    for cores, counts in ((1, (1,)), (2, (1, 2)), (8, (1, 2, 4, 8))):
        monkeypatch.setattr(machine, "cores", lambda cores=cores: cores)
        assert machine.core_counts() == counts


@pytest.mark.skipif(sys.platform != "linux", reason="threads can be held to a core on Linux alone")
def test_a_run_on_one_core_has_no_other(monkeypatch):
    """Threads that were there before and those that begin inside, and all of them are free again afterwards."""
    allowed, go, seen = os.sched_getaffinity(0), threading.Event(), []

    def old():
        go.wait()
        seen.append(os.sched_getaffinity(0))

    before = threading.Thread(target=old)
    before.start()
    with pytest.raises(RuntimeError), affinity.on(1):  # noqa: PT012
        go.set()
        before.join()
        inside = threading.Thread(target=lambda: seen.append(os.sched_getaffinity(0)))
        inside.start()
        inside.join()
        raise RuntimeError
    assert seen == [{min(allowed)}] * 2
    assert os.sched_getaffinity(0) == allowed

    held = []
    monkeypatch.setattr(equal_lanes, "prepare", lambda *a, **k: lambda: held.append(os.sched_getaffinity(0)) or 1.0)
    scaling.prepare("1", "cores", "article-q")()
    assert held[-1] == {min(allowed)}
    scaling.prepare("16", "lanes", "article-q")()
    assert held[-1] == allowed


def test_an_accelerators_lanes_are_held_to_no_core(monkeypatch):
    held = []
    monkeypatch.setattr(scaling, "_notes", {})
    monkeypatch.setattr(affinity, "on", lambda cores: held.append(cores) or nullcontext())
    monkeypatch.setattr(equal_lanes, "prepare", lambda *a, **k: lambda: 1.0)
    monkeypatch.setattr(equal_lanes, "unevaluated", lambda *a: SimpleNamespace(program=SimpleNamespace(width=8)))
    assert affinity.not_held("cpu") is None or sys.platform != "linux"
    scaling.prepare("1", "cores", "article-q")()
    assert held == [1]
    monkeypatch.setattr(jax, "default_backend", lambda: "gpu")
    for axis in ("lanes", "width"):
        scaling.prepare("16", axis, "article-dqn")()
    assert held == [1]
    scaling.prepare("2", "cores", "article-q")()
    assert scaling.notes("2")["differs"].startswith("workers, not cores")


def test_a_case_of_the_network_is_the_width_of_both_layers(runs, monkeypatch):
    monkeypatch.setitem(scaling.UPDATES, ("width", "article-dqn"), 256)
    assert scaling.prepare("16", "width", "article-dqn")() == scaling.NETWORK_LANES * 256
    shapes = {leaf.shape for leaf in jax.tree.leaves(runs[-1][1][0].policy) if leaf.ndim == 2}
    assert shapes == {(4, 16), (16, 16), (16, 2)}


def test_the_products_of_a_width_are_those_of_its_layers(monkeypatch):
    made, normal = [], jax.random.normal
    monkeypatch.setattr(products, "LOOPS", 4)
    monkeypatch.setattr(jax.random, "normal", lambda key, shape: made.append(shape) or normal(key, shape))
    groups = scaling.NETWORK_LANES // products.GROUP
    assert products.prepare("16", "width")() == min(machine.cores(), groups) * products.GROUP * 4
    assert set(made) == {(products.GROUP, 128, 16), (products.GROUP, 16, 16)}


def test_the_replay_is_full_and_every_lane_goes_on(monkeypatch):
    states, started = [], full_replay.started
    monkeypatch.setattr(full_replay, "SEGMENTS", 1)
    monkeypatch.setattr(full_replay, "started", lambda *args: states.append(started(*args)) or states[-1])
    bout = full_replay.prepare("1000")
    assert len(states) == lanes.default_workers()
    for state in states:
        replay = state.agent.replay
        width = len(replay.size)
        assert np.asarray(replay.size).tolist() == [1000] * width
        assert np.abs(replay.storage.obs_tm1).sum(axis=2).all()  # a row never written is zeros
        stored = int(replay.position[0])
        assert 0 < stored < 1000  # what the warm-up wrote, over and over
        np.testing.assert_array_equal(replay.storage.obs_t[:, stored:900], replay.storage.obs_t[:, : 900 - stored])
        assert len(np.unique(np.asarray(replay.storage.obs_t[:, 0]), axis=0)) == width
    assert full_replay.notes("1000") == {"group_mib": round(sum(x.nbytes for x in jax.tree.leaves(state)) / 2**20, 1)}
    firsts = [np.asarray(state.agent.replay.storage.obs_t[0, 0]) for state in states]
    assert len(np.unique(firsts, axis=0)) == len(states)  # groups differ
    made = bout()
    assert made == bout() == len(states) * width * 256


def test_the_peak_of_memory_rises_and_is_reset():
    if not memory.reset_peak():
        pytest.skip("this system keeps its peak to itself")
    before = memory.peak_mib()
    held = np.ones(2**26, np.uint8)
    assert memory.peak_mib() > before + 60
    del held
    assert memory.peak_mib() > before + 60
    memory.reset_peak()
    assert memory.peak_mib() < before + 30


def test_scaling_names_all_of_its_suites(capsys):
    assert [suite.name for suite in command.chosen(["scaling"])] == [
        *("scaling-lanes", "scaling-replay", "scaling-cores", "scaling-network")
    ]
    named = [suite.name for suite in command.chosen(["scaling-cores", "scaling", "env", "env"])]
    assert named == ["scaling-cores", "scaling-lanes", "scaling-replay", "scaling-network", "env"]
    assert [suite.name for suite in command.chosen([])] == list(suites.SUITES)
    for wrong, near in (("scalign", "scaling"), ("scaling-lane", "scaling-lanes")):
        with pytest.raises(ValueError, match=f"suite '{wrong}' is unknown; did you mean '{near}'\\?"):
            command.chosen([wrong])
    with pytest.raises(SystemExit):
        main(["bench", "--help"])
    assert "scaling is all of scaling-*" in " ".join(capsys.readouterr().out.split())


def result_of(suite, medians, notes=None):
    """A result with these medians by contender and case."""
    rows = [
        {
            "contender": name,
            "case": str(case),
            "rates": [median] if median else [],
            "median": median,
            "spread": 0.0 if median else None,
            "error": None if median else "no",
            "notes": (notes or {}).get((name, case), {}),
        }
        for (name, case), median in medians.items()
    ]
    one = suites.SUITES[suite]
    return {"suite": suite, "unit": one.unit, "axis": one.axis, "rows": rows}


def test_flatness_is_the_smallest_over_the_largest():
    result = result_of("scaling-replay", {("jaxq", 1000): 10.0, ("jaxq", 10_000): 8.0, ("jaxq", 10**6): None})
    (row,) = result["flatness"] = flatness.flatness(result)
    assert (row["flat"], row["first"], row["last"], row["least"]) == (0.8, 1000, 10_000, 0.9)
    said = "jaxq, updates per second, smallest over largest, 1,000 to 10,000 transitions: 0.8 (bar 0.9)"
    assert flatness.sentence(row, result) == said
    assert flatness.lines(result)[1] == ["jaxq", "updates per second", "1,000 to 10,000 transitions", "0.8", "0.9", ""]

    name = "jaxq, article-q"
    cores = result_of("scaling-cores", {(name, 1): 10.0, (name, 2): 18.0, (name, 4): 30.0})
    assert flatness.flatness(cores)[0]["flat"] == 0.75  # of updates per core
    assert flatness.flatness(cores)[1]["flat"] is None  # article-dqn, which did not run
    assert flatness.sentence(flatness.flatness(cores)[1], cores).endswith("smallest over largest: no figure")


def test_cases_with_fewer_lanes_than_slots_do_not_count(tmp_path):
    name = "jaxq, article-q"
    medians = {(name, 16): 1.0, (name, 64): 9.0, (name, 256): 10.0}
    peaks = {(name, 16): 100.0, (name, 64): 400.0, (name, 256): 500.0}
    notes = {key: {"slots": 64, "first_peak_mib": peak} for key, peak in peaks.items()}
    result = result_of("scaling-lanes", medians, notes)
    result["flatness"] = flatness.flatness(result)
    found = {row["quantity"]: row for row in result["flatness"] if row["contender"] == name}
    assert found[flatness.RATE]["flat"] == 0.9
    assert found[flatness.MEMORY]["flat"] == 0.8
    assert found[flatness.RATE]["first"] == 64
    flatness.picture(result, tmp_path / "lanes.png")
    assert (tmp_path / "lanes.png").stat().st_size > 5000


def test_what_should_be_flat_is_measured_and_nothing_else_is_asked_of_a_suite():
    for flat in flatness.FLAT:
        names = {one.name: one for one in suites.SUITES[flat.suite].contenders}
        assert all(case.isdigit() for case in names[flat.contender].cases)
        assert flatness.named(flat.quantity, result_of(flat.suite, {}))
    assert flatness.lines(result_of("env", {("jaxq", 1): 1.0})) == []
    assert flatness.flatness(result_of("env", {("jaxq", 1): 1.0})) == []


def test_the_page_tells_how_flat_a_suite_is():
    result = result_of("scaling-replay", {("jaxq", 1000): 10.0, ("jaxq", 10_000): 9.5})
    result |= {"machine": {"cpu": "a processor", "cores": 2, "system": "Linux"}, "began": "2026-01-02T03:04:05Z"}
    result |= {"repeats": 3, "seconds": 0.5, "versions": {}, "ratios": [], "flatness": flatness.flatness(result)}
    text = page.page({"scaling-replay": result})
    assert "| jaxq | updates per second | 1,000 to 10,000 transitions | 0.95 | 0.9 |  |" in text
    assert beside.LIMITS["scaling-network"][0].cases == suites.WIDTHS


def test_bounds_tell_seconds_and_notes():
    def row(contender, case, rate, share):
        return {"contender": contender, "case": case, "median": rate, "rates": [rate], "notes": {"useful_share": share}}

    many = "article-q, 1024 seeds"
    result = {"suite": "sweep", "rows": [row(bounds.FULL, many, 0.25, 0.7), row(bounds.EMPTY, many, 0.2, 0.6)]}
    found = {(one["contender"], one["case"], one["quantity"]): one["value"] for one in bounds.bounds(result)}
    assert found[bounds.FULL, many, bounds.SECONDS] == 4
    assert found[bounds.FULL, many, bounds.USEFUL] == 0.7
    assert found[bounds.EMPTY, many, bounds.SECONDS] == 5
    assert found[bounds.FULL, "article-q, 1 seed", bounds.SECONDS] is None
    lines = bounds.lines({**result, "bounds": bounds.bounds(result)})
    assert [many, bounds.FULL, bounds.WORDS[bounds.USEFUL], "0.7", "at least 0.9"] in lines
    assert ["article-q, 1 seed", bounds.FULL, bounds.WORDS[bounds.SECONDS], "no figure", "at most 3"] in lines
    assert bounds.lines({"suite": "env", "rows": []}) == []
    cases = {(contender.name, case) for contender in suites.SUITES["sweep"].contenders for case in contender.cases}
    assert {(bound.contender, bound.case) for bound in bounds.BOUNDS} <= cases
