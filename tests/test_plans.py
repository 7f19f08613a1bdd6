"""Plans: what each method makes of the axes, what is counted, what is refused, and what tells two sweeps apart."""

import hashlib
import json
import math

import numpy as np
import pytest

from jaxq import axes
from jaxq.axes import SAMPLES, Range
from jaxq.plans import MAX_SEEDS, plan, spec_hash
from jaxq.presets import preset, settle
from jaxq.worlds import CartPole

GAMMAS, RATES = [0.9, 0.99], Range(1e-4, 1e-2, "log")


def settings_of(name, points):
    return tuple(settle(preset(name), **point) for point in points)


@pytest.mark.parametrize(
    ("method", "values"),
    [
        ("grid", {"gamma": GAMMAS, "hidden": [(8,), (16, 16)], "double": [True, False]}),
        ("random", {"gamma": GAMMAS, "learning_rate": RATES, "batch_size": Range(16, 32)}),
        ("sobol", {"gamma": GAMMAS, "learning_rate": RATES, "env.length": Range(0.25, 1.0)}),
    ],
)
def test_the_settings_are_the_points_of_the_axes(method, values):
    samples = None if method == "grid" else 12
    planned = plan("article-dqn", method=method, samples=samples, seed=5, seeds=3, tau=0.5, **values)
    wanted = axes.points(values, method, samples or 0, seed=5)
    assert planned.settings == settings_of("article-dqn", [{**point, "tau": 0.5} for point in wanted])
    assert planned.lanes == 3 * len(wanted)
    assert planned.varied == tuple(values)
    assert (planned.seeds, planned.root_seed, planned.prng) == ((0, 1, 2), 5, preset("article-dqn").prng)


def test_listed_settings_are_taken_as_they_stand():
    listed = [{"gamma": 0.9, "hidden": (8,)}, {"tau": 0.1}, {"env.length": 0.25, "gamma": "0.95"}, {}]
    planned = plan("article-dqn", settings=listed, batch_size=64, method="list")
    assert planned.settings == settings_of("article-dqn", [{**one, "batch_size": 64} for one in listed])
    assert planned.varied == ("gamma", "hidden", "tau", "env.length")
    assert planned.request.listed[2] == {"env.length": 0.25, "gamma": 0.95}
    assert plan("article-dqn", settings=tuple(listed), batch_size=64) == planned
    assert plan("article-dqn", settings=[{}]).settings == (preset("article-dqn").settings,)


@pytest.mark.parametrize(
    ("values", "method"),
    [
        ({}, "grid"),
        ({"gamma": 0.9}, "grid"),
        ({"gamma": GAMMAS}, "grid"),
        ({"gamma": GAMMAS, "learning_rate": RATES}, "sobol"),
        ({"settings": [{"gamma": 0.9}]}, "list"),
    ],
)
def test_without_a_method_it_is_what_fits(values, method):
    chosen = plan("article-dqn", **values)
    assert chosen.request.method == method
    assert chosen == plan("article-dqn", method=method, **values)


def test_a_range_without_a_number_of_samples_takes_the_usual_one():
    assert (
        plan("article-dqn", learning_rate=RATES).settings
        == plan("article-dqn", learning_rate=RATES, samples=SAMPLES).settings
    )
    assert len(plan("article-dqn", learning_rate=RATES).settings) == SAMPLES


def test_a_random_sweep_draws_from_lists_too_and_keeps_each_setting_once():
    planned = plan("article-dqn", method="random", samples=50, gamma=GAMMAS, double=[False, True])
    assert len(planned.settings) == len(set(planned.settings)) == 4


def test_numbers_share_a_program_and_each_structure_has_its_own():
    numbers = {"gamma": GAMMAS, "env.length": [0.25, 0.5], "env.max_episode_steps": [100, 500], "eval_every": [0, 100]}
    assert plan("article-dqn", **numbers).programs == 1
    structures = {"env.integrator": ["euler", "semi-implicit"], "stop": ["none", "gymnasium"], "batch_size": [8, 16]}
    for name, values in structures.items():
        assert plan("article-dqn", **{name: values}).programs == 2
    both = plan("article-dqn", gamma=GAMMAS, **structures)
    assert (len(both.settings), both.programs) == (16, 8)
    assert (
        plan("article-dqn", settings=[{"gamma": 0.9}, {"hidden": (8,)}, {"gamma": 0.8}, {"env.tau": 0.01}]).programs
        == 2
    )


def test_a_label_names_what_varies_in_the_order_in_which_it_was_given():
    planned = plan("article-dqn", hidden=[(8,), (16, 16), ()], gamma=0.5, learning_rate_end=[None, 1e-5])
    assert planned.label(1) == "hidden 8, learning_rate_end 1e-05"
    assert planned.label(2) == "hidden 16,16, learning_rate_end None"
    assert planned.label(5) == "hidden none, learning_rate_end 1e-05"
    assert plan("article-dqn", gamma=0.5).label(0) == ""
    turned = plan("article-dqn", learning_rate_end=[None, 1e-5], hidden=[(8,), (16, 16)])
    assert turned.label(0) == "learning_rate_end None, hidden 8"
    assert plan("article-dqn", settings=[{"tau": 0.1, "gamma": 0.9}, {"env.length": 0.25}]).varied == (
        "tau",
        "gamma",
        "env.length",
    )


def test_a_spec_is_json_that_holds_every_setting():
    planned = plan(
        "article-dqn", seeds=2, hidden=[(8,), ()], learning_rate_end=[None, 1e-5], **{"env.length": [0.25, 0.5]}
    )
    spec = planned.spec()
    assert json.loads(json.dumps(spec)) == spec
    assert spec_hash(json.loads(json.dumps(spec))) == planned.hash()
    for row, settings in zip(spec["settings"], planned.settings, strict=True):
        told = spec["common"] | dict(zip(spec["varied"], row, strict=True))
        assert set(told) == set(settings.fields())
        read = {name: tuple(value) if isinstance(value, list) else value for name, value in told.items()}
        assert settle(preset("article-dqn"), **read) == settings
    assert (spec["preset"], spec["seeds"], spec["root_seed"], spec["prng"]) == ("article-dqn", 2, 0, "pcg4d")
    assert spec["threshold"] == CartPole.reward_threshold
    assert planned.default_name() == f"article-dqn-{planned.hash()[:8]}"


def test_the_hash_is_that_of_the_canonical_json_whatever_the_order():
    spec = {"preset": "article-dqn", "settings": [[1, 0.1, None, "a", True, [8]]], "b": {"c": 1e-05}}
    canonical = '{"b":{"c":1e-05},"preset":"article-dqn","settings":[[1,0.1,null,"a",true,[8]]]}'
    assert spec_hash(spec) == hashlib.sha256(canonical.encode()).hexdigest()
    assert spec_hash(dict(reversed(spec.items()))) == spec_hash(spec)


def test_a_hash_differs_with_everything_that_decides_a_row_and_with_nothing_else():
    base = {"gamma": GAMMAS, "seeds": 2}
    changes = [
        {"seeds": 3},
        {"seed": 1},
        {"prng": "threefry"},
        {"gamma": [0.9, 0.98]},
        {"gamma": [0.99, 0.9]},
        {"gamma": 0.9},
        {"halving": 2},
        {"halving": 2, "rungs": 1},
        {"tau": 0.5},
        {"hidden": (8,)},
        {"eval_every": 100},
        {"env.length": 0.25},
        {"env.integrator": "semi-implicit"},
        {"learning_rate_end": 1e-5},
    ]
    hashes = [plan("article-dqn", **base).hash(), plan("dqn", **base).hash()]
    hashes += [plan("article-dqn", **{**base, **change}).hash() for change in changes]
    assert len(set(hashes)) == len(hashes)
    same = [
        plan("article-dqn", gamma=["0.90", "0.99"], seeds=2),
        plan("article-dqn", **base, tau=preset("article-dqn").settings.tau),
        plan("article-dqn", **base, env="CartPole-v1"),
        plan("article-dqn", settings=[{"gamma": 0.9}, {"gamma": 0.99}], seeds=2),
    ]
    assert {one.hash() for one in same} == {hashes[0]}


def test_an_environment_with_numbers_of_its_own_is_its_name_with_these_numbers():
    numbers = {"env.length": 0.25, "env.integrator": "semi-implicit"}
    world = CartPole(length=0.25, integrator="semi-implicit")
    assert plan("article-dqn", env=world) == plan("article-dqn", env="CartPole-v1", **numbers)
    assert plan("article-dqn", env=world, **{"env.length": [0.3, 0.4]}).settings[1].env.length == 0.4


TWO = {"gamma": GAMMAS}


@pytest.mark.parametrize(
    ("values", "said"),
    [
        ({"seeds": MAX_SEEDS + 1}, f"seeds: {MAX_SEEDS + 1} is not allowed: an integer from 1 to {MAX_SEEDS}"),
        ({"seeds": "3"}, "seeds: '3' is not allowed"),
        ({"seed": 2**32}, f"seed: {2**32} is not allowed: an integer from 0 to {2**32 - 1}"),
        ({**TWO, "halving": 1}, "halving: 1 is not allowed: an integer from 2"),
        ({**TWO, "halving": 2.0}, "halving: 2.0 is not allowed"),
        ({**TWO, "halving": 3}, "halving: 3 is not allowed: at most as many as there are settings, 2"),
        ({**TWO, "rungs": 1}, "rungs: 1 is not allowed without halving"),
        ({**TWO, "halving": 2, "rungs": 0}, "rungs: 0 is not allowed: an integer from 1 to 100"),
        ({"samples": 0, "learning_rate": RATES}, "samples: 0 is not allowed: an integer from 1 to 1000000"),
        ({"samples": 8}, "samples: 8 is not allowed with the method grid"),
        ({"samples": 8, "settings": [{}]}, "samples: 8 is not allowed with the method list"),
        ({"method": "sobel"}, "method: 'sobel' is unknown; did you mean 'sobol'"),
        ({"method": 3}, "method: 3 is unknown; known: grid, random, sobol, list"),
        ({"prng": 3}, "prng: 3 is unknown"),
        ({"method": "list"}, "settings: the method list needs them"),
        ({"method": "grid", "settings": [{}]}, "no other method takes them"),
        ({"settings": []}, "settings: [] is not allowed: at least one, each a mapping"),
        ({"settings": 3}, "settings: 3 is not allowed"),
        ({"settings": [3]}, "settings: [3] is not allowed"),
        ({"settings": {"gamma": 0.9}}, "settings: {'gamma': 0.9} is not allowed"),
        ({"gamma": True}, "gamma: True is not allowed: a number"),
        ({"env.length": [0.5, False]}, "env.length: False is not allowed: a number"),
        ({"batch_size": True}, "batch_size: True is not allowed: a number"),
        ({"gamma": (0.9, 0.95)}, "gamma: 0.9,0.95 is not allowed: one number; several are an axis, in a list"),
        ({"gamma": [0.9, 0.9000000001]}, "gamma: 0.9000000001 stands twice"),
        ({"hidden": 64}, "hidden: 64 is not allowed: whole numbers, as in 64,64"),
        ({"hidden": Range(64, 128)}, "hidden: 64:128 is not allowed: it takes no range"),
        ({"settings": [{"gamma": 0.9}], "tau": [0.1, 0.2]}, "tau: an axis is not allowed beside settings"),
        ({"settings": [{"gama": 0.9}]}, "gama: article-dqn has no such setting; did you mean 'gamma'"),
        ({"settings": [{"gamma": 0.9}, {"gamma": 1.5}]}, "gamma: 1.5 is not allowed: input should be less than"),
        ({"settings": [{"gamma": 0.9}, {"tau": 0.5}, {"gamma": "0.90"}]}, "number 0 and number 2 are the same"),
        ({"settings": [{}, {"gamma": 0.99}]}, "settings: number 0 and number 1 are the same"),
        ({"gamma": [0.9, "0.9"]}, "gamma: 0.9 stands twice"),
        ({"hidden": [(8, 8), "8,8"]}, "hidden: 8,8 stands twice"),
        ({"hidden": []}, "hidden: [] is not allowed: at least one value"),
        ({"gamma": [0.9, [0.8]]}, "gamma: [0.8] is not allowed"),
        ({"gamma": Range(0.5, 1.5)}, "gamma: 1.5 is not allowed: input should be less than or equal to 1"),
        ({"learning_rate": Range(-1.0, 1.0)}, "learning_rate: -1.0 is not allowed: input should be greater than 0"),
        ({"batch_size": Range(8.0, 16.0)}, "batch_size: 8.0 is not allowed: a whole number"),
        ({"double": Range(0, 1)}, "double: 0:1 is not allowed: it takes no range"),
        ({"learning_rate": RATES, "method": "grid"}, "learning_rate: a range needs the method random or sobol"),
        ({"env.length": -1.0}, "env.length: -1.0 is not allowed"),
        ({"env.lenght": 0.5}, "env.lenght: article-dqn has no such setting; did you mean 'env.length'"),
        ({"env.reset_low": [0.0, 1.0]}, "env.reset_low: 1.0 must not be above reset_high"),
        ({"env": ["CartPole-v1"]}, "env: ['CartPole-v1'] is unknown"),
        ({"env": {}}, "env: {} is unknown"),
        ({"max_episodes": 2**31}, f"max_episodes: {2**31} is not allowed"),
        ({"gamma": math.nan}, "gamma: nan is not allowed"),
    ],
)
def test_a_plan_that_cannot_be_names_the_field_the_value_and_what_is_allowed(values, said):
    with pytest.raises(ValueError, match=r"^[\w.]+: ") as error:
        plan("article-dqn", **values)
    assert said in str(error.value)
    assert "\n" not in str(error.value)


def test_a_grid_of_more_than_a_million_settings_is_refused_before_it_is_made():
    many = [i / 2000 for i in range(1001)]
    with pytest.raises(ValueError, match="settings: 1002001 is not allowed: at most 1000000"):
        plan("article-dqn", gamma=many, tau=many)


def test_an_array_and_a_range_of_python_are_axes():
    listed = plan("article-dqn", gamma=[0.5, 0.75], batch_size=[8, 16])
    assert plan("article-dqn", gamma=np.linspace(0.5, 0.75, 2), batch_size=range(8, 17, 8)) == listed
    assert plan("article-dqn", gamma=np.float64(0.5)).settings == plan("article-dqn", gamma=0.5).settings


def test_a_listed_setting_goes_before_what_holds_for_all():
    made = plan("article-dqn", gamma=0.8, tau=0.1, settings=[{"gamma": 0.9}, {"tau": 0.5}])
    assert [(one.gamma, one.tau) for one in made.settings] == [(0.9, 0.1), (0.8, 0.5)]
    assert made.varied == ("gamma", "tau")
