"""Sweeps of a user's own function: what it returns when called directly, lane by lane, once per setting and seed."""

import math
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxq
from jaxq import functions, prng
from jaxq.axes import Range
from jaxq.manifest import RunError
from jaxq.sweep_files import text

pytestmark = pytest.mark.usefixtures("programs_are_compiled_once")


class Pair(NamedTuple):
    first: jax.Array
    second: jax.Array


def drawn(key, hypers):
    """What the key draws, times a number: no two operations that a compiler may join with another rounding."""
    one, two, three = jax.random.split(key, 3)
    many = jax.random.uniform(one, (3,))
    return {
        "scaled": hypers.rate * many[0],
        "nested": {"many": many, "pair": Pair(jax.random.bits(two, (), "uint32") >> 1, hypers.count + 1)},
        "listed": [many[1] < 0.5, jax.random.normal(three, (2, 2))],
    }


def rows(swept):
    return swept.lanes.to_pylist()


@pytest.mark.parametrize("root_seed", [0, 7])
@pytest.mark.parametrize("family", ["threefry", "pcg4d"])
def test_a_lane_is_the_function_called_with_its_key_and_values(root_seed, family):
    axes = {"rate": [0.5, 2.0, 3.0], "count": [1, 10]}
    swept = jaxq.sweep(drawn, **axes, seeds=5, seed=root_seed, prng=family)
    found = rows(swept)
    assert [(row["config"], row["seed"]) for row in found] == [(c, s) for c in range(6) for s in range(5)]
    assert swept.complete
    for row in found:
        rate, count = axes["rate"][row["config"] // 2], axes["count"][row["config"] % 2]
        assert (row["rate"], row["count"], row["status"]) == (rate, count, "finished")
        key = jax.random.fold_in(prng.key(root_seed, family), row["seed"])
        wanted = drawn(key, type("Values", (), {"rate": np.float32(rate), "count": np.int32(count)}))
        assert row["scaled"] == float(wanted["scaled"])
        assert row["nested.many"] == wanted["nested"]["many"].tolist()
        assert row["nested.pair.first"] == int(wanted["nested"]["pair"].first)
        assert row["nested.pair.second"] == count + 1
        assert row["listed.0"] is bool(wanted["listed"][0])
        np.testing.assert_allclose(row["listed.1"], wanted["listed"][1], rtol=1e-6)
    kinds = [str(kind) for kind in swept.lanes.schema.types]
    assert kinds[:5] == ["int64", "int64", "double", "int64", "string"]
    assert dict(zip(swept.lanes.column_names[5:], kinds[5:], strict=True)) == {
        "scaled": "double",
        "nested.many": "list<item: double>",
        "nested.pair.first": "int64",
        "nested.pair.second": "int64",
        "listed.0": "bool",
        "listed.1": "list<item: list<item: double>>",
    }


@pytest.mark.parametrize(
    ("fn", "wanted"),
    [
        (lambda key, hypers: hypers.x * 2, {"result": 3.0}),
        (lambda key, hypers: 4, {"result": 4}),
        (lambda key, hypers: (hypers.x, [hypers.x > 1]), {"0": 1.5, "1.0": True}),
        (lambda key, hypers: {"a": jnp.zeros((0,)), "b": jnp.ones((1, 2), int)}, {"a": [], "b": [[1, 1]]}),
    ],
)
def test_leaves_have_the_names_of_their_paths(fn, wanted):
    (row,) = rows(jaxq.sweep(fn, x=1.5))
    assert row == {"config": 0, "seed": 0, "x": 1.5, "status": "finished", **wanted}


def test_numbers_are_traced_and_the_rest_is_plain():
    seen = []

    def look(key, hypers):
        seen.append(hypers)
        assert hypers._fields == ("rate", "count", "mixed", "word", "flag", "sizes", "absent")
        assert [leaf.dtype for leaf in hypers[:3]] == [jnp.float32, jnp.int32, jnp.float32]
        assert hypers[3:] in (("none", True, (1, (2, 3)), None), ("none", True, (1, (2, 3)), "there"))
        return jax.random.uniform(key)

    values = {"word": "none", "flag": True, "sizes": (1, (2, 3)), "absent": [None, "there"]}
    swept = jaxq.sweep(look, rate=0.5, count=[1, 2], mixed=[1, 0.5], **values)
    assert len(seen) >= 2
    assert swept.lanes["mixed"].to_pylist() == [1.0, 1.0, 0.5, 0.5] * 2
    assert swept.lanes["absent"].to_pylist() == [None, "there"] * 4
    assert swept.varied == ["count", "mixed", "absent"]
    assert swept.label(1) == "count 1, mixed 1.0, absent there"


def test_the_function_is_traced_once_for_all_numbers_and_once_more_for_each_structure():
    traces = 0

    def counted(key, hypers):
        nonlocal traces
        traces += 1
        return hypers.x * jax.random.uniform(key) if hypers.way == "up" else -hypers.x

    def count(**values):
        nonlocal traces
        traces = 0
        timing = jaxq.sweep(counted, **values).timing
        return traces, timing.programs

    once, programs = count(x=1.0, way="up")
    assert programs == 1
    assert count(x=[float(i) for i in range(20)], way="up", seeds=10) == (once, 1)
    assert count(x=Range(0.0, 1.0), way="up", samples=16) == (once, 1)
    assert count(x=[1.0, 2.0], way=["up", "down"]) == (2 * once, 2)


def test_the_width_of_a_group_changes_nothing():
    base = rows(jaxq.sweep(drawn, rate=[0.5, 2.0], count=3, seeds=7))
    for width in (1, 3, 16):
        assert rows(jaxq.sweep(drawn, rate=[0.5, 2.0], count=3, seeds=7, width=width)) == base
    assert rows(jaxq.sweep(drawn, rate=[0.5, 2.0], count=3, seeds=4, workers=1)) == [r for r in base if r["seed"] < 4]


def unsteady(key, hypers):
    draw = jax.random.uniform(key)
    return {"root": jnp.sqrt(hypers.x), "both": jnp.stack([jnp.log(hypers.x), draw]), "draw": draw, "whole": 3}


def test_a_result_that_is_not_finite_is_diverged_and_changes_no_neighbour():
    calm = rows(jaxq.sweep(unsteady, x=[1.0, 2.0], seeds=6))
    mixed = rows(jaxq.sweep(unsteady, x=[1.0, -1.0, 0.0, 2.0], seeds=6))
    assert [{**row, "config": row["config"] // 3} for row in mixed if row["x"] >= 1] == calm
    assert all(row["status"] == "finished" for row in calm)
    for row in mixed:
        if row["x"] < 1:
            assert row["status"] == "diverged"
            assert row["root"] == (None if row["x"] < 0 else 0.0)
            assert row["both"] == [None, row["draw"]]
            assert (row["draw"], row["whole"]) == (calm[row["seed"]]["draw"], 3)
    summary = jaxq.sweep(unsteady, x=[1.0, -1.0], seeds=6).summary()
    assert [row["diverged"] for row in summary] == [0, 6]
    assert (summary[0]["root"], summary[1]["root"]) == (1.0, None)
    assert summary[0]["draw_low"] < summary[0]["draw"] == summary[1]["draw"] < summary[0]["draw_high"]


def test_listed_settings_and_ranges_make_lanes_as_they_stand():
    listed = [{"x": 1, "way": "a"}, {"x": 2.5, "way": "b"}]
    found = rows(jaxq.sweep(lambda key, hypers: hypers.x, settings=listed, y=(1, 2)))
    assert [(row["x"], row["way"], row["y"], row["result"]) for row in found] == [
        (1, "a", "1,2", 1),
        (2.5, "b", "1,2", 2.5),
    ]
    planned = functions.plan(drawn, rate=Range(0, 1.0), count=Range(1, 3), samples=40, method="random", seeds=2)
    assert {one.count for one in planned.settings} == {1, 2, 3}
    assert len({one.rate for one in planned.settings}) == 40
    assert (planned.lanes, planned.programs, planned.name) == (80, 1, "drawn")


def test_numpys_numbers_are_numbers():
    values = {"rate": list(np.linspace(0, 1, 3)), "count": list(np.arange(2)), "small": np.float32(0.5)}
    assert functions.plan(drawn, **values) != functions.plan(drawn, **values)  # each is a kind of its own
    same = functions.plan(drawn, rate=[0.0, 0.5, 1.0], count=[0, 1], small=0.5)
    assert functions.plan(drawn, **values).hash() == same.hash()
    assert functions.plan(drawn, settings=[{"x": np.int64(3)}]).settings[0].x == 3


CALLS = []


def told(key, hypers):
    CALLS.append(hypers)
    return {"draw": jax.random.uniform(key, (2,)) * hypers.x, "length": len(hypers.mode)}


def test_a_finished_sweep_is_read_again_and_calls_nothing(tmp_path):
    values = {"x": [1.0, 2.0], "mode": ["a", "bb"], "seeds": 3}
    first = jaxq.sweep(told, out=tmp_path / "run", **values)
    assert CALLS
    CALLS.clear()
    again = jaxq.sweep(told, out=tmp_path / "run", resume=True, **values)
    assert not CALLS
    assert again.lanes == first.lanes == jaxq.load(tmp_path / "run").lanes
    assert rows(first) == rows(jaxq.sweep(told, **values))
    assert not (tmp_path / "run" / "sweep.toml").exists()  # no file can hold a function
    with pytest.raises(ValueError, match="not what a file can say"):
        text(functions.plan(told, x=1.0, mode="a"))


def test_another_function_of_the_same_name_is_another_sweep(tmp_path):
    jaxq.sweep(told, x=1.0, mode="a", out=tmp_path / "run")

    def other(key, hypers):
        return hypers.x

    other.__name__ = "told"
    assert functions.plan(told, x=1.0).name == functions.plan(other, x=1.0).name
    with pytest.raises(RunError, match="source was"):
        jaxq.sweep(other, x=1.0, mode="a", out=tmp_path / "run", resume=True)


@pytest.mark.parametrize(
    ("values", "said"),
    [
        ({"x": 1.0, "width": 0}, "width: 0 is not allowed: an integer from 1"),
        ({"x": 1.0, "width": True}, "width: True is not allowed"),
        ({"x": 1.0, "seeds": 0}, "seeds: 0 is not allowed"),
        ({"x": [1.0, 1]}, "x: 1.0 stands twice"),
        ({"x": []}, "x: [] is not allowed: at least one value"),
        ({"x": math.nan}, "x: nan is not allowed: input should be a finite number"),
        ({"x": [1.0, math.inf]}, "x: inf is not allowed"),
        ({"x": 1e39}, "x: 1e+39 is not allowed"),
        ({"x": 2**31}, f"x: {2**31} is not allowed: a whole number of 32 bits"),
        ({"x": [1, "a"]}, "x: 1, a are not of one kind"),
        ({"x": [True, 2]}, "x: True, 2 are not of one kind"),
        ({"x": np.zeros((1, 2))}, "x: array([[0., 0.]]) is not allowed: a number, a truth value, a word or a tuple"),
        ({"x": {"a": 1}}, "x: {'a': 1} is not allowed"),
        ({"x": [[1, 2], [3]]}, "x: [1, 2] is not allowed"),
        ({"x": Range(1, 3), "method": "grid"}, "x: a range needs the method random or sobol"),
        ({"x": ["a", Range(1, 3)]}, "x: "),
        ({"settings": [{"x": 1}, {"y": 2}]}, "x: is not a value of every setting"),
        ({"settings": [{"x": 1, "y": 2}, {"x": 3}]}, "y: is not a value of every setting"),
        ({"settings": [3]}, "settings: [3] is not allowed"),
        ({"settings": 3}, "settings: 3 is not allowed"),
        ({"class": 1}, "class: is not allowed as the name of a value"),
        ({"_x": 1}, "_x: is not allowed as the name of a value"),
        ({"flat": 1}, "flat: is not allowed as the name of a value"),
        ({"config": 1}, "config: is not allowed as the name of a value"),
    ],
)
def test_values_that_cannot_be_are_refused_in_one_line(values, said):
    with pytest.raises(ValueError, match=r"^\w+: ") as error:
        jaxq.sweep(drawn, **values)
    assert said in str(error.value)
    assert "\n" not in str(error.value)


@pytest.mark.parametrize(
    ("fn", "said"),
    [
        (lambda key, hypers: None, "returns nothing"),
        (lambda key, hypers: {}, "returns nothing"),
        (lambda key, hypers: hypers.x * 1j, "an array of complex64"),
        (lambda key, hypers: {"a": key}, "an array of key<"),
        (lambda key, hypers: {"seed": hypers.x}, "seed: is returned by the function"),
        (lambda key, hypers: {"x": hypers.x}, "x: is returned by the function"),
        (lambda key, hypers: hypers, "x: is returned by the function"),
    ],
)
def test_results_that_no_table_holds_are_refused_in_one_line(fn, said):
    with pytest.raises(ValueError, match=r"returns|returned") as error:
        jaxq.sweep(fn, x=1.0)
    assert said in str(error.value)
    assert "\n" not in str(error.value)


def test_an_error_of_the_function_is_the_callers():
    with pytest.raises(AttributeError, match="rte"):
        jaxq.sweep(lambda key, hypers: hypers.rte, rate=1.0)


def test_a_listed_setting_goes_before_a_value_of_all():
    swept = jaxq.sweep(
        lambda key, hypers: {"sum": hypers.x + hypers.y}, x=1, y=0.5, settings=[{}, {"x": 2}, {"y": 0.25}]
    )
    assert swept.lanes["sum"].to_pylist() == [1.5, 2.5, 1.25]
