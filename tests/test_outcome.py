"""A sweep's results, from memory and from disk, and its report."""

import re

import jax
import numpy as np
import pytest
from matplotlib.figure import Figure

import jaxq
from jaxq import page, stats
from jaxq.manifest import RunError
from jaxq.run_files import WriteError

SHORT = {"max_episodes": 60, "success_steps": 30, "success_streak": 2}


@pytest.fixture(scope="module")
def swept(tmp_path_factory):
    path = tmp_path_factory.mktemp("outcome") / "run"
    return path, jaxq.sweep("q-learning", gamma=[0.9, 0.99], alpha_min=[0.1, 0.3], seeds=4, out=path, **SHORT)


def test_what_is_loaded_is_what_was_returned(swept):
    path, runs = swept
    again = jaxq.load(path)
    assert again.lanes.equals(runs.lanes)
    assert again.curves.equals(runs.curves)
    assert again.summary() == runs.summary()
    assert (again.best(), again.varied, again.complete) == (runs.best(), ["gamma", "alpha_min"], True)
    assert again.label(3) == "gamma 0.99, alpha_min 0.3"
    assert str(again) == str(runs)
    assert "0.99" in str(runs)
    obs = np.random.default_rng(0).normal(size=(50, 4))
    np.testing.assert_array_equal(again.policy(2, 3).q_values(obs), runs.policy(2, 3).q_values(obs))


def test_a_sweep_in_memory_is_the_same(swept):
    _, runs = swept
    memory = jaxq.sweep("q-learning", gamma=[0.9, 0.99], alpha_min=[0.1, 0.3], seeds=4, **SHORT)
    assert memory.lanes.equals(runs.lanes)
    assert memory.curves.equals(runs.curves)
    assert memory.summary() == runs.summary()


def test_the_settings_are_made_again_from_what_is_saved(swept):
    path, _ = swept
    one = jaxq.load(path).settings(2)
    assert one == jaxq.plan("q-learning", gamma=0.99, alpha_min=0.1, **SHORT).settings[0]
    with pytest.raises(ValueError, match="config: 4 is not allowed: from 0 to 3"):
        jaxq.load(path).settings(4)


def test_every_kind_of_picture_is_drawn_and_others_are_named(swept):
    _, runs = swept
    for kind, options in (
        ("curves", {}),
        ("survival", {}),
        ("survival", {"clock": "episodes"}),
        ("spread", {"metric": "solved_at_step"}),
        ("sensitivity", {"axis": "gamma"}),
        ("heat_map", {"x": "gamma", "y": "alpha_min"}),
        ("action_values", {"config": 1, "seed": 2}),
        ("greedy_map", {}),
        ("overestimation", {}),
    ):
        assert isinstance(runs.plot(kind, **options), Figure)
    with pytest.raises(ValueError, match="did you mean 'survival'"):
        runs.plot("survivl")
    with pytest.raises(ValueError, match="did you mean 'gamma'"):
        runs.plot("sensitivity", axis="gama")


def test_a_lane_without_a_policy_is_named(swept):
    _, runs = swept
    with pytest.raises(ValueError, match="no policy is saved"):
        runs.policy(0, 99)


def test_what_is_no_run_and_what_is_damaged_is_said(swept, tmp_path):
    with pytest.raises(RunError, match="holds no run"):
        jaxq.load(tmp_path)
    jaxq.sweep("q-learning", seeds=2, out=tmp_path / "run", **SHORT)
    part = next((tmp_path / "run" / "parts").glob("*-curves.parquet"))
    part.write_bytes(part.read_bytes()[:-1])
    with pytest.raises(RunError, match=rf"{part.name}: is damaged"):
        jaxq.load(tmp_path / "run")


def test_the_report_has_the_figures_of_the_statistics(swept):
    path, runs = swept
    drawn = []
    text = page.write(runs, path, drawn.append).read_text()
    linked = re.findall(r"!\[.*\]\((pictures/.*)\.png\)", text)
    assert [name.removeprefix("pictures/") for name in linked] == drawn
    for name in linked:
        assert (path / f"{name}.png").read_bytes().startswith(b"\x89PNG")
        assert "<svg" in (path / f"{name}.svg").read_text()
    for row in runs.summary():
        assert f"| {row['config']} | {row['gamma']} | {row['alpha_min']} | 4 |" in text
        assert f"{row['final_return']:.1f} [{row['final_return_low']:.1f}, {row['final_return_high']:.1f}]" in text
    by_setting = {
        c: runs.lanes.filter(runs.lanes["config"].to_numpy() == c)["eval_return"].to_pylist() for c in range(4)
    }
    best = runs.best()["config"]
    assert f"Setting {best} against" in text
    for other in set(range(4)) - {best}:
        difference = stats.paired_difference(by_setting[best], by_setting[other])
        better = stats.probability_of_improvement(by_setting[best], by_setting[other])
        cells = [f"{e.value:.{n}f} [{e.low:.{n}f}, {e.high:.{n}f}]" for e, n in ((better, 2), (difference, 1))]
        assert f"| {other} | {cells[0]} | {cells[1]} |" in text


def test_a_report_tells_of_rungs_and_of_policies_that_were_not_kept(tmp_path):
    runs = jaxq.sweep("q-learning", gamma=[0.9, 0.99], seeds=3, halving=2, out=tmp_path / "run", **SHORT)
    text = page.write(runs, tmp_path / "run").read_text()
    assert "- Rung 0, at 0.5 of each training: 1 of 2 went on." in text
    for file in (tmp_path / "run" / "policies").iterdir():
        file.unlink()
    assert "None is drawn: setting" in page.write(runs, tmp_path / "run").read_text()


def test_a_functions_sweep_has_a_report_too(tmp_path):
    runs = jaxq.sweep(
        lambda key, hypers: jax.random.uniform(key) * hypers.r, r=[1.0, 2.0], seeds=3, out=tmp_path / "run"
    )
    text = page.write(jaxq.load(tmp_path / "run"), tmp_path / "run").read_text()
    for row in runs.summary():
        assert str(row["result"]) in text


def test_a_report_that_cannot_be_written_leaves_the_one_before(swept, monkeypatch):
    path, runs = swept
    before = page.write(runs, path).read_bytes()

    def full(target, data):
        raise WriteError(f"{target}: No space left on device")

    monkeypatch.setattr("jaxq.run_files.replace", full)
    with pytest.raises(WriteError, match="No space left"):
        page.write(runs, path)
    assert (path / "report.md").read_bytes() == before
