"""``jaxq verify`` finds nothing wrong here, and finds what is wrong by a thousandth, a bit or a count."""

import json
import sys
from pathlib import Path
from types import SimpleNamespace

import jax
import pytest

from jaxq import cli, envs, executables, prng, rules, verify
from jaxq.envs import toy_text
from jaxq.verify import checks, compiles, environments, episodes, keys, lanes, outcomes, resets
from jaxq.verify import rules as rule_checks
from jaxq.worlds import WORLDS, FrozenLake

#: By name: "envs" has functions of these names.
acrobot, cartpole, mountain_car, pendulum = (
    sys.modules[f"jaxq.envs.{name}"] for name in ("acrobot", "cartpole", "mountain_car", "pendulum")
)


def job(group, name, cases=30):
    """The one check of this name, run."""
    (found,) = [one for one in verify.jobs([group], cases=cases) if one.name == name]
    return checks.run(found)


def test_what_a_run_prints_and_its_exit_status(monkeypatch, capsys):
    everything = verify.jobs
    cheap = ("MountainCar-v0", "FrozenLake-v1: ", "pcg4d: ", "every public name", "td_error gradient")

    def few(*args, **options):
        return [one for one in everything(*args, **options) if one.name.startswith(cheap)]

    monkeypatch.setattr(verify, "jobs", few)
    assert cli.main(["verify", "--json", "--cases", "30"]) == 0
    said = capsys.readouterr()
    told = json.loads(said.out)
    assert said.err == ""
    assert told["ok"] is True
    assert {"python", "jax", "jaxlib", "gymnasium", "numpy"} == set(told["versions"])
    for row in told["checks"]:
        assert row["ok"] is True
        assert row["error"] <= row["allowed"]
        assert row["cases"] > 0
    found = {(row["group"], row["name"]): row for row in told["checks"]}
    assert len(found) == len(told["checks"])
    # An error that is always 0 might be one of nothing with itself.
    assert 0 < found["environments", "MountainCar-v0: a step, float32"]["error"] < 3e-7
    assert found["environments", "FrozenLake-v1: outcomes"]["error"] > 0

    monkeypatch.setattr(verify, "jobs", lambda *args, **options: [checks.Job("keys", "k" * 60, "-", lambda: off)])
    off = checks.Found(256_000, 1.2345e-10, 1e-12, decided=41)
    assert cli.main(["verify", "--json"]) == 1
    told = json.loads(capsys.readouterr().out)
    assert (told["ok"], told["checks"][0]["ok"]) == (False, False)
    assert cli.main(["verify"]) == 1
    table, below = capsys.readouterr().out.split("\nOFF: ")
    assert max(map(len, table.splitlines()[1:])) <= 80
    assert below.startswith("keys, " + "k" * 60 + ": 1.23e-10 is above 1e-12")


def test_every_environment_and_rule_has_its_checks():
    found = {(one.group, one.name) for one in verify.jobs()}
    assert {group for group, _ in found} == set(verify.GROUPS)
    for name in envs.names():
        for what in ("episodes", "resets", "limit and threshold"):
            assert ("environments", f"{name}: {what}") in found
    for name in rules.__all__:
        if callable(getattr(rules, name)) and name not in ("TxPair", "random_subset", "quantile_midpoints"):
            assert {("rules", f"{name} float32"), ("rules", f"{name} float64")} <= found


def test_every_number_of_a_world_is_another_one_in_some_check():
    fixed = {"Acrobot-v1": {"gravity", "torque_noise_max"}}
    for name, kind in WORLDS.items():
        plain = kind().flat()
        others = [world.flat() for _, world in environments.VARIANTS if world.id == name]
        same = {field for field in plain if all(other[field] == plain[field] for other in others)}
        same = {field for field in same if not kind().is_structure(field)}
        assert same - fixed.get(name, set()) <= ({"max_episode_steps"} if kind().id in TABLES else set())


TABLES = {"FrozenLake-v1", "FrozenLake8x8-v1", "Taxi-v4"}
#: In which file what is replaced by what, and the check that must see it.
FAULTS = [
    (cartpole, "pole_share * p.length", "pole_share * 0.5", "CartPole-v1 otherwise"),
    (cartpole, "+ p.masscart)", "+ 1.0)", "CartPole-v1 otherwise"),
    (cartpole, "(p.gravity * sin", "(9.8 * sin", "CartPole-v1 otherwise"),
    (cartpole, 'if integrator == "euler":', "if True:", "CartPole-v1 otherwise"),
    (cartpole, "terminated, -1.0, 0.0", "terminated, 1.0, 0.0", "CartPole-v1 otherwise"),
    (acrobot, "still = p.link_mass_1", "still = p.link_mass_2", "Acrobot-v1 otherwise"),
    (acrobot, "p.link_mass_1 * p.link_com_pos_1", "p.link_mass_1 * p.link_com_pos_2", "Acrobot-v1 otherwise"),
    (acrobot, "m2 * (jnp.square(l1)", "m2 * (l1", "Acrobot-v1 otherwise"),
    (acrobot, ".astype(dtype) * p.torque", ".astype(dtype)", "Acrobot-v1 otherwise"),
    (pendulum, "p.mass * jnp.square(p.length)", "p.mass * p.length", "Pendulum-v1 otherwise"),
    (pendulum, "-cost.astype(obs_dtype)", "-cost.astype(obs_dtype) * 1.00001", "Pendulum-v1"),
    (mountain_car, "velocity >= p.goal_velocity", "velocity >= 0", "MountainCar-v0 otherwise"),
    (mountain_car, "p.goal_position)", "p.goal_position * 1.001)", "MountainCar-v0"),
    (mountain_car, "[state.position, state.velocity]", "[state.position, state.velocity * 1.00001]", "MountainCar-v0"),
]


def broken(module, old, new, function):
    """The module's function made of its source with something replaced."""
    text = Path(module.__file__).read_text()
    assert text.count(old) == 1
    names = dict(vars(module))
    exec(compile(text.replace(old, new), module.__file__, "exec"), names)
    factory, numbers = envs._REGISTRY[function]
    return names[factory.__name__], numbers


@pytest.mark.parametrize(("module", "old", "new", "name"), FAULTS, ids=[fault[2] for fault in FAULTS])
def test_a_fault_in_the_physics_is_seen(module, old, new, name, monkeypatch):
    of = name.split()[0]
    monkeypatch.setitem(envs._REGISTRY, of, broken(module, old, new, of))
    assert not job("environments", f"{name}: a step, float64").ok


@pytest.mark.parametrize("wrong", [lambda f, h, g: (h, f, g), lambda f, h, g: (f, g, h)])
def test_rewards_of_a_lake_that_are_swapped_are_seen(wrong, monkeypatch):
    right = toy_text._lake

    def swapped(*args):
        outcomes_of, probability, rewards_of, starts = right(*args)
        return outcomes_of, probability, wrong(*rewards_of), starts

    monkeypatch.setattr(toy_text, "_lake", swapped)
    assert not job("environments", "FrozenLake-v1 otherwise: exact arrays").ok


def test_resets_that_are_off_are_seen(monkeypatch):
    made = resets.made
    assert job("environments", "MountainCar-v0: resets").ok
    monkeypatch.setattr(resets, "made", lambda world: made(world.model_copy(update={"reset_high": -0.41})))
    assert not job("environments", "MountainCar-v0: resets").ok
    monkeypatch.setattr(resets, "made", lambda world: made(FrozenLake()))
    assert not job("environments", "CliffWalking-v1: resets").ok


def test_a_gradient_that_does_not_stop_is_seen(monkeypatch):
    monkeypatch.setattr(rules, "td_error", lambda q_tm1, a_tm1, target_tm1: target_tm1 - q_tm1[a_tm1])
    assert not job("rules", "td_error gradient").ok


def test_one_pass_in_the_place_of_two_is_seen(monkeypatch):
    monkeypatch.setattr(keys, "_twice", keys._pcg4d)
    assert not job("keys", "pcg4d: split 2").ok


def test_a_slot_that_is_never_filled_again_is_reported(monkeypatch):
    monkeypatch.setitem(lanes.LANES, "dqn", 4)
    monkeypatch.setattr(lanes, "ALONE_TOO", (0,))
    assert not job("lanes", "dqn: among others").ok


def test_neighbours_that_begin_anew_when_a_slot_is_filled_are_seen(monkeypatch):
    always = SimpleNamespace(**{**vars(jax.numpy), "where": lambda fresh, a, b: a})
    monkeypatch.setattr(executables, "jnp", always)
    assert not job("lanes", "dqn: among others").ok


def test_a_package_that_is_missing_is_a_line_and_the_other_groups_run(monkeypatch, capsys):
    monkeypatch.setitem(sys.modules, "jaxq.verify.environments", None)
    assert cli.main(["verify", "environments", "--json"]) == 1
    (row,) = json.loads(capsys.readouterr().out)["checks"]
    assert (row["name"], row["ok"]) == ("can be imported", False)


NUMBERS = {
    "CartPole-v1": ("gravity", 9.8),
    "Acrobot-v1": ("link_mass_1", 1.0),
    "MountainCar-v0": ("gravity", 0.0025),
    "Pendulum-v1": ("mass", 1.0),
}


@pytest.mark.parametrize("name", NUMBERS)
def test_physics_that_is_off_by_a_thousandth_is_reported(name, monkeypatch, capsys):
    number, value = NUMBERS[name]
    factory, params = envs.registered(name)

    def wrong(numbers, **options):
        return factory(numbers._replace(**{number: getattr(numbers, number) * 1.001}), **options)

    wrong.__kwdefaults__ = factory.__kwdefaults__  # its options
    monkeypatch.setitem(envs._REGISTRY, name, (wrong, params))
    assert float(getattr(params(), number)) == value
    assert cli.main(["verify", "--against", name, "--cases", "40"]) == 1
    told = capsys.readouterr().out
    assert told.count("OFF: environments") == 2
    assert "state [" in told
    assert "ours [" in told
    assert "2 checks, 2 off" in told


def test_gymnasiums_other_cartpole_is_reported_as_another_one(capsys):
    assert cli.main(["verify", "--against", "CartPole-v1", "--cases", "20"]) == 0
    assert "2 checks, 0 off" in capsys.readouterr().out
    assert cli.main(["verify", "--against", "phys2d/CartPole-v1", "--cases", "20"]) == 1
    told = capsys.readouterr().out
    assert "phys2d/CartPole-v1 of gymnasium" in told
    assert "2 checks, 2 off" in told


def test_a_table_and_chances_that_are_off_are_reported(monkeypatch):
    slip = FrozenLake(success_rate=0.334)
    monkeypatch.setattr(outcomes, "exact", lambda world: envs.exact(slip))
    found = job("environments", "FrozenLake-v1: exact arrays")
    assert not found.ok
    assert 2e-4 < found.error < 1e-3
    made = outcomes.made
    monkeypatch.setattr(outcomes, "made", lambda world: made(FrozenLake(success_rate=0.45)))
    assert not job("environments", "FrozenLake-v1: outcomes", cases=1000).ok
    monkeypatch.setattr(outcomes, "made", lambda world: made(FrozenLake(goal_reward=1.001, is_slippery=False)))
    assert not job("environments", "FrozenLake-v1 dry: outcomes").ok


def test_a_limit_that_is_off_by_a_step_is_reported(monkeypatch):
    assert job("environments", "MountainCar-v0: episodes").ok
    made = episodes.made

    def longer(world):
        return made(world.model_copy(update={"max_episode_steps": world.max_episode_steps + 1}))

    monkeypatch.setattr(episodes, "made", longer)
    found = job("environments", "MountainCar-v0: episodes")
    assert not found.ok
    assert "theirs" in found.detail


@pytest.mark.parametrize("dtype", ["float32", "float64"])
def test_a_rule_that_is_off_by_a_thousandth_is_reported(dtype, monkeypatch):
    one = [case for case in rule_checks.CASES if case[0] == "td_error"]
    monkeypatch.setattr(rule_checks, "CASES", one)  # the others would take as long as all of these tests
    assert job("rules", f"td_error {dtype}").ok
    right = rules.td_error
    monkeypatch.setattr(rules, "td_error", lambda *a, **k: right(*a, **k) * 1.001)
    found = job("rules", f"td_error {dtype}")
    assert not found.ok
    assert found.error > 1e-4
    assert "q_tm1" in found.detail


def test_a_public_rule_that_nobody_looks_at_is_reported(monkeypatch):
    monkeypatch.setattr(rules, "__all__", [*rules.__all__, "new"])
    found = job("rules", "every public name")
    assert (found.ok, found.detail) == (False, "new")


def test_a_key_stream_that_is_another_one_is_reported(monkeypatch):
    assert job("keys", "threefry: split").ok
    assert job("keys", "pcg4d: split").ok
    right = prng.key
    monkeypatch.setattr(prng, "key", lambda seed, impl="threefry": right(seed ^ 1, impl))
    for name in ("threefry: split", "pcg4d: split"):
        found = job("keys", name)
        assert not found.ok
        assert found.error == found.cases
        assert "seed" in found.detail


def test_lanes_that_depend_on_each_other_are_reported(monkeypatch):
    right = lanes.lanes.run

    def wrong(built, queue, *, root_seed, total, **options):
        return right(built, queue, root_seed=root_seed + (total > 1), total=total, **options)

    monkeypatch.setattr(lanes.lanes, "run", wrong)
    found = job("lanes", "dqn: among others")
    assert (found.ok, found.error, found.cases) == (False, 3, 3)
    assert "seed" in found.detail


def test_a_second_compilation_is_reported(monkeypatch):
    right = compiles.sweeps.sweep

    def twice(name, **values):
        right(name, **values)
        return right(name, **values)

    monkeypatch.setattr(compiles.sweeps, "sweep", twice)
    found = job("compiles", "q-learning: settings of one structure")
    assert (found.ok, found.error) == (False, 4)


def test_a_check_that_fails_is_a_line_and_the_others_run(monkeypatch, capsys):
    monkeypatch.setattr(prng, "wrap", None)
    monkeypatch.setattr(prng, "key", lambda *a: 1 // 0)
    assert cli.main(["verify", "keys", "--cases", "5"]) == 1
    told = capsys.readouterr().out
    assert "OFF: keys, threefry: split: ZeroDivisionError" in told
    assert told.splitlines()[-1].split(",")[0] == f"{len(verify.jobs(['keys']))} checks"


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["keyz"], "group: 'keyz' is unknown; did you mean 'keys'?"),
        (["--cases", "0"], "cases: 0 is not allowed: from 1 to 1000000"),
        (["--cases", "x"], "--cases"),
        (["--against", "phys2d/CartPole-v9"], "its last part must be one of CartPole-v1, Acrobot-v1"),
        (["--against", "phys3d/CartPole-v1"], "'phys3d/CartPole-v1' is unknown to Gymnasium"),
        (["rules", "--against", "CartPole-v1"], "not allowed beside rules"),
    ],
)
def test_what_is_wrong_is_said_in_a_line(words, message, capsys):
    assert cli.main(["verify", *words]) == 2
    said = capsys.readouterr()
    assert said.out == ""
    assert message in said.err
    assert len(said.err.splitlines()) == 1
