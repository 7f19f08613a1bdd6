"""The command line as a user meets it: data on stdout, talk on stderr, mistakes in one line."""

import hashlib
import json
import os
import shutil
import signal
import subprocess
import sys
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
import safetensors.numpy

import jaxq
from jaxq import flags
from jaxq.cli import main
from jaxq.presets import preset

pytestmark = pytest.mark.usefixtures("programs_are_compiled_once")

SHORT = ["--max-episodes", "60", "--success-steps", "30", "--success-streak", "2"]
TINY = "--hidden 16 --batch-size 16 --learning-starts 32 --buffer-size 500 --max-env-steps 600".split()

LANE_COLUMNS = (
    "config seed env env.length gamma status episodes env_steps updates solved_at_episode solved_at_step"
    " diverged_at_step stopped_at_rung final_return eval_return area_under_curve"
).split()


@pytest.fixture(autouse=True)
def somewhere_else(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)


def sweep_json(capsys, *words):
    status = main(["sweep", *words, "--json"])
    return status, json.loads(capsys.readouterr().out)


@pytest.fixture(scope="module")
def swept(tmp_path_factory):
    """One sweep in a process of its own, and what it printed."""
    where = tmp_path_factory.mktemp("swept")
    words = [sys.executable, "-m", "jaxq", "sweep", "q-learning", "--gamma", "0.9", "0.99", "--seeds", "12", *SHORT]
    done = subprocess.run([*words, "--json"], cwd=where, capture_output=True, text=True, check=True)
    (run,) = (where / "runs").iterdir()
    return run, json.loads(done.stdout), done.stderr


def test_json_has_a_row_per_lane_a_row_per_setting_and_the_timing(swept):
    _, out, _ = swept
    assert set(out) == {"lanes", "summary", "timing"}
    assert [(row["config"], row["seed"]) for row in out["lanes"]] == [(c, s) for c in (0, 1) for s in range(12)]
    assert set(LANE_COLUMNS) <= set(out["lanes"][0])
    assert {row["gamma"] for row in out["lanes"] if row["config"] == 1} == {0.99}
    speeds = {"compile_s", "run_s", "env_steps_per_s", "updates_per_s", "useful_share", "tail_s"}
    assert set(out["timing"]) == speeds | {"programs", "cached"}
    assert 0 <= out["timing"]["tail_s"] <= out["timing"]["run_s"] + 0.1
    assert out["timing"]["programs"] == 1
    for row in out["summary"]:
        mine = [lane for lane in out["lanes"] if lane["config"] == row["config"]]
        assert row["seeds"] == len(mine) == 12
        assert row["solved"] == sum(lane["status"] == "solved" for lane in mine) / 12
        assert row["solved_low"] <= row["solved"] <= row["solved_high"]
        assert row["final_return_low"] <= row["final_return"] <= row["final_return_high"]
    for lane in out["lanes"]:
        assert (lane["solved_at_episode"] is not None) == (lane["status"] == "solved")


def test_the_run_directory_holds_the_same_rows_the_policies_and_a_picture(swept):
    run, out, stderr = swept
    rows = [row for part in sorted(run.glob("parts/*-lanes.parquet")) for row in pq.read_table(part).to_pylist()]
    assert sorted(rows, key=lambda r: (r["config"], r["seed"])) == out["lanes"]
    tables = {k: v for part in run.glob("policies/*") for k, v in safetensors.numpy.load_file(part).items()}
    assert set(tables) == {f"{c}/{s}/table" for c in (0, 1) for s in range(12)}
    assert tables["1/3/table"].shape == (18, 2)
    assert (run / "learning_curves.png").read_bytes().startswith(b"\x89PNG")
    assert str(run.name) in stderr


def test_the_same_sweep_again_is_refused_and_resumed_to_the_same_rows(swept, capsys, monkeypatch):
    run, out, _ = swept
    monkeypatch.chdir(run.parent.parent)
    words = ["q-learning", "--gamma", "0.9", "0.99", "--seeds", "12", *SHORT]
    assert main(["sweep", *words]) == 2
    assert "--resume" in capsys.readouterr().err
    status, again = sweep_json(capsys, *words, "--resume")
    assert status == 0
    assert again["lanes"] == out["lanes"]
    assert again["timing"]["programs"] == 0


def test_fewer_lanes_in_another_process_give_the_same_rows(swept, capsys):
    _, out, _ = swept
    status, first = sweep_json(capsys, "q-learning", "--gamma", "0.9", "--seeds", "3", "--out", "copy", *SHORT)
    wanted = [row for row in out["lanes"] if row["config"] == 0 and row["seed"] < 3]
    assert (status, first["lanes"]) == (0, wanted)  # fewer lanes, other neighbours, another process: the same bits


def test_the_rows_of_a_lane_alone_and_of_saved_policies_in_gymnasium(swept, capsys):
    run, out, _ = swept
    assert main(["train", "--from", str(run), "--config", "1", "--seed", "5", "--out", "again"]) == 0
    captured = capsys.readouterr()
    assert "bit for bit" in captured.err
    assert Path("again/q_values.png").exists()
    assert main(["evaluate", str(run), "--env", "gymnasium", "--config", "1", "--episodes", "5", "--json"]) == 0
    rows = json.loads(capsys.readouterr().out)
    recorded = {(row["config"], row["seed"]): row["eval_return"] for row in out["lanes"]}
    assert {(row["config"], row["seed"]): row["recorded"] for row in rows}.items() <= recorded.items()
    assert len(rows) == 12
    for row in rows:
        assert row["same_episodes"] >= 0.8  # float32 beside Gymnasium's float64
        assert abs(row["pure"] - row["gymnasium"]) <= 0.2 * row["pure"]
    assert main(["evaluate", str(run)]) == 0
    assert "gymnasium" not in capsys.readouterr().out


def test_a_lane_that_is_not_the_sweeps_is_exit_1(swept, capsys, tmp_path):
    run, _, _ = swept
    other = shutil.copytree(run, tmp_path / "other")
    manifest = json.loads((other / "manifest.json").read_text())
    manifest["spec"]["root_seed"] = 1
    text = json.dumps(manifest["spec"], sort_keys=True, separators=(",", ":"))
    manifest["spec_hash"] = hashlib.sha256(text.encode()).hexdigest()
    (other / "manifest.json").write_text(json.dumps(manifest))
    assert main(["train", "--from", str(other), "--config", "0", "--seed", "0", "--out", "again"]) == 1
    assert "is not what" in capsys.readouterr().err


def test_the_report_has_the_summary_and_its_pictures(swept, capsys):
    run, out, _ = swept
    assert main(["report", str(run)]) == 0
    assert capsys.readouterr().out.strip() == str(run / "report.md")
    text = (run / "report.md").read_text()
    linked = [line.split("(")[1].rstrip(")") for line in text.splitlines() if line.startswith("![")]
    assert len(linked) >= 6
    for name in linked:
        assert (run / name).read_bytes().startswith(b"\x89PNG")
        assert "<svg" in (run / name).with_suffix(".svg").read_text()
    for row in out["summary"]:
        assert f"| {row['gamma']} |" in text
        assert f"{row['eval_return']:.1f} [" in text
    assert main(["sweep", "q-learning", "--seeds", "1", "--gamma", "0.9", "0.99", *SHORT, "--out", "one"]) == 0
    assert main(["report", "one"]) == 0
    text = Path("one/report.md").read_text()
    assert "One seed ranks no settings" in text
    assert "[" not in text.split("## Settings")[1].split("solved:")[0].replace("![", "")


def test_float64_switched_on_changes_no_bit():
    words = [sys.executable, "-m", "jaxq", "sweep", "dqn", *TINY, "--eval-episodes", "10", "--seeds", "2"]
    rows = []
    for on in ("0", "1"):
        env = {**os.environ, "JAX_ENABLE_X64": on}
        done = subprocess.run([*words, "--json", "--out", f"run{on}"], env=env, capture_output=True, check=True)
        rows.append(json.loads(done.stdout)["lanes"])
        assert json.loads(Path(f"run{on}/manifest.json").read_text())["jax_settings"]["jax_enable_x64"] is (on == "1")
    assert rows[0] == rows[1]


def test_a_table_per_setting_for_people(capsys):
    assert main(["sweep", "q-learning", "--alpha-min", "0.1", "0.2", "--seeds", "3", *SHORT]) == 0
    out = capsys.readouterr().out
    for heading in ("alpha_min", "seeds", "solved", "episodes", "env steps", "final return", "greedy return"):
        assert heading in out
    assert "0.2" in out
    assert "learning_curves.png" in out


def test_train_prints_and_saves_the_table_and_draws_the_two_pictures(capsys):
    assert main(["train", "article-q", *SHORT, "--verbose", "--out", "one"]) == 0
    captured = capsys.readouterr()
    assert "final Q-table" in captured.out
    episodes = pq.read_table(next(Path("one/parts").glob("*-episodes.parquet"))).to_pylist()
    printed = [line for line in captured.err.splitlines() if line.startswith("episode ")]
    assert len(printed) == len(episodes)
    assert sum(row["length"] for row in episodes) == episodes[-1]["env_steps"]
    assert printed[0].startswith(f"episode 0: {episodes[0]['length']} steps")
    for name in ("q_values.png", "episodes.png"):
        assert f"one/{name}" in captured.out
        assert Path("one", name).read_bytes().startswith(b"\x89PNG")
    (saved,) = safetensors.numpy.load_file(next(Path("one/policies").iterdir())).values()
    assert f"{saved.max():.2f}"[:4] in captured.out.replace("\n", " ")


def test_a_finished_train_that_is_resumed_prints_the_same_again(capsys):
    words = ["train", "article-q", *SHORT, "--out", "one"]
    assert main(words) == 0
    first = capsys.readouterr().out
    assert main([*words, "--resume"]) == 0
    assert capsys.readouterr().out == first
    Path("one/policies/00000.safetensors").write_bytes(b"nothing")
    assert main([*words, "--resume"]) == 0
    again = capsys.readouterr()
    assert "00000.safetensors: is damaged" in again.err
    assert again.out == first


def test_the_lines_of_a_train_come_while_it_runs():
    longer = [*TINY[:-1], "1000000"]
    words = [sys.executable, "-m", "jaxq", "train", "article-dqn", *longer, "--verbose", "--out", "one"]
    process = subprocess.Popen(words, stderr=subprocess.PIPE, stdout=subprocess.DEVNULL, text=True)
    assert process.stderr is not None
    assert any(line.startswith("episode 0: ") for line in process.stderr)
    assert process.poll() is None  # it has hundreds of episodes to go
    process.terminate()
    process.communicate(timeout=60)
    assert process.returncode == 130


def test_ctrl_c_is_quiet_from_the_first_import_on(monkeypatch):
    from jaxq import __main__ as command

    def interrupted():
        raise KeyboardInterrupt

    monkeypatch.setattr("jaxq.cli.main", interrupted)
    assert command.main() == 130


def test_a_sweep_of_dqn_over_numbers_and_structures(capsys):
    words = ["article-dqn", *TINY, "--learning-rate", "1e-3", "1e-2", "--double", "false", "true", "--seeds", "2"]
    status, out = sweep_json(capsys, *words)
    assert status == 0
    assert out["timing"]["programs"] == 2
    assert len(out["summary"]) == 4
    assert all(row["updates"] == 600 - 32 + 1 for row in out["lanes"])


def test_who_does_not_look_for_success_reports_no_share_of_it(capsys):
    status, out = sweep_json(capsys, "article-dqn", *TINY, "--stop", "none", "window", "--seeds", "2")
    assert status == 0
    without, looking = out["summary"]
    assert (without["solved"], without["solved_low"], without["solved_high"]) == (None, None, None)
    assert looking["solved"] == 0


def test_train_dqn_draws_episode_lengths(capsys):
    assert main(["train", "article-dqn", *TINY, "--out", "net", "--quiet"]) == 0
    assert Path("net/episodes.png").exists()
    weights = safetensors.numpy.load_file(next(Path("net/policies").iterdir()))
    assert weights["0/0/params.Linear_0.kernel"].shape == (4, 16)


def test_a_setting_whose_lanes_all_diverge_is_exit_1_and_said(capsys):
    words = ["article-dqn", *TINY, "--learning-rate", "1e-3", "1e30", "--seeds", "2"]
    status, out = sweep_json(capsys, *words)
    assert status == 1
    assert [row["diverged"] for row in out["summary"]] == [0, 2]
    lost = [row for row in out["lanes"] if row["config"] == 1]
    assert all(row["status"] == "diverged" and row["diverged_at_step"] is not None for row in lost)
    assert all(row["eval_return"] is None for row in lost)


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["sweep", "article-q", "--gamma", "1.5"], "gamma: 1.5"),
        (["sweep", "article-dqn", "--learning-rate", "nan"], "learning_rate: nan"),
        (["sweep", "article-dqn", "--learning-rate", "1e-3", "-1"], "learning_rate: -1"),
        (["sweep", "article-q", "--seeds", "0"], "seeds: 0"),
        (["sweep", "article-q", "--seeds", "many"], "--seeds"),
        (["sweep", "article-q", "--num-buckets", "1,1,x,3"], "num_buckets"),
        (["sweep", "article-p"], "did you mean 'article-q'"),
        (["sweep", "article-q", "--gama", "0.9"], "did you mean '--gamma'"),
        (["sweep", "article-q", "--gamma"], "--gamma"),
        (["sweep", "article-q", "--gamma", "0.9", "--gamma", "0.8"], "--gamma stands twice"),
        (["sweep", "article-q", "--epsilon-min", "-1e-3"], "epsilon_min: -1e-3"),
        (["sweep", "article-q", "--epsilon-min", "-inf"], "epsilon_min: -inf"),
        (["sweep", "article-q", "--gamma", "0.9\n0.8"], "gamma"),
        (["sweep", "article-q", "--position-bound", "1e-300"], "position_bound"),
        (["sweep", "article-q", "--num-buckets", "1,1,6"], "too few"),
        (["sweep", "article-q", "--out", ""], "not a directory"),
        (["sweep", "article-q", "--prng", ""], "prng"),
        (["sweep", "article-q", "--out", "x" * 300], "File name too long"),
        (["sweep"], "article-q"),
        (["sweep", "article-q", "--prng", "mt19937"], "threefry, pcg4d"),
        (["sweep", "article-q", "--workers", "0"], "--workers: 0"),
        (["sweep", "article-q", "--resume", "--overwrite"], "--resume"),
        (["train", "article-q", "--gamma", "0.9", "0.99"], "0.99"),
        (["train", "article-q", "--gamma", "0.9:0.95"], "gamma: 0.9:0.95 is not allowed: a number"),
        (["sweep", "article-dqn", "--hidden", "64:128"], "hidden: 64:128 is not allowed: it takes no range"),
        (["sweep", "article-q", "--env.lenght", "1"], "did you mean '--env.length'"),
        (["swep", "article-q"], "did you mean 'sweep'"),
        (["list", "everything"], "everything"),
        (["list", "--jso"], "--jso is unknown to jaxq list"),
        (["--verson"], "did you mean '--version'"),
        (["sweep", "--seeds", "3", "article-q"], "the preset comes first: jaxq sweep PRESET"),
        (["sweep", "article-q", "-x"], "-x is unknown to jaxq sweep article-q"),
        (["sweep", "article-q", "extra"], "'extra' is one value too many"),
        (["sweep", "article-q", "--seed", "1", "2", "3"], "'2' is one value too many for --seed"),
        (["train", "article-q", "--gamma", "0.9", "--gamma", "0.8"], "--gamma stands twice"),
        (["sweep", "article-q", "--seeds", "5", "--seeds", "6"], "--seeds stands twice"),
        (["sweep", "article-q", "--out", "a", "--out", "b"], "--out stands twice"),
        (["sweep", "article-q", "--gamma", "0.9", "0.99", "--alpha-min", "0.1", "0.2", "0.1"], "alpha_min: 0.1 stands"),
        (["sweep", "article-q", "--seeds", "ten"], "--seeds: 'ten' is not allowed: a whole number"),
        (["sweep", "article-q", "--json=1"], "--json takes no value"),
        (["sweep", "article-q", "--bootstrap-terminal", "maybe"], "true or false"),
        (["sweep", "article-dqn", "--hidden", ""], "hidden"),
        (["bench", "env", "--cases", "7"], "65536"),
        (["sweep", "dqn", "--learning-rate", "1e-3:1e-4"], "min 0.001 must be below max 0.0001"),
        (["sweep", "dqn", "--learning-rate", "1e-4:1e-3:lg"], "did you mean 'log'"),
        (["sweep", "dqn", "--learning-rate", "1e-4:1e-3", "0.5"], "1e-4:1e-3 is not allowed beside other values"),
        (["sweep", "dqn", "--learning-rate", "1e-4:1e-3", "--method", "grid"], "a range needs the method random or"),
        (["sweep", "dqn", "--batch-size", "16.5:64"], "batch_size: 16.5 is not allowed: a whole number"),
        (["sweep", "dqn", "--method", "sobl"], "did you mean 'sobol'"),
        (["sweep", "dqn", "--samples", "4"], "samples: 4 is not allowed with the method grid"),
        (["sweep", "dqn", "--halving", "3"], "halving: 3 is not allowed: at most as many as there are settings, 1"),
        (["sweep", "dqn", "--keep", "0"], "--keep: 0"),
        (["sweep", "dqn", "--allow-mismatch"], "--allow-mismatch goes with --resume"),
        (["sweep", "dqn", "--env", "CartPol-v1"], "did you mean 'CartPole-v1'"),
        (["sweep", "dqn", "--env.lenth", "0.5"], "did you mean '--env.length'"),
        (["sweep", "dqn", "--env.length", "-1"], "env.length: -1 is not allowed"),
        (["sweep", "none.toml"], "none.toml: No such file"),
        (["report", "nowhere"], "nowhere: holds no run"),
        (["report"], "DIR"),
        (["evaluate", "nowhere"], "nowhere: holds no run"),
        (["evaluate", "nowhere", "--env", "gymnasim"], "did you mean 'gymnasium'"),
        (["evaluate", "nowhere", "--episodes", "0"], "--episodes: 0"),
        (["train", "--from", "nowhere", "--config", "0", "--seed", "0"], "nowhere: holds no run"),
        (["train", "--from", "nowhere", "--config", "0"], "--seed"),
    ],
)
def test_a_mistake_is_one_line_and_exit_2_and_leaves_nothing(words, said, capsys):
    assert main(words) == 2
    captured = capsys.readouterr()
    assert captured.out == ""
    assert said in captured.err
    assert len(captured.err.strip().splitlines()) == 1
    assert not list(Path().iterdir())


def test_dry_run_says_what_would_run_and_runs_nothing(capsys):
    assert main(["sweep", "article-dqn", "--gamma", "0.9", "0.99", "--double", "true", "false", "--dry-run"]) == 0
    out = capsys.readouterr().out
    assert "4 settings x 10 seeds = 40 lanes" in out
    assert "2 programs" in out
    assert main(["sweep", "article-dqn", "--seeds", "1", "--hidden", "none", "--dry-run"]) == 0
    assert capsys.readouterr().out.startswith("1 setting x 1 seed = 1 lane\n1 program\nabout ")
    assert main(["sweep", "article-dqn", "--seeds", "3", "--dry-run", "--json"]) == 0
    told = json.loads(capsys.readouterr().out)
    assert told.pop("memory_bytes") > 100_000_000
    assert told == {"settings": 1, "seeds": 3, "lanes": 3, "programs": 1}
    assert not list(Path().iterdir())


@pytest.mark.parametrize(
    "words", [["--double"], ["--double", "--gamma", "0.9"], ["--double", "true"], ["--double=true"]]
)
def test_a_switch_alone_is_true(words):
    chosen = preset("q-learning")
    assert flags.given_values(chosen, flags.parse("sweep", chosen, words))["double"] == ["true"]
    assert flags.given_values(chosen, flags.parse("train", chosen, words))["double"] == "true"


def test_version_list_and_help(capsys):

    with pytest.raises(SystemExit) as leaving:
        main(["--version"])
    assert leaving.value.code == 0
    assert capsys.readouterr().out == f"jaxq {jaxq.__version__}\n"
    assert main(["list"]) == 0
    out = capsys.readouterr().out
    assert all(name in out for name in ("article-q", "q-learning", "article-dqn", "dqn", "CartPole-v1"))
    with pytest.raises(SystemExit) as leaving:
        main(["sweep", "article-dqn", "--help"])
    assert leaving.value.code == 0
    out = capsys.readouterr().out
    assert "--learning-rate" in out
    assert "0.0001" in out


def test_ctrl_c_keeps_what_ended_and_resume_finishes_it():
    words = [sys.executable, "-m", "jaxq", "sweep", "article-q", "--seeds", "4000", "--out", "run"]
    process = subprocess.Popen(
        [*words, "--verbose"], stderr=subprocess.PIPE, stdout=subprocess.PIPE, text=True, env={**os.environ}
    )
    assert process.stderr is not None
    process.stderr.readline()  # the first lane has ended
    process.send_signal(signal.SIGINT)
    _, talk = process.communicate(timeout=60)
    assert process.returncode == 130
    assert "--resume" in talk
    kept = [row for part in Path("run/parts").glob("*-lanes.parquet") for row in pq.read_table(part).to_pylist()]
    assert 1 <= len(kept) < 4000
    assert "Traceback" not in talk
    seeds = [row["seed"] for row in kept]
    assert len(set(seeds)) == len(seeds)


def test_two_processes_do_not_share_a_directory(capsys):
    from jaxq.plans import plan
    from jaxq.runs import RunDirectory

    with RunDirectory.open(Path("run"), plan("article-q")):
        assert main(["sweep", "article-q", "--out", "run", "--resume"]) == 75
    assert f"process {os.getpid()} is writing to it" in capsys.readouterr().err


def test_importing_rows_needs_no_jaxq(swept):
    run, out, _ = swept
    table = pa.concat_tables([pq.read_table(part) for part in run.glob("parts/*-curves.parquet")])
    assert {"config", "seed", "env_steps", "train_return", "loss", "max_q", "epsilon"} <= set(table.column_names)
    steps = np.array(table["env_steps"])
    assert steps.max() == max(row["env_steps"] for row in out["lanes"])


def test_the_library_gives_the_rows_of_the_command_line(swept):

    _, out, _ = swept
    numbers = {"max_episodes": 60, "success_steps": 30, "success_streak": 2}
    outcome = jaxq.sweep("q-learning", gamma=[0.9, 0.99], seeds=12, **numbers)
    assert outcome.lanes.to_pylist() == out["lanes"]
    assert outcome.summary() == out["summary"]
    alone = jaxq.train("q-learning", gamma=0.99, **numbers)
    row = next(r for r in out["lanes"] if (r["config"], r["seed"]) == (1, 0))
    assert (alone.status, alone.env_steps) == (row["status"], row["env_steps"])
    assert alone.max_q is not None
    assert len(alone.max_q) == alone.updates


def test_sigterm_keeps_what_ended_as_ctrl_c_does():
    words = [sys.executable, "-m", "jaxq", "sweep", "article-q", "--seeds", "4000", "--out", "run", "--verbose"]
    process = subprocess.Popen(words, stderr=subprocess.PIPE, stdout=subprocess.PIPE, text=True)
    assert process.stderr is not None
    process.stderr.readline()
    process.terminate()
    _, talk = process.communicate(timeout=60)
    assert process.returncode == 130
    assert "--resume" in talk
    assert list(Path("run/parts").glob("*-lanes.parquet"))


def test_the_greedy_return_is_of_whole_episodes_however_long(capsys):
    _, out = sweep_json(
        capsys, "q-learning", "--env.max-episode-steps", "700", "--seeds", "4", "--success-steps", "600"
    )
    assert max(row["eval_return"] for row in out["lanes"]) > 500


def test_a_last_update_that_blows_up_is_a_divergence(capsys):
    words = ["article-dqn", *TINY, "--max-env-steps", "32", "--weight-decay", "1e5", "--learning-rate", "1e37"]
    words.remove("600")
    words.remove("--max-env-steps")
    status, out = sweep_json(capsys, *words, "--seeds", "2")
    assert status == 1
    assert {(row["status"], row["updates"], row["eval_return"]) for row in out["lanes"]} == {("diverged", 1, None)}


def test_axes_stand_in_the_order_of_the_words(capsys):
    orders = []
    for words in (
        ["--gamma", "0.9", "0.95", "--alpha-min", "0.1", "0.2"],
        ["--alpha-min", "0.1", "0.2", "--gamma", "0.9", "0.95"],
    ):
        status, out = sweep_json(capsys, "article-q", *words, "--max-episodes", "2", "--seeds", "1")
        assert status == 0
        orders.append([(row["gamma"], row["alpha_min"]) for row in out["lanes"]])
    assert orders[0] == [(0.9, 0.1), (0.9, 0.2), (0.95, 0.1), (0.95, 0.2)]
    assert orders[1] == [(0.9, 0.1), (0.95, 0.1), (0.9, 0.2), (0.95, 0.2)]


@pytest.mark.parametrize(
    ("values", "said"),
    [
        ({"workers": 0}, "workers: 0 is not allowed: an integer from 1"),
        ({"workers": 1.5}, "workers: 1.5 is not allowed"),
        ({"keep": 0}, "keep: 0 is not allowed"),
        ({"keep": "a"}, "keep: 'a' is not allowed"),
    ],
)
def test_the_library_refuses_what_the_command_line_refuses(values, said):
    with pytest.raises(ValueError, match=said):
        jaxq.sweep("article-q", **values)


def test_a_train_is_one_lane():
    with pytest.raises(ValueError, match="article-q: 2 lanes are not one"):
        jaxq.train("article-q", gamma=[0.9, 0.95])


@pytest.mark.parametrize("name", [3, None])
def test_a_preset_that_is_no_word_is_unknown(name):
    with pytest.raises(ValueError, match=f"preset: {name} is unknown"):
        jaxq.sweep(name)


def test_a_function_that_makes_no_environment_is_named():
    def made(length=0.5):
        return length

    with pytest.raises(ValueError, match=r"env: .*made made .*, which is no jaxq\.types\.Env"):
        jaxq.sweep("article-dqn", env=made)
