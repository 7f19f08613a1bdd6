"""A sweep's results, from memory and from disk, and its report."""

import json
import re

import jax
import numpy as np
import pytest
from matplotlib.figure import Figure

import jaxq
from jaxq import envs, page, replayed, stats
from jaxq.cli import main
from jaxq.manifest import RunError
from jaxq.run_files import WriteError

pytestmark = pytest.mark.usefixtures("programs_are_compiled_once")

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


def test_what_a_picture_needs_and_what_it_takes_is_said(swept):
    _, runs = swept
    for kind, options, said in (
        ("sensitivity", {}, "axis: a hyperparameter is needed: one of gamma, alpha_min"),
        ("heat_map", {"x": "gamma"}, "y: a hyperparameter is needed: one of gamma, alpha_min"),
        ("survival", {"clok": "episodes"}, "clok: 'survival' takes no option 'clok'; did you mean 'clock'?"),
        ("spread", {"axis": "gamma"}, "axis: 'spread' takes no option 'axis'; known: metric"),
        ("curves", {"metric": "eval_return"}, "metric: 'curves' takes no options"),
        ("sensitivity", {"axis": "status"}, "axis: 'status' is no hyperparameter; known: gamma, alpha_min"),
        ("spread", {"metric": "final_retrun"}, "did you mean 'final_return'?"),
        ("nothing", {}, "kind: 'nothing' is unknown; known: curves, survival, spread,"),
    ):
        with pytest.raises(ValueError, match=re.escape(said)):
            runs.plot(kind, **options)


def make_env(length=0.5, gravity=9.8):
    return envs.make("CartPole-v1", length=length, gravity=gravity)


def make_other(length=0.5, gravity=9.8):
    return envs.make("CartPole-v1", length=length + 1.0, gravity=gravity)


def test_an_environment_of_ones_own_is_handed_in_to_play_its_policies_again(tmp_path):
    path = tmp_path / "own"
    runs = jaxq.sweep("q-learning", env=make_env, **{"env.length": [0.25, 0.5]}, seeds=2, out=path, **SHORT)
    wanted = replayed.play(runs, 1, 0, 5).returns
    again = jaxq.load(path, env=make_env)
    assert again.settings(1).flat() == runs.settings(1).flat()
    np.testing.assert_array_equal(replayed.play(again, 1, 0, 5).returns, wanted)
    assert isinstance(again.plot("overestimation"), Figure)
    said = r"env: this run was made with '.*make_env', a function of your own, .* give it, as --env MODULE:FUNCTION"
    with pytest.raises(ValueError, match=said):
        jaxq.load(path).plot("action_values")
    assert main(["evaluate", str(path)]) == 2
    assert re.search(r"None is drawn: " + said, page.write(jaxq.load(path), path).read_text())
    with pytest.raises(ValueError, match=r"env: is not the '.*make_env' of this run: its source"):
        jaxq.load(path, env=make_other)
    with pytest.raises(ValueError, match=r"env: 'CartPole-v1' is not allowed: the function that made '.*make_env'"):
        jaxq.load(path, env="CartPole-v1")


def test_no_environment_is_handed_in_to_a_run_that_has_none_of_ones_own(swept):
    path, _ = swept
    with pytest.raises(
        ValueError, match="env: is not allowed: this run has no environment of your own, but CartPole-v1"
    ):
        jaxq.load(path, env=make_env)


def test_a_lane_without_a_policy_is_named(swept):
    _, runs = swept
    with pytest.raises(ValueError, match="no policy is saved"):
        runs.policy(0, 99)


def test_a_policy_that_plays_again_says_from_where_and_why_its_returns_are_others(swept, capsys):
    path, _ = swept
    assert main(["evaluate", str(path), "--episodes", "3"]) == 0
    assert capsys.readouterr().out.splitlines()[-1].startswith("recorded: greedy return at the end of training; the")
    assert main(["evaluate", str(path), "--episodes", "3", "--json"]) == 0
    assert set(json.loads(capsys.readouterr().out)[0]) >= {"recorded", "pure"}


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
    late = "1 of 2 settings went on, but it came too late to stop any training: all of the other settings had ended."
    assert f"- Rung 0, at 0.5 of each training: {late}" in text
    assert runs.lanes["status"].to_pylist().count("stopped") == 0
    assert "were stopped at a rung" not in text
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


def test_a_report_of_a_halved_sweep_compares_only_settings_that_went_to_the_end(tmp_path, capsys):
    path = tmp_path / "run"
    long = {"max_env_steps": 12_000, "max_episodes": 2000, "stop": "none"}
    runs = jaxq.sweep("q-learning", gamma=[0.5, 0.8, 0.9, 0.99], seeds=2, halving=2, rungs=1, out=path, **long)
    status = runs.lanes["status"].to_pylist()
    assert status.count("stopped") == 4
    went = [row["config"] for row in runs.summary() if not row["stopped"]]
    assert runs.best()["config"] in went
    text = page.write(runs, path).read_text()
    assert "- Rung 0, at 0.5 of each training: 2 of 4 settings went on, 4 trainings of the others were stopped." in text
    assert "2 of 4 settings were stopped at a rung: they show what they had come to then" in text
    against = text[text.index(" against those that follow it") : text.index("## Learning")]
    assert re.findall(r"^\| (\d) \|", against, re.MULTILINE) == [str(*{*went} - {runs.best()["config"]})]
    assert main(["evaluate", str(path), "--episodes", "2", "--json"]) == 0
    assert json.loads(capsys.readouterr().out)[0]["config"] in went
    lane = re.search(r"Setting (\d), seed (\d), with a greedy return", text)
    assert int(lane[1]) in went


def test_axes_that_go_together_have_one_picture(tmp_path):
    listed = [{"gamma": g, "alpha_min": a, "epsilon_min": e} for g, a in ((0.9, 0.1), (0.99, 0.3)) for e in (0.05, 0.1)]
    runs = jaxq.sweep("q-learning", settings=listed, seeds=2, out=tmp_path / "run", **SHORT)
    text = page.write(runs, tmp_path / "run").read_text()
    assert "Each value of gamma goes with one of alpha_min: gamma stands for all of them in the pictures." in text
    titles = [title.split(" by ")[1] for title in re.findall(r"!\[(.* by .*)\]", text)]
    assert titles == ["gamma", "epsilon_min", "gamma and epsilon_min"]


@pytest.mark.parametrize(
    ("rows", "tied"),
    [
        ([[1, "a"], [2, "b"]], {"y": "x"}),
        ([[1, [4, 4]], [2, [4, 4]]], {}),
        ([[i, -i] for i in range(6)], {}),
        ([[i // 2, -(i // 2)] for i in range(12)], {"y": "x"}),
        ([[1, 5, 1], [2, 6, 2], [1, 5, 1], [3, 7, 3]], {"y": "x", "z": "x"}),
        ([[1, 1], [1, 2], [2, 3]], {}),
    ],
)
def test_axes_are_tied_where_their_values_stand_one_to_one(rows, tied):
    assert page.tied_axes(rows, "xyz"[: len(rows[0])]) == tied


def powers(key, hypers):
    noise = jax.random.uniform(key)
    return {"many": noise * jax.numpy.ones(3), "area": noise * hypers.r, "other": -hypers.n}


def test_the_first_number_of_a_function_is_what_is_drawn_and_ranked_unless_another_is_named(tmp_path):
    path = tmp_path / "run"
    runs = jaxq.sweep(powers, r=[1.0, 9.0], n=[1, 2], seeds=5, out=path)
    assert runs.best()["config"] == max(runs.summary(), key=lambda row: row["area"])["config"]
    assert runs.best("other")["n"] == 1
    assert runs.plot().axes[0].get_xlabel() == "area"
    assert runs.plot("sensitivity", axis="r").axes[0].get_ylabel().startswith("area")
    assert runs.plot("heat_map", x="r", y="n", metric="other").axes[1].get_ylabel().startswith("other")
    with pytest.raises(
        ValueError, match="kind: 'curves' is a picture of trainings; of a function's results: spread, s"
    ):
        runs.plot("curves")
    with pytest.raises(ValueError, match="metric: 'many' is no column of numbers of the lanes; known: area, other"):
        runs.plot(metric="many")
    with pytest.raises(
        ValueError, match="preset: this run was made with 'powers', a function of your own, which no dir"
    ):
        jaxq.load(path).settings(0)
    text = page.write(jaxq.load(path), path).read_text()
    linked = re.findall(r"!\[(.*)\]\((pictures/.*)\.png\)", text)
    assert [title for title, _ in linked] == ["spread of the seeds", "area by r", "area by n", "area by r and n"]
    assert all((path / f"{name}.png").is_file() for _, name in linked)


def test_a_function_that_returns_no_number_has_a_table_alone(tmp_path):
    path = tmp_path / "run"
    runs = jaxq.sweep(lambda key, hypers: hypers.r * jax.numpy.ones(3), r=[1.0, 2.0], seeds=3, out=path)
    with pytest.raises(ValueError, match="metric: the function returned no number that could be drawn"):
        runs.plot()
    assert "![" not in page.write(runs, path).read_text()


def test_a_report_that_cannot_be_written_leaves_the_one_before(swept, monkeypatch):
    path, runs = swept
    before = page.write(runs, path).read_bytes()

    def full(target, data):
        raise WriteError(f"{target}: No space left on device")

    monkeypatch.setattr("jaxq.run_files.replace", full)
    with pytest.raises(WriteError, match="No space left"):
        page.write(runs, path)
    assert (path / "report.md").read_bytes() == before
