"""The suite of trainings until they are solved: ours, and the peers' side without their libraries."""

import ast
import json
import random
import sys
import types
from pathlib import Path

import gymnasium
import jax.numpy as jnp
import numpy as np
import pytest

from benchmarks import beside
from jaxq import success, sweeps
from jaxq.bench import solve, worker
from jaxq.presets import preset, settle
from jaxq.rounds import Limits

pytestmark = pytest.mark.usefixtures("programs_are_compiled_once")

PEERS = Path(__file__).parent.parent / "benchmarks" / "peers"


def peer(name):
    return worker.load(str(PEERS / f"{name}.py"))


@pytest.fixture
def small(monkeypatch):
    monkeypatch.setitem(solve.CASES, "article-q", {"max_episodes": 100, "success_steps": 30, "success_streak": 2})
    for how in solve.SEEDS:
        monkeypatch.setitem(solve.SEEDS[how], "article-q", 6)


def test_ours_trains_the_same_seeds_together_and_alone(small):
    rows = sweeps.run(solve.planned("article-q")).lanes.to_pylist()
    told = {}
    for how, together in (("together", 6), ("alone", 1)):
        assert solve.prepare("article-q", how)() == 6
        told[how] = solve.notes("article-q")["trainings"]
        assert told[how]["together"] == together
        assert len(told[how]["seconds"]) == 6 / together
        assert told[how]["env_steps"][0] == rows[0]["env_steps"]
        assert told[how]["solved"][0] == (rows[0]["status"] == "solved")
    assert told["together"]["env_steps"] == told["alone"]["env_steps"]
    assert set(told["alone"]["solved"]) == {True, False}  # an unsolved seed is kept, at its limit


def first_solved(rule, lengths, limits):
    state = rule.init()
    for i, length in enumerate(lengths):
        state, met = rule.update(state, jnp.bool_(True), jnp.int32(length), jnp.float32(0), limits)
        if met:
            return i
    return None


def test_gymnasiums_threshold_is_met_when_the_mean_is_equal():
    numbers = solve.planned("dqn").settings[0]
    rule = success.window_mean(numbers.success_window)
    limits = Limits(0, 0, np.float32(numbers.success_steps), 0)
    exact = [475] * numbers.success_window
    short = exact[:-1] + [474]
    assert first_solved(rule, exact, limits) == numbers.success_window - 1
    assert first_solved(rule, short, limits) is None
    assert peer("solve").is_solved(numbers.flat(), exact)
    assert not peer("solve").is_solved(numbers.flat(), short)


def test_the_peers_window_is_our_window():
    rng, is_solved = np.random.default_rng(0), peer("solve").is_solved
    found = []
    for _ in range(30):
        lengths = np.minimum(20, rng.integers(8, 30, 40)).tolist()  # about 17, so that a mean of 18 is met now and then
        numbers = {"success_window": 5, "success_steps": solve.at_least(18, 5)}
        theirs = next((i for i in range(40) if is_solved(numbers, lengths[: i + 1])), None)
        limits = Limits(0, 0, np.float32(numbers["success_steps"]), 0)
        assert first_solved(success.window_mean(5), lengths, limits) == theirs
        found.append(theirs)
    assert len(set(found)) > 5


class Scripted:
    """An environment whose episodes have given lengths."""

    def __init__(self, lengths):
        self.lengths = iter(lengths)
        self.observation_space = gymnasium.spaces.Box(np.float32([-4.8, -9, -0.4, -9]), np.float32([4.8, 9, 0.4, 9]))
        self.action_space = gymnasium.spaces.Discrete(2)

    def reset(self, seed=None):
        self.left = next(self.lengths)
        return np.zeros(4, np.float32), {}

    def step(self, action):
        self.left -= 1
        return np.zeros(4, np.float32), 1.0, self.left == 0, False, {}


def test_the_numpy_loop_ends_by_our_streak(monkeypatch):
    rng = random.Random(0)
    numbers = {"max_episodes": 40, "success_steps": 5, "success_streak": 2, "gamma": 0.9}
    found = set()
    for seed in range(20):
        lengths = [rng.choice([4, 5, 6, 7, 8]) for _ in range(40)]
        monkeypatch.setattr(gymnasium, "make", lambda name, lengths=lengths: Scripted(lengths))
        ((won, steps),) = peer("numpy_table").solver(numbers, None)(seed)
        ours = first_solved(success.streak(), lengths, Limits(0, 0, 5, 2))
        assert won == (ours is not None)
        assert steps == sum(lengths if ours is None else lengths[: ours + 1])
        found.add(ours)
    assert len(found) > 5


def test_the_pytorch_loop_has_our_rule_and_limits():
    source = ast.parse(peer("torch_dqn").LOOP.read_text())
    constants = {}
    for node in source.body:
        if isinstance(node, ast.Assign) and isinstance(node.targets[0], ast.Tuple):
            constants |= zip((t.id for t in node.targets[0].elts), ast.literal_eval(node.value), strict=True)
    ours = solve.planned("article-dqn").settings[0]
    assert constants["WINDOW"] == ours.success_window
    assert constants["SUCCESS_STEPS"] == ours.success_steps
    assert constants["MAX_EPISODES"] == ours.max_episodes
    assert ours.max_env_steps >= ours.max_episodes * 500  # which the loop has no limit for


class Model:
    """A stand-in for a library's DQN: episodes of given lengths, each step told to the callback."""

    made: dict
    lengths = (10, 50, 60, 70, 80)

    def __init__(self, *names, seed, **given):
        Model.made, self.seed = given, seed

    def learn(self, limit, callback, log_interval):
        flags = [step == length - 1 for length in self.lengths for step in range(length)]
        callback._on_training_start()
        for self.num_timesteps, over in enumerate(flags[:limit], 1):
            callback.locals = {"dones": [over]}
            if not callback._on_step():
                return


def test_the_callback_stops_stable_baselines_where_it_is_solved(monkeypatch):
    torch = types.SimpleNamespace(set_num_threads=lambda count: None, optim=types.SimpleNamespace(AdamW="AdamW"))
    callbacks = types.SimpleNamespace(BaseCallback=object)
    library = types.SimpleNamespace(DQN=Model)
    for name, module in (
        ("torch", torch),
        ("stable_baselines3", library),
        ("stable_baselines3.common", types.SimpleNamespace()),
        ("stable_baselines3.common.callbacks", callbacks),
    ):
        monkeypatch.setitem(sys.modules, name, module)
    numbers = {**solve.planned("dqn").settings[0].flat(), "success_window": 2, "success_steps": 60}
    sb3, rule = peer("sb3_dqn"), peer("solve").is_solved
    # means 5, 30, 55, 65: above 60 with the fourth
    assert sb3.solver(numbers, lambda lengths: rule(numbers, lengths))(0) == [(True, 190)]
    assert sb3.solver(numbers | {"success_steps": 99}, lambda lengths: False)(0) == [(False, 270)]
    assert Model.made["target_update_interval"] == numbers["target_period"] * numbers["steps_per_update"]
    assert Model.made["exploration_fraction"] * numbers["max_env_steps"] == numbers["epsilon_decay"]
    ends = [Model.made["learning_rate"](left) for left in (1.0, 0.0)]
    assert ends == [numbers["learning_rate"], numbers["learning_rate_end"]]
    optimiser = {"amsgrad": True, "weight_decay": numbers["weight_decay"]}
    assert Model.made["policy_kwargs"] == {
        "net_arch": numbers["hidden"],
        "optimizer_class": "AdamW",
        "optimizer_kwargs": optimiser,
    }
    assert sb3.step_sizes(numbers | {"learning_rate_end": None}) == (numbers["learning_rate"],) * 2
    zoo = peer("sb3_zoo_dqn")
    assert zoo.solver(numbers, lambda lengths: False)(0) == [(False, 270)]
    # epsilon falls over 16 % of 50,000 env steps, as published
    assert Model.made["exploration_fraction"] * numbers["max_env_steps"] == pytest.approx(8000)
    assert Model.made["learning_rate"] == 2.3e-3


def test_rejaxs_judge_follows_each_environment_across_looks():
    rejax, seen = peer("rejax_dqn"), []

    def is_solved(lengths):
        seen[:] = lengths
        return len(lengths) == 4

    judge = rejax.Judge(is_solved, num_envs=2)
    over = np.zeros(24, bool)
    over[[4, 7, 10, 20, 22]] = True  # environment 0 at its steps 2, 5, 10, 11, environment 1 at its step 3
    judge.look(over[:6])
    judge.look(over[6:])
    assert seen == [3, 4, 3, 5]
    assert judge.solved
    assert judge.env_steps == 21  # where it was solved, not where the look ended


def test_a_peer_is_trained_seed_after_seed_and_all_are_told(tmp_path, monkeypatch):
    (tmp_path / "agent.py").write_text(
        "DIFFERS = 'a smaller network'\n"
        "def solver(numbers, is_solved, together='1'):\n"
        "    def train(first):\n"
        "        seeds = range(first, first + int(together))\n"
        "        return [(is_solved([seed]), 100 + seed) for seed in seeds]\n"
        "    return train\n"
    )
    module = peer("solve")
    monkeypatch.setattr(module, "__file__", str(tmp_path / "solve.py"))
    settings = json.dumps({"success_window": 1, "success_steps": 2})
    for together in (1, 3):
        more = () if together == 1 else ("3",)
        answer = worker.measure(module, {}, "dqn", 0.01, ("agent", settings, *more))
        told = answer["notes"]["trainings"]
        count = answer["bouts"] * together
        assert told["together"] == together
        assert len(told["seconds"]) == answer["bouts"]  # the first one too
        assert told["env_steps"] == list(range(100, 100 + count))
        assert told["solved"] == [seed > 2 for seed in range(count)]
        assert answer["notes"]["differs"] == "a smaller network"
        json.dumps(answer)


def test_every_peer_stands_beside_a_case_with_our_numbers():
    for contender in beside.PEERS_OF["solve"]:
        (case,) = contender.cases
        agent, numbers, *_ = contender.arguments
        assert (PEERS / f"{agent}.py").exists()
        ours = solve.planned(case).settings[0]
        assert settle(preset(case), **json.loads(numbers)) == ours
