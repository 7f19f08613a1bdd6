"""Presets and plans: ranges, errors that name the field, axes, structures."""

import math

import pytest

from jaxq import families
from jaxq.plans import plan
from jaxq.presets import DQNSettings, TabularSettings, preset, presets, settle


def test_the_tutorials_presets_are_the_tutorials_numbers():
    table, network = preset("article-q").settings, preset("article-dqn").settings
    assert (table.epsilon_min, table.epsilon_max, table.alpha_min, table.alpha_max) == (0.01, 1, 0.1, 0.5)
    assert (table.gamma, table.decay_coeff, table.max_episodes, table.env.max_episode_steps) == (0.99, 25, 5000, 500)
    assert (table.success_steps, table.success_streak, table.num_buckets) == (450, 50, (1, 1, 6, 3))
    assert table.bootstrap_terminal
    assert not preset("q-learning").settings.bootstrap_terminal
    assert (network.learning_rate, network.weight_decay, network.tau, network.gamma) == (1e-4, 0.01, 0.005, 0.99)
    assert (network.epsilon_start, network.epsilon_end, network.epsilon_decay) == (0.9, 0.05, 1000)
    assert (network.hidden, network.batch_size, network.buffer_size) == ((128, 128), 128, 10_000)
    assert (network.learning_starts, network.max_episodes, network.success_steps) == (128, 600, 450)
    assert (network.clip, network.clip_at, network.loss, network.huber_delta) == ("value", 100, "huber", 1)
    assert not network.double
    assert not network.replacement


def test_every_setting_has_help_and_a_kind():
    for one in (TabularSettings(), DQNSettings()):
        for name, info in one.fields().items():
            assert info.description
            assert isinstance(one.is_structure(name), bool)


@pytest.mark.parametrize(
    ("name", "value", "allowed"),
    [
        ("gamma", 1.5, "less than or equal to 1"),
        ("gamma", -0.1, "greater than or equal to 0"),
        ("gamma", math.nan, "finite"),
        ("alpha_max", math.inf, "finite"),
        ("gamma", "high", "high is not allowed: a number"),
        ("max_episodes", 0, "greater than or equal to 1"),
        ("max_episodes", 2.5, "whole number"),
        ("decay_coeff", 0, "greater than 0"),
        ("num_buckets", (1, 1, 6), "too few values"),
        ("num_buckets", (1, 1, 6, 3, 4), "1,1,6,3,4 is not allowed: too many values"),
        ("num_buckets", (1, 1, 0, 3), "at least 1"),
        ("gamma", "", "gamma: '' is not allowed"),
        ("decay_coeff", 1e-300, "1e-300 is not allowed: a size from"),
        ("initial_value", 1e-300, "1e-300 is not allowed: 0, or a size from"),
        ("epsilon_min", 2, "less than or equal to 1"),
        ("bootstrap_terminal", "perhaps", "true or false"),
    ],
)
def test_a_bad_value_is_named_with_what_is_allowed(name, value, allowed):
    with pytest.raises(ValueError, match=allowed) as error:
        settle(preset("article-q"), **{name: value})
    message = str(error.value)
    assert name in message
    assert "\n" not in message


@pytest.mark.parametrize(
    ("values", "named"),
    [
        ({"epsilon_min": 0.5, "epsilon_max": 0.1}, "epsilon_min"),
        ({"alpha_min": 0.5, "alpha_max": 0.1}, "alpha_min"),
    ],
)
def test_minimum_above_maximum_is_refused(values, named):
    with pytest.raises(ValueError, match=f"{named}.*must not be above"):
        settle(preset("q-learning"), **values)


@pytest.mark.parametrize(
    "values",
    [
        {"learning_rate": math.nan},
        {"learning_rate": 0},
        {"hidden": (128, 0)},
        {"learning_starts": 20_000},
        {"batch_size": 129},
        {"batch_size": 129, "buffer_size": 128, "replacement": True},
        {"weight_decay": 1e39},
        {"epsilon_decay": 1e-300},
        {"loss": "absolute"},
        {"buffer_size": 4, "learning_starts": 4, "batch_size": 4, "num_envs": 8},
    ],
)
def test_a_dqn_that_cannot_be_is_refused(values):
    with pytest.raises(ValueError, match=next(iter(values))):
        settle(preset("article-dqn"), **values)


def test_unknown_names_come_with_a_suggestion():
    with pytest.raises(ValueError, match="did you mean 'article-q'"):
        preset("artcle-q")
    with pytest.raises(ValueError, match="did you mean 'gamma'"):
        settle(preset("article-q"), gama=0.5)
    with pytest.raises(ValueError, match="did you mean 'pcg4d'"):
        plan("article-q", prng="pcg4")


@pytest.mark.parametrize("values", [{"seeds": 0}, {"seeds": True}, {"seeds": 1.0}, {"root_seed": -1}, {"gamma": []}])
def test_a_plan_that_cannot_be_is_refused(values):
    with pytest.raises(ValueError, match=r"seed|gamma"):
        plan("article-q", **values)


def test_lists_are_axes_and_the_last_is_fastest():
    planned = plan("article-q", gamma=[0.9, 0.99], alpha_min=[0.0, 0.1, 0.2], epsilon_min=0.05, seeds=5)
    assert [(s.gamma, s.alpha_min) for s in planned.settings] == [(g, a) for g in (0.9, 0.99) for a in (0.0, 0.1, 0.2)]
    assert {s.epsilon_min for s in planned.settings} == {0.05}
    assert planned.varied == ("gamma", "alpha_min")
    assert (planned.lanes, planned.programs) == (30, 1)


def test_structures_make_programs_and_numbers_do_not():
    assert plan("article-dqn", hidden=[(64,), (32, 32)], double=[False, True], gamma=[0.9, 0.99]).programs == 4


def test_a_value_that_stands_twice_is_refused():
    with pytest.raises(ValueError, match=r"gamma: 0\.9 stands twice"):
        plan("article-q", gamma=["0.9", "0.90"])


def test_a_plan_is_known_by_all_that_decides_its_result():
    base = plan("article-q", seeds=2)
    assert plan("article-q", seeds=2, gamma=0.99).hash() == base.hash()
    others = [
        plan("q-learning", seeds=2),
        plan("article-q", seeds=3),
        plan("article-q", seeds=2, seed=1),
        plan("article-q", seeds=2, gamma=0.98),
        plan("article-q", seeds=2, prng="threefry"),
    ]
    assert len({one.hash() for one in [base, *others]}) == 6


def test_every_preset_plans_with_a_known_key_family():
    tables = (
        "article-q q-learning sarsa expected-sarsa double-q-learning n-step-q-learning q-lambda sarsa-lambda dyna-q"
    )
    assert [p.name for p in presets()] == [*tables.split(), "monte-carlo", "article-dqn", "dqn"]
    for p in presets():
        assert plan(p.name).prng in families.FAMILIES
