"""Sweep files: a plan that is written reads as the same plan; a mistake is one line that names the file."""

import dataclasses
import json
from functools import partial
from pathlib import Path

import pytest
import tomli_w
from hypothesis import example, given, settings
from hypothesis import strategies as st

from jaxq import envs, functions, sweep_files
from jaxq.axes import Range
from jaxq.cli import main
from jaxq.plans import plan

#: Values of each name, and how a range of them is made, where there is one.
NAMES = {
    "gamma": st.just(0.0) | st.floats(1e-6, 1),
    "learning_rate": st.floats(1e-30, 1e30),
    "learning_rate_end": st.none() | st.floats(1e-6, 1),
    "target_period": st.integers(1, 2_000_000_000),
    "eval_every": st.integers(0, 1000),
    "hidden": st.lists(st.integers(1, 99), max_size=3).map(tuple),
    "double": st.booleans(),
    "stop": st.sampled_from(["streak", "window", "gymnasium", "none"]),
    "loss": st.sampled_from(["huber", "squared"]),
    "env.length": st.floats(1e-6, 1e6),
    "env.max_episode_steps": st.integers(1, 1000),
    "env.integrator": st.sampled_from(["euler", "semi-implicit"]),
    "env.sutton_barto_reward": st.booleans(),
}
RANGES = ("gamma", "learning_rate", "target_period", "env.length", "env.max_episode_steps")


@st.composite
def ranges(draw, name):
    low, high = sorted(draw(st.lists(NAMES[name], min_size=2, max_size=2, unique=True)))
    return Range(low, high, draw(st.sampled_from(["linear", "log"] if low > 0 else ["linear"])))


@st.composite
def requests(draw):
    """The arguments of a plan, of every method."""
    method = draw(st.sampled_from(["grid", "random", "sobol", "list", None]))
    names = draw(st.lists(st.sampled_from(sorted(NAMES)), max_size=4, unique=True))
    values = {}
    for name in names:
        kinds = [NAMES[name]]
        if method != "list":
            kinds.append(st.lists(NAMES[name], min_size=1, max_size=3, unique_by=str))
        if method not in ("grid", "list") and name in RANGES:
            kinds.append(ranges(name))
        values[name] = draw(st.one_of(kinds))
    if method == "list":
        others = sorted(set(NAMES) - set(names))
        one = st.lists(st.sampled_from(others), max_size=3, unique=True).flatmap(
            lambda chosen: st.fixed_dictionaries({name: NAMES[name] for name in chosen})
        )
        listed = draw(st.lists(one, max_size=3))
        values["settings"] = [{}, *({"tau": i / 10, **made} for i, made in enumerate(listed))]
    elif method in ("random", "sobol") and draw(st.booleans()):
        values["samples"] = draw(st.integers(1, 9))
    for name, kind in (("seeds", st.integers(1, 5)), ("seed", st.integers(0, 2**32 - 1))):
        if draw(st.booleans()):
            values[name] = draw(kind)
    values |= draw(st.sampled_from([{}, {"env": "CartPole-v1"}, {"prng": "threefry"}]))
    return values if method is None else {"method": method, **values}


@pytest.fixture(scope="module")
def file(tmp_path_factory):
    return tmp_path_factory.mktemp("files") / "sweep.toml"


#: Names of the environment between others: the order of the axes is that of the settings.
MIXED = {"env.length": [0.25, 0.5], "gamma": [0.9, 0.99], "env.integrator": ["euler", "semi-implicit"]}


@given(requests(), st.integers(2, 9), st.none() | st.integers(1, 3))
@example({**MIXED, "tau": 0.5, "env.masspole": 0.2}, 2, None)
@example({"env.masspole": 0.2, "tau": [0.5, 1.0], **MIXED}, 2, 1)
@settings(max_examples=300, deadline=None)
def test_what_is_written_reads_as_the_same_plan(file, values, halving, rungs):
    planned = plan("article-dqn", **values)
    if halving <= len(planned.settings):
        planned = plan("article-dqn", **values, halving=halving, rungs=rungs)
    file.write_text(sweep_files.text(planned))
    again = sweep_files.load(file)
    assert again == planned
    assert again.hash() == planned.hash()
    assert sweep_files.text(again) == file.read_text()


@pytest.mark.parametrize("name", ["article-q", "q-learning", "article-dqn", "dqn"])
def test_every_preset_has_a_file(file, name):
    file.write_text(f'preset = "{name}"\n')
    assert sweep_files.load(file) == plan(name)
    file.write_text(sweep_files.text(plan(name)))
    assert sweep_files.load(file) == plan(name)


EXAMPLE = """
preset = "dqn"
seeds = 16
seed = 3
method = "sobol"
samples = 8
[parameters]
gamma = 0.99
hidden.values = [[64, 64], [128, 128], []]
learning_rate_end.values = ["none", 1e-5]
[parameters.learning_rate]
min = 1e-4
max = 1e-2
scale = "log"
[parameters.env]
masspole = 0.2
[parameters.env.length]
values = [0.25, 0.5]
"""
SAME = {
    "seeds": 16,
    "seed": 3,
    "method": "sobol",
    "samples": 8,
    "gamma": 0.99,
    "hidden": [(64, 64), (128, 128), ()],
    "learning_rate_end": [None, 1e-5],
    "learning_rate": Range(1e-4, 1e-2, "log"),
    "env.masspole": 0.2,
    "env.length": [0.25, 0.5],
}


def test_a_file_that_people_write_is_the_plan_of_the_same_words(file):
    file.write_text(EXAMPLE)
    assert sweep_files.load(file) == plan("dqn", **SAME)
    file.write_text('preset = "dqn"\nmethod = "list"\n[[settings]]\nhidden = [8]\nenv.length = 0.25\n[[settings]]\n')
    assert sweep_files.load(file) == plan("dqn", settings=[{"hidden": (8,), "env.length": 0.25}, {}])


def own_world(length=0.5):
    return envs.make("CartPole-v1", length=length)


def test_what_no_file_can_say_is_refused():
    one = plan("dqn", seeds=3)
    cannot = [
        plan("dqn", env=own_world),
        functions.plan(lambda key, hypers: hypers.rate, rate=[0.1, 0.2]),
        dataclasses.replace(one, seeds=(1, 2)),
        dataclasses.replace(one, request=None),
    ]
    for planned in cannot:
        with pytest.raises(ValueError, match=r"^[\w-]+: .*(function|file)"):
            sweep_files.text(planned)


WRONG = [
    ("sedes = 3", "'sedes' is no key of a sweep; did you mean 'seeds'"),
    ("[parameter]\ngamma = 0.9", "did you mean 'parameters'"),
    ("name = 'dqn'", "'name' is no key of a sweep"),
    ("[parameters]\ngama = 0.9", "gama: dqn has no such setting; did you mean 'gamma'"),
    ("[parameters.env]\nlenght = 0.9", "did you mean 'env.length'"),
    ("[parameters]\ngamma = 1.5", "gamma: 1.5 is not allowed: input should be less"),
    ("[parameters]\ngamma = 'high'", "gamma: high is not allowed: a number"),
    ("[parameters]\ngamma = 2020-01-01", "gamma: 2020-01-01 is not allowed"),
    ("[parameters]\nhidden = [64, 'x']", "hidden: x is not allowed: a whole number"),
    ("[parameters]\ngamma = {low = 1}", "values, or min and max with a scale"),
    ("[parameters]\ngamma = {values = 0.9}", "values, or min and max with a scale"),
    ("[parameters]\ngamma = {min = 0.1, max = 0.9, values = [0.3]}", "gamma: {"),
    ("[parameters]\ngamma = {min = 0.9, max = 0.1}", "gamma: range: min 0.9 must be below max 0.1"),
    ("[parameters]\ngamma = {min = 'a', max = 0.1}", "gamma: range: 'a' is not allowed"),
    ("[parameters]\ngamma = {min = 0.1, max = 0.9, scale = 'lin'}", "gamma: scale: 'lin' is unknown"),
    ("[parameters]\ngamma = {values = []}", "gamma: [] is not allowed: at least one value"),
    ("parameters = 3", "parameters: must be a table"),
    ("settings = 3", "settings: must be tables"),
    ("settings = ['gamma']", "settings: must be tables"),
    ("method = 'list'", "settings: the method list needs them"),
    ("seeds = 'ten'", "seeds: 'ten' is not allowed: an integer"),
    ("seeds = 1.0", "seeds: 1.0 is not allowed"),
    ("seed = -1", "seed: -1 is not allowed"),
    ("prng = 3", "prng: 3 is unknown"),
    ("method = ['grid']", "method: ['grid'] is unknown"),
    ("samples = 4", "samples: 4 is not allowed with the method grid"),
    ("env = 'CartPol-v1'", "did you mean 'CartPole-v1'"),
    ("env = ['CartPole-v1']", "env: ['CartPole-v1'] is unknown"),
    ("halving = 2", "halving: 2 is not allowed: at most as many"),
    ("seeds =", "is not TOML"),
    ("seeds = 1\nseeds = 2", "is not TOML"),
    *((f"[parameters]\n{name} = 3", f"{name}: is no parameter") for name in ("seeds", "seed", "method", "rungs")),
    ("[[settings]]\nsamples = 3", "samples: is no parameter"),
    ('[parameters]\n"ga\\nmma" = 3', "has no such setting"),
    ('[parameters]\ngamma = "a\\nb"', "gamma"),
]


@pytest.mark.parametrize(("text", "said"), WRONG)
def test_a_mistake_is_one_line_that_names_the_file(text, said, file):
    file.write_text(f'preset = "dqn"\n{text}\n')
    with pytest.raises(ValueError, match=r"sweep\.toml: ") as error:
        sweep_files.load(file)
    assert said in str(error.value)
    assert str(error.value).startswith(f"{file}: ")
    assert "\n" not in str(error.value)


def test_what_cannot_be_read_is_one_line_that_names_the_file(tmp_path):
    broken = tmp_path / "broken.toml"
    broken.write_bytes(b'preset = "dqn"\n\xff\xfe')
    for path in (tmp_path / "none.toml", tmp_path, broken):
        with pytest.raises(ValueError, match=r"No such file|Is a directory|is not TOML") as error:
            sweep_files.load(path)
        assert str(error.value).startswith(f"{path}: ")
        assert "\n" not in str(error.value)
    for text, said in (("seeds = 3", "preset: must be named"), ("preset = 3", "preset"), ("preset = 'dqm'", "'dqn'")):
        broken.write_text(text)
        with pytest.raises(ValueError, match=f"broken.toml: .*{said}"):
            sweep_files.load(broken)


WORDS = st.sampled_from(["min", "max", "scale", "values", "env", "gamma", "hidden", "length", "x"]) | st.text(
    max_size=3
)
TOML = st.recursive(
    st.integers(-3, 40) | st.floats() | st.booleans() | st.text(max_size=3) | st.dates() | st.just(10**400),
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(WORDS, inner, max_size=3),
    max_leaves=6,
)
KEYS = st.sampled_from(
    ["seeds", "seed", "prng", "env", "method", "samples", "halving", "rungs", "settings", "parameters"]
)


@given(st.dictionaries(KEYS, TOML | st.dictionaries(WORDS, TOML, max_size=3), max_size=4))
@settings(max_examples=500, deadline=None)
def test_any_file_is_a_plan_or_one_line(file, found):
    file.write_text(tomli_w.dumps({"preset": "dqn", **found}), encoding="utf-8")
    try:
        sweep_files.load(file)
    except ValueError as error:
        assert str(error).startswith(f"{file}: ")  # noqa: PT017 (a plan is as good an answer)
        assert len(str(error).splitlines()) == 1  # noqa: PT017


@pytest.fixture
def dry(tmp_path, monkeypatch, capsys):
    """The counts of a dry run of a file that holds ``text``, with flags."""
    monkeypatch.chdir(tmp_path)

    def run(text, *words):
        if text is not None:
            (tmp_path / "file.toml").write_text(text)
        status = main(["sweep", *words, "--dry-run", "--json"])
        captured = capsys.readouterr()
        assert {path.name for path in tmp_path.iterdir()} <= {"file.toml"}
        return json.loads(captured.out) if status == 0 else (status, captured.out, captured.err)

    return run


def test_a_dry_run_of_a_file_says_what_the_same_flags_say(dry):
    flags = "--gamma 0.99 --hidden 64,64 128,128 none --learning-rate-end none 1e-5 --learning-rate 1e-4:1e-2:log"
    flags += " --env.length 0.25 0.5 --env.masspole 0.2 --seeds 16 --seed 3 --method sobol --samples 8"
    told = dry(EXAMPLE, "file.toml")
    assert told == dry(None, "dqn", *flags.split())
    assert (told["seeds"], told["lanes"]) == (16, 16 * told["settings"])
    assert dry('preset = "dqn"', "file.toml") == dry(None, "dqn")


def test_flags_go_before_the_file(dry):
    counts = partial(dry, EXAMPLE, "file.toml")
    assert counts("--seeds", "2")["lanes"] == 2 * counts()["settings"]
    assert counts("--samples", "3")["settings"] == 3
    assert counts("--hidden", "8")["programs"] == 1
    grid = ("--learning-rate", "1e-3", "--gamma", "0.9", "0.99", "--method", "grid")
    assert dry(EXAMPLE.replace("samples = 8", ""), "file.toml", *grid)["settings"] == 2 * 3 * 2 * 2


@pytest.mark.parametrize(("text", "said"), [*WRONG, ("preset = 'dqm'", "Cannot overwrite")])
def test_a_bad_file_is_exit_2_and_one_line_and_leaves_nothing(text, said, dry):
    status, out, err = dry(f'preset = "dqn"\n{text}\n', "file.toml")
    assert (status, out) == (2, "")
    assert said in err
    assert len(err.strip().splitlines()) == 1


def test_what_no_plan_allows_names_the_file_too(tmp_path, capsys, monkeypatch):
    monkeypatch.chdir(tmp_path)
    Path("s.toml").write_text("preset = 'article-q'\n[parameters]\ngamma = [0.9, 0.95]\n")
    assert main(["sweep", "s.toml"]) == 2
    assert capsys.readouterr().err.startswith(
        "jaxq: error: s.toml: gamma: 0.9,0.95 is not allowed: one number; several"
    )


def test_a_byte_order_mark_is_no_mistake(tmp_path):
    (tmp_path / "s.toml").write_text("preset = 'article-q'\n", encoding="utf-8-sig")
    assert sweep_files.load(tmp_path / "s.toml") == plan("article-q")
