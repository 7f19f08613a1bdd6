"""The limits, the ratios and the page of ``python -m benchmarks``."""

import ctypes
import json
import shutil

import jax.numpy as jnp
import numpy as np
import pytest

from benchmarks import __main__ as benchmarks
from benchmarks import beside, page
from benchmarks.limits import c, products
from jaxq.bench import command, contest, suites
from jaxq.bench.contest import Contender
from jaxq.envs import CartPoleParams, CartPoleState, cartpole


@pytest.fixture(scope="module")
def compiler():
    return shutil.which("gcc") or shutil.which("cc")


def test_the_c_environment_steps_as_ours(compiler):
    if not compiler:
        with pytest.raises(RuntimeError, match="no C compiler"):
            c.compile_c("env")
        return
    function = c.compile_c("env").env_steps
    function.restype = ctypes.c_int64
    rng = np.random.default_rng(0)
    count = 4 * c.BLOCK
    before = [rng.uniform(-limit, limit, count).astype(np.float32) for limit in (2.45, 1, 0.22, 1)]
    before += [rng.integers(0, 500, count, dtype=np.int32), rng.integers(1, 2**32, count, dtype=np.uint32)]
    after = [array.copy() for array in before]
    pointers = [array.ctypes.data_as(ctypes.c_void_p) for array in after]
    ended = function(ctypes.c_int64(count), ctypes.c_int64(1), *pointers)
    env = cartpole(CartPoleParams())
    over_in_all = 0
    for i in range(count):
        word = int(before[5][i])
        for shift in (13, -17, 5):  # xorshift32
            word ^= (word << shift if shift > 0 else word >> -shift) & 0xFFFFFFFF
        state = CartPoleState(*(jnp.asarray(array[i]) for array in before[:5]))
        ours, happened = env.step(None, state, jnp.int32(word >> 16 & 1))
        over = bool(happened.terminated | happened.truncated)
        over_in_all += over
        found = [array[i] for array in after[:4]]
        if over:
            assert after[4][i] == 0
            assert np.abs(found).max() <= 0.05
        else:
            assert after[4][i] == before[4][i] + 1
            np.testing.assert_allclose(found, ours[:4], rtol=1e-5, atol=1e-6)
    assert ended == over_in_all
    assert 0 < ended < count
    assert np.float32(1e-40) * np.float32(1) > 0  # loading it has not switched subnormal numbers off


def test_the_c_table_learns(compiler):
    if not compiler:
        return  # the other test says so
    library = c.compile_c("table")
    library.table_updates.restype = ctypes.c_int64
    lanes = np.zeros((64, c.LANE_BYTES), np.uint8)
    pointer = lanes.ctypes.data_as(ctypes.c_void_p)
    library.table_init(ctypes.c_int64(64), pointer, ctypes.c_uint64(0))

    def episode_length(updates):
        return 64 * updates / library.table_updates(ctypes.c_int64(64), ctypes.c_int64(updates), pointer)

    assert episode_length(500) < 40
    episode_length(100_000)
    assert episode_length(20_000) > 150


def test_products_count_whole_groups(monkeypatch):
    monkeypatch.setattr(products, "LOOPS", 4)
    assert products.prepare("1", "64-64")() == products.GROUP * 4


def fake(medians):
    rows = [
        {"contender": name, "case": case, "rates": [m], "median": m, "spread": 0.1, "error": None, "prepare_s": 1.0}
        for (name, case), m in medians.items()
    ]
    rows.append({"contender": "gymnax", "case": "1", "rates": [], "median": None, "spread": None, "error": "no | x"})
    return {
        "suite": "env",
        "unit": "env steps",
        "axis": "environments",
        "machine": {"cpu": "a processor", "cores": 2, "system": "Linux"},
        "began": "2026-01-02T03:04:05Z",
        "repeats": 3,
        "seconds": 0.5,
        "versions": {"jaxq": {"python": "3.11.0", "jax": "0.10.2"}, "gymnax": {}},
        "rows": rows,
    }


def test_a_ratio_tells_what_its_turns_say():
    result = fake({("jaxq", "64"): 400.0, ("Gymnasium, vector", "1"): 40.0})
    for row, rates in zip(result["rows"], [[380.0, 400.0, 420.0], [40.0, 50.0, 35.0]], strict=False):
        row["rates"] = rates
    (vector, _) = benchmarks.judged(result)["ratios"]
    assert vector["turns"] == [9.5, 8.0, 12.0]
    assert benchmarks.sentence(vector).endswith("each at its best: 10 [8, 12] (bar 8)")


@pytest.fixture
def small(tmp_path, monkeypatch):
    """Two suites of nothing, and a place for their results."""
    path = tmp_path / "contender.py"
    path.write_text("def prepare(case):\n    return lambda: 1.0\n")
    for name in ("env", "tabular"):
        one = suites.Suite(name, "a test", "steps", "lanes", [Contender("jaxq", str(path), ("1", "2"))], 1, 0.0)
        monkeypatch.setitem(suites.SUITES, name, one)
        monkeypatch.setitem(beside.LIMITS, name, [Contender("a limit", str(path), ("1",))])
    monkeypatch.setattr(benchmarks, "RESULTS", tmp_path / "results")
    monkeypatch.setenv("PYTHONPATH", "")
    return tmp_path / "results"


def test_a_whole_suite_is_kept_as_it_ends(small, monkeypatch, capsys):
    ran = []

    def contest_or_ctrl_c(contenders, **options):
        ran.append([contender.name for contender in contenders])
        if len(ran) == 2:
            raise KeyboardInterrupt
        return contest.contest(contenders, **options)

    monkeypatch.setattr(command, "contest", contest_or_ctrl_c)
    assert benchmarks.main(["env", "tabular", "--quiet"]) == 130
    assert "interrupted; suites that ended are kept" in (told := capsys.readouterr()).err
    assert ran == [["jaxq", "a limit"]] * 2
    assert [path.name for path in small.iterdir()] == ["env.json"]
    kept = json.loads((small / "env.json").read_text())
    assert len(kept["rows"]) == 3
    assert kept["ratios"] == kept["flatness"] == []
    assert "env: a test" in told.out


def test_a_suite_in_which_one_of_ours_fails_replaces_nothing(small, monkeypatch, capsys):
    assert benchmarks.main(["env", "--quiet"]) == 0
    before = (small / "env.json").read_text()
    bad = small.parent / "bad.py"
    bad.write_text("def prepare(case):\n    raise ValueError('no')\n")
    mine = Contender("jaxq", str(bad), ("1",))
    monkeypatch.setitem(suites.SUITES, "env", suites.Suite("env", "a test", "steps", "lanes", [mine], 1, 0.0))
    assert benchmarks.main(["env", "--quiet"]) == 1
    assert "not kept: one of ours failed" in capsys.readouterr().err
    assert (small / "env.json").read_text() == before
    assert [path.name for path in small.iterdir()] == ["env.json"]
    monkeypatch.setitem(beside.LIMITS, "env", [Contender("a limit", str(bad), ("1",))])
    good = Contender("jaxq", str(small.parent / "contender.py"), ("1",))
    monkeypatch.setitem(suites.SUITES, "env", suites.Suite("env", "a test", "steps", "lanes", [good], 1, 0.0))
    assert benchmarks.main(["env", "--quiet"]) == 0  # a limit or a peer that fails is told, and kept
    assert "ValueError: no" in (small / "env.json").read_text()


def test_a_part_of_a_suite_replaces_nothing(small, capsys):
    for words in (["--cases", "1"], ["--repeats", "2"], ["--seconds", "0"]):
        assert benchmarks.main(["env", *words]) == 0
        assert "not kept" in capsys.readouterr().err
    assert not small.exists()


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["evn"], "suite 'evn' is unknown; did you mean 'env'?"),
        (["env", "tabular", "--cases", "1", "3"], "cases: env has no 3; known: 1, 2"),
        (["--pears"], "--pears is unknown to python -m benchmarks; did you mean '--peers'?"),
    ],
)
def test_a_mistake_is_one_line(small, capsys, words, message):
    assert benchmarks.main(words) == 2
    assert capsys.readouterr() == ("", f"python -m benchmarks: error: {message}\n")
    assert not small.exists()


def test_ratios_and_the_page():
    result = fake({("jaxq", "64"): 400.0, ("jaxq", "1"): 2.0, ("Gymnasium, vector", "1"): 40.0})
    result = benchmarks.judged(result)
    found = {row["other"]: row["ratio"] for row in result["ratios"]}
    assert found == {"Gymnasium, vector": 10.0, "gymnax": None}  # each at its best; who did not run is not hidden
    lines = [benchmarks.sentence(row) for row in result["ratios"]]
    assert "jaxq / Gymnasium, vector, each at its best: 10 (bar 8)" in lines
    assert "jaxq / gymnax, each at its best: no figure" in lines
    text = page.page({"env": result})
    assert "| jaxq | Gymnasium, vector | each at its best | 10 | 8 |  |" in text
    assert "- gymnax: no | x" in text
    assert "jaxq: python 3.11.0, jax 0.10.2." in text
    assert "gymnax: did not start." in text


def test_the_picture_shows_who_ran(tmp_path):
    page.picture(fake({("jaxq", "64"): 400.0, ("jaxq", "1"): 2.0}), tmp_path / "env.png")
    assert (tmp_path / "env.png").stat().st_size > 5000


def test_every_ratio_names_contenders_that_run():
    for bar in beside.BARS:
        names = {one.name: one for one in suites.SUITES[bar.suite].contenders}
        others = {
            one.name: one
            for one in [*beside.LIMITS.get(bar.suite, ()), *beside.PEERS_OF.get(bar.suite, ()), *names.values()]
        }
        assert bar.ours in names
        assert bar.other in others
        if bar.case:
            assert bar.case in names[bar.ours].cases
            assert bar.case in others[bar.other].cases
    for contenders in [*beside.LIMITS.values(), *beside.PEERS_OF.values()]:
        assert len({contender.name for contender in contenders}) == len(contenders)
