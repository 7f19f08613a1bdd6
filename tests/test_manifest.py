"""The manifest: one that is broken is said and made again, and a run goes on only as it was begun."""

import json
import shutil

import faults
import pytest
from faults import Watched, assert_same, bits, contents, death

from jaxq import manifest, run_files
from jaxq.cli import main
from jaxq.manifest import RunError
from jaxq.plans import plan
from jaxq.runs import RunDirectory

TABLES = faults.tables(gamma=[0.9, 0.99], seeds=4)
WORDS = ["--gamma", "0.9", "0.99", "--max-episodes", "50", "--success-steps", "30", "--success-streak", "2"]
WORDS = ["sweep", "q-learning", *WORDS, "--eval-episodes", "3"]


@pytest.fixture(autouse=True)
def _quick(monkeypatch):
    faults.quickly(monkeypatch)


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    """A run that is complete."""
    path = tmp_path_factory.mktemp("whole") / "run"
    with pytest.MonkeyPatch.context() as patch:
        faults.quickly(patch)
        Watched(path, TABLES)
    return path


@pytest.fixture(scope="module")
def killed(tmp_path_factory):
    """A run of which some lanes have rows."""
    path = tmp_path_factory.mktemp("killed") / "run"
    with pytest.MonkeyPatch.context() as patch, death(40):
        faults.quickly(patch)
        with pytest.raises(faults.Killed):
            Watched(path, TABLES)
    assert 0 < len(faults.rows(path)["lanes"]) < TABLES.lanes
    return path


def edit(path, **values):
    file = path / "manifest.json"
    file.write_text(json.dumps(json.loads(file.read_text()) | values))


def held(path):
    return json.loads((path / "manifest.json").read_text())


BREAKS = {
    "cut off": lambda file: file.write_text(file.read_text()[:-20]),
    "not JSON": lambda file: file.write_text("{"),
    "not text": lambda file: file.write_bytes(b"\xff\xfe\x00"),
    "empty": lambda file: file.write_text(""),
    "a list": lambda file: file.write_text("[]"),
    "deleted": lambda file: file.unlink(),
    **{
        f"{name} {value!r}": lambda file, name=name, value=value: edit(file.parent, **{name: value})
        for name, value in [
            ("format", "3"),
            ("files", None),
            ("files", []),
            ("agreed", 3),
            ("spec_hash", None),
            ("spec_hash", "0" * 64),
            ("versions", ""),
            ("id", 7),
            ("spec", {}),
            ("spec", {"preset": "q-learning", "varied": ["gamma"]}),
            ("mismatches", {}),
            ("rungs", [3]),
            ("rungs", [{"rung": 0, "kept": [0], "stopped": "all"}]),
        ]
    },
}


@pytest.mark.parametrize("how", BREAKS)
def test_a_broken_manifest_is_one_line_and_is_made_again_when_asked(tmp_path, whole, killed, capsys, how):
    path = shutil.copytree(killed, tmp_path / "run")
    rows = len(faults.rows(path)["lanes"])
    BREAKS[how](path / "manifest.json")
    before = contents(path)
    for words in (["--resume"], []):
        assert main([*WORDS, "--seeds", "4", "--out", str(path), *words]) == 2
        captured = capsys.readouterr()
        assert captured.out == ""
        assert len(captured.err.splitlines()) == 1
        assert str(path) in captured.err
        assert "--overwrite" in captured.err
        assert contents(path) == before
    again = Watched(path, TABLES, allow=True)
    assert len(again.ran) == TABLES.lanes - rows
    assert "manifest.json" in again.said[0]
    assert len(again.said) == 1
    assert_same(path, whole)
    assert [entry["what"] for entry in held(path)["mismatches"]] == ["manifest"]
    assert Watched(path, TABLES).ran == []
    if how != "deleted":
        aside = path / "quarantine" / "manifest.json"
        assert aside.read_bytes() == before[path / "manifest.json"]


def test_a_manifest_of_another_version_is_left_alone(tmp_path, whole):
    path = shutil.copytree(whole, tmp_path / "run")
    edit(path, format=manifest.FORMAT + 1)
    before = contents(path)
    for allow in (False, True):
        with pytest.raises(RunError, match="not a manifest of this version; choose another --out"):
            Watched(path, TABLES, allow=allow)
    assert contents(path) == before


CHANGES = {
    "versions": (lambda found: {"versions": found["versions"] | {"jax": "0.0.1"}}, ["jax was 0.0.1, is "]),
    "a package that is gone": (
        lambda found: {"versions": found["versions"] | {"jaxtyping": "1"}},
        ["jaxtyping was 1, is None"],
    ),
    "cpu": (lambda found: {"cpu": "Z80"}, ["cpu was Z80, is "]),
    "device": (lambda found: {"device": "abacus"}, ["device was abacus, is cpu"]),
    "xla flags": (lambda found: {"xla_flags": "--none"}, ["xla_flags was --none, is "]),
    "jax settings": (
        lambda found: {"jax_settings": found["jax_settings"] | {"jax_enable_x64": True}},
        ["jax_enable_x64 was True, is False"],
    ),
    "two at once": (
        lambda found: {"cpu": "Z80", "versions": found["versions"] | {"jax": "0.0.1"}},
        ["cpu was Z80, is ", "jax was 0.0.1, is "],
    ),
}


@pytest.mark.parametrize("what", CHANGES)
def test_what_was_made_elsewhere_goes_on_only_when_asked_and_says_so(tmp_path, whole, killed, capsys, what):
    change, said = CHANGES[what]
    path = shutil.copytree(killed, tmp_path / "run")
    now = held(path)
    edit(path, **change(now))
    before = contents(path)
    assert main([*WORDS, "--seeds", "4", "--out", str(path), "--resume"]) == 2
    message = capsys.readouterr().err
    assert len(message.splitlines()) == 1
    assert all(text in message for text in said)
    assert "--allow-mismatch" in message
    assert contents(path) == before
    Watched(path, TABLES, allow=True)
    assert_same(path, whole)
    noted = held(path)["mismatches"]
    assert len(noted) == len(said)
    for text in said:
        assert any(text.startswith(f"{entry['what']} was {entry['was']}, is ") for entry in noted)
        assert all(entry["is"] != entry["was"] for entry in noted)
    assert all(entry["after_files"] == len(now["files"]) > 0 for entry in noted)
    assert Watched(path, TABLES).ran == []  # it is of here now
    assert held(path)["mismatches"] == noted


def test_the_flag_that_goes_on_is_allow_mismatch(tmp_path, killed, whole):
    path = shutil.copytree(killed, tmp_path / "run")
    edit(path, cpu="Z80")
    words = [*WORDS, "--seeds", "4", "--episodes", "--out", str(path)]
    assert main([*words, "--allow-mismatch"]) == 2
    assert main([*words, "--resume", "--allow-mismatch", "--quiet"]) == 0
    assert_same(path, whole)


def test_another_width_goes_on_only_when_asked_and_says_so(tmp_path, whole, killed):
    path = shutil.copytree(killed, tmp_path / "run")
    agreed = held(path)["agreed"]
    width = agreed["width of setting 0"]
    edit(path, agreed=agreed | {"width of setting 0": 8})
    with pytest.raises(
        RunError, match=rf"was made otherwise: width of setting 0 was 8, is {width}; .*--allow-mismatch"
    ):
        Watched(path, TABLES)
    assert len(faults.rows(path)["lanes"]) < TABLES.lanes
    Watched(path, TABLES, allow=True)
    (noted,) = held(path)["mismatches"]
    assert (noted["was"], noted["is"]) == (8, width)
    assert held(path)["agreed"] == agreed
    assert_same(path, whole)


@pytest.mark.parametrize(
    ("options", "said"),
    [({"keep": 3}, "keep was all, is 3"), ({"keep_episodes": False}, "episodes was all, is none")],
)
def test_who_asks_for_other_rows_or_policies_is_told_before_a_lane_runs(tmp_path, killed, whole, options, said):
    path = shutil.copytree(killed, tmp_path / "run")
    before = faults.rows(path)
    with pytest.raises(RunError, match=f"was made otherwise: {said}; .*--allow-mismatch"):
        Watched(path, TABLES, **options)
    assert all(table.equals(before[kind]) for kind, table in faults.rows(path).items())
    Watched(path, TABLES, allow=True, **options)
    assert [f"{one['what']} was {one['was']}, is {one['is']}" for one in held(path)["mismatches"]] == [said]
    assert faults.rows(path)["lanes"].equals(faults.rows(whole)["lanes"])


LARGER = {
    "more seeds": (faults.tables(gamma=[0.9, 0.99], seeds=6), "seeds was 4, is 6"),
    "appended settings": (faults.tables(gamma=[0.9, 0.99, 0.5], seeds=4), "gamma was [0.9, 0.99], is [0.9, 0.99, 0.5]"),
    "both": (faults.tables(gamma=[0.9, 0.99, 0.5], seeds=5), "seeds was 4, is 5; gamma was"),
}


@pytest.mark.parametrize("begun", ["whole", "killed"])
@pytest.mark.parametrize("what", LARGER)
def test_a_larger_sweep_keeps_the_rows_that_are_there_and_runs_the_others(tmp_path, request, what, begun):
    larger, said = LARGER[what]
    path = shutil.copytree(request.getfixturevalue(begun), tmp_path / "run")
    before, committed = contents(path), run_files.committed(path)
    rows = len(faults.rows(path)["lanes"])
    with pytest.raises(RunError) as refused:
        Watched(path, larger)
    assert said in str(refused.value)
    assert "go on with --allow-mismatch" in str(refused.value)
    assert contents(path) == before
    again = Watched(path, larger, allow=True)
    assert len(again.ran) == larger.lanes - rows
    for file, data in before.items():
        if run_files.batch(file) in committed:
            assert file.read_bytes() == data
    Watched(tmp_path / "fresh", larger)
    assert_same(path, tmp_path / "fresh")
    assert (path / "sweep.toml").read_text() == (tmp_path / "fresh" / "sweep.toml").read_text()
    assert held(path)["spec"] == held(tmp_path / "fresh")["spec"]
    assert held(path)["spec_hash"] == larger.hash()
    assert {entry["what"] for entry in held(path)["mismatches"]} <= {"seeds", "gamma"}
    assert Watched(path, larger).ran == []


@pytest.mark.parametrize(
    ("other", "said"),
    [
        (faults.tables(gamma=[0.9, 0.99], seeds=3), "seeds was 4, is 3"),
        (faults.tables(gamma=[0.9, 0.98], seeds=4), "gamma was [0.9, 0.99], is [0.9, 0.98]"),
        (faults.tables(gamma=[0.99, 0.9], seeds=4), "gamma was [0.9, 0.99], is [0.99, 0.9]"),
        (faults.tables(gamma=[0.5, 0.9, 0.99], seeds=4), "is [0.5, 0.9, 0.99]"),
        (faults.tables(gamma=0.9, seeds=4), "gamma was [0.9, 0.99], is 0.9"),
        (faults.tables(gamma=[0.9, 0.99], seeds=4, alpha_min=0.2), "alpha_min was 0.1, is 0.2"),
        (faults.tables(gamma=[0.9, 0.99], seeds=4, seed=7), "root_seed was 0, is 7"),
        (faults.tables(gamma=[0.9, 0.99], seeds=4, prng="threefry"), "prng was pcg4d, is threefry"),
        (faults.tables(gamma=[0.9, 0.99], seeds=4, halving=2), "halving was None, is 2"),
        (faults.tables(gamma=[0.9, 0.99], seeds=4, **{"env.length": 0.6}), "env.length was 0.5, is 0.6"),
        (plan("article-q", gamma=[0.9, 0.99], seeds=4, **faults.SHORT), "preset was q-learning, is article-q"),
    ],
)
def test_another_sweep_is_refused_even_when_asked(tmp_path, whole, other, said):
    path = shutil.copytree(whole, tmp_path / "run")
    before = contents(path)
    for allow in (False, True):
        with pytest.raises(RunError) as refused:
            Watched(path, other, allow=allow)
        assert said in str(refused.value)
        assert "choose another --out" in str(refused.value)
        assert "--allow-mismatch" not in str(refused.value)
        assert contents(path) == before


def test_a_halving_run_does_not_grow(tmp_path):
    halved = {"gamma": [0.9, 0.99], "halving": 2}
    Watched(tmp_path / "run", faults.tables(**halved, seeds=2))
    with pytest.raises(RunError, match="seeds was 2, is 3"):
        Watched(tmp_path / "run", faults.tables(**halved, seeds=3), allow=True)


def test_a_run_whose_sweep_file_is_lost_has_it_again(tmp_path, whole):
    path = shutil.copytree(whole, tmp_path / "run")
    text = (path / "sweep.toml").read_text()
    (path / "sweep.toml").unlink()
    with RunDirectory.open(path, TABLES, resume=True):
        pass
    assert (path / "sweep.toml").read_text() == text
    assert bits(faults.rows(path)["lanes"]).equals(bits(faults.rows(whole)["lanes"]))
