"""Our learners in Gymnasium's environments: the engine's bits where both can run, and true transitions anywhere."""

import contextlib
import pickle
import signal

import gymnasium
import numpy as np
import pytest
from gymnasium import spaces
from gymnasium.vector import AutoresetMode, SyncVectorEnv
from gymnasium.wrappers import TimeLimit
from gymnasium.wrappers.vector import RecordEpisodeStatistics

import jaxq
from jaxq.interop.gymnasium import PureVectorEnv, load, train
from jaxq.interop.gymnasium.foreign import foreign
from jaxq.interop.gymnasium.learner import Learner
from jaxq.interop.gymnasium.transitions import Row, Transitions
from jaxq.presets import preset, settle

pytestmark = pytest.mark.usefixtures("programs_are_compiled_once")

MODES = pytest.mark.parametrize("mode", list(AutoresetMode))
QUIET = {"progress": False}


class Counting(gymnasium.Env):
    """Shows its number, its episode and its step; the end, its kind and the reward are known beforehand."""

    observation_space = spaces.Box(-1, 1e6, (3,), np.float32)
    action_space = spaces.Discrete(3, start=4)

    def __init__(self, number):
        self.number, self.episode, self.t = number, -1, 0

    def shown(self):
        return np.array([self.number, self.episode, self.t], np.float32)

    def reset(self, *, seed=None, options=None):
        super().reset(seed=seed)
        self.episode, self.t = self.episode + 1, 0
        return self.shown(), {}

    def step(self, action):
        assert self.action_space.contains(action)
        self.t += 1
        last = self.t == 2 + (self.number + self.episode) % 3
        terminated = last and self.episode % 2 == 0
        truncated = last and self.episode % 4 != 2  # both at once in every fourth episode
        return self.shown(), float(self.t + action), terminated, truncated, {}


def vector(mode, *envs):
    """Of environments that are there already; it writes its next observations into the array it has handed out."""
    return SyncVectorEnv([lambda env=env: env for env in envs], copy=False, autoreset_mode=mode)


def known(number, steps):
    """The transitions of a Counting environment under actions 0, 1, 2, 0 ...: obs, action, reward, continues, next obs,
    cut, length and return."""
    rows, episode, t, total = [], 0, 0, 0.0
    for k in range(steps):
        over = t + 1 == 2 + (number + episode) % 3
        reward = t + 1 + k % 3 + 4
        total += reward
        ends = over and episode % 2 == 0
        rows.append(([number, episode, t], k % 3, reward, 1.0 - ends, [number, episode, t + 1], over, t + 1, total))
        episode, t, total = (episode + 1, 0, 0.0) if over else (episode, t + 1, total)
    return rows


@MODES
@pytest.mark.parametrize("count", [1, 3])
def test_every_transition_is_there_once_with_its_true_successor(mode, count):
    world = Transitions(foreign(vector(mode, *map(Counting, range(count))), count))
    world.begin(0)
    found = [[] for _ in range(count)]
    acts = np.zeros(count, int)  # actions that are not lost in a reset
    resets = np.zeros(count, bool)
    for _ in range(60):
        row = world.take(acts % 3)
        acts += ~resets
        resets[:] = False
        if mode is AutoresetMode.NEXT_STEP:
            resets[[i for i, _, _ in world.finished]] = True
        for one in () if row is None else zip(*row, strict=True):
            found[int(one[0][0])].append(one)
    for number, rows in enumerate(found):
        assert len(rows) >= 30
        for one, wanted in zip(rows, known(number, len(rows)), strict=True):
            for name, leaf, truth in zip(Row._fields, one, wanted, strict=True):
                np.testing.assert_array_equal(leaf, truth, err_msg=name)


@pytest.mark.parametrize(
    ("name", "mode"), [("q-learning", "SameStep"), ("sarsa", "NextStep"), ("n-step-q-learning", "Disabled")]
)
def test_a_table_is_the_engines_bit_for_bit(name, mode):
    values = {"max_env_steps": 1500, "eval_episodes": 2, "initial_value": 0.5}
    lake = vector(mode, gymnasium.make("FrozenLake-v1", is_slippery=False))
    ours = train(name, lake, seed=3, **QUIET, **values)
    engines = jaxq.train(name, env=jaxq.worlds.FrozenLake(is_slippery=False), seed=3, **values)
    assert len(engines.episodes.length) > 50
    np.testing.assert_array_equal(ours.policy.weights["table"], engines.policy)
    np.testing.assert_array_equal(ours.max_q, engines.max_q)
    for mine, theirs in zip(ours.episodes, engines.episodes, strict=True):
        np.testing.assert_array_equal(mine, theirs)
    assert (ours.status, ours.env_steps, ours.updates) == (engines.status, engines.env_steps, engines.updates)
    np.testing.assert_array_equal(ours.eval_returns, engines.eval_returns)


NETWORK = {"max_env_steps": 900, "epsilon_decay": 500.0, "eval_episodes": 2, "hidden": (16,), "batch_size": 32}
NETWORK |= {"learning_starts": 100, "buffer_size": 500}


@pytest.fixture(scope="module")
def engines():
    """The lake has one start and, dry, no chance. Warm-up, replay, several steps and environments per update."""
    made = {}

    def run(many):
        if many not in made:
            made[many] = jaxq.train("dqn", env=jaxq.worlds.FrozenLake(is_slippery=False), num_envs=many, **NETWORK)
        return made[many]

    return run


@MODES
def test_a_network_is_the_engines_too_in_each_mode(engines, mode):
    many = 1 if mode is AutoresetMode.NEXT_STEP else 3  # there several environments reach a round in another order
    envs = SyncVectorEnv([lambda: gymnasium.make("FrozenLake-v1", is_slippery=False)] * many, autoreset_mode=mode)
    ours, theirs = train("dqn", envs, **QUIET, **NETWORK), engines(many)
    for name, array in jaxq.saved_policy.flatten(theirs.policy).items():
        np.testing.assert_allclose(ours.policy.weights[name], array, atol=1e-6)
    assert len(ours.episodes.length) == len(theirs.episodes.length) > 50
    for mine, other in zip(ours.episodes[:3], theirs.episodes[:3], strict=True):
        np.testing.assert_array_equal(mine, other)
    assert not envs.closed
    envs.reset()  # and of use still


def test_a_step_that_was_nobodys_has_keys_of_its_own():
    world = foreign("CartPole-v1", 1).world
    settings = settle(preset("dqn"), env=world, num_envs=64, hidden=(4,), buffer_size=2000)
    obs = np.zeros((64, 4), np.float32)
    learner = Learner(settings, obs, 0, "pcg4d")
    first, again = learner.act(obs), learner.act(obs)
    learner.skip()
    third = learner.act(obs)
    np.testing.assert_array_equal(first, again)
    assert 10 < (first != third).sum() < 54


class Long(gymnasium.Env):
    """As many steps as its seed says, each pays 1; without a seed 50. It remembers its seeds and its end."""

    action_space, observation_space = spaces.Discrete(2), spaces.Discrete(1)

    def __init__(self, made):
        self.seeds, self.closed = [], False
        made.append(self)

    def reset(self, *, seed=None, options=None):
        super().reset(seed=seed)
        self.t, self.steps = 0, 50 if seed is None else 2 + seed % 7
        self.seeds += [] if seed is None else [seed]
        return 0, {}

    def step(self, action):
        self.t += 1
        return 0, 1.0, self.t == self.steps, False, {}

    def close(self):
        self.closed = True


def test_greedy_episodes_are_whole_each_from_its_own_start_and_environments_are_closed():
    values = {"hidden": (4,), "num_envs": 3, "max_env_steps": 300, "learning_starts": 30, "batch_size": 8}
    values |= {"buffer_size": 100, "eval_episodes": 7, "stop": "none"}
    runs = []
    for seed in (0, 1):
        made = []
        trained = train("dqn", lambda made=made: Long(made), seed=seed, **QUIET, **values)
        ours, judges = made[:3], made[3:]
        assert len(judges) == 3
        assert all(env.closed for env in made)
        starts = [env.seeds[wave] for wave in range(3) for env in judges]
        assert len({*starts, *(one for env in ours for one in env.seeds)}) == 12
        assert trained.eval_returns.tolist() == [2 + one % 7 for one in starts][:7]
        runs.append({one for env in made for one in env.seeds})
    assert not runs[0] & runs[1]
    cut = train("dqn", lambda: Long([]), **QUIET, **values, eval_steps=3)
    assert set(cut.eval_returns.tolist()) <= {2.0, 3.0}
    assert 3.0 in cut.eval_returns


def test_a_known_time_limit_is_the_end_of_a_greedy_episode():
    """Of an environment nobody registered; where no limit is known an evaluation ends by itself."""

    def endless(limit):
        return TimeLimit(Room(False, period=10**6), limit)

    values = {"max_env_steps": 20, "eval_episodes": 1, "stop": "none"}
    assert train("q-learning", lambda: endless(1200), **QUIET, **values).eval_returns.tolist() == [1200]
    assert train("q-learning", lambda: Room(False, period=10**6), **QUIET, **values).eval_returns.tolist() == [1000]


def test_a_wrapped_vector_is_known_for_what_it_is():
    bare = SyncVectorEnv([lambda: gymnasium.make("CartPole-v1")] * 2)
    for envs in (bare, RecordEpisodeStatistics(bare)):
        about = foreign(envs, 2).world
        assert (about.id, about.reward_threshold) == ("CartPole-v1", 475)
        assert about.eval_steps > 500
    ours = PureVectorEnv(2, "CliffWalking-v1", max_episode_steps=3000)
    assert foreign(ours, 2).world.eval_steps > 3000


class Bandit(gymnasium.Env):
    """Two states and two actions whose numbers begin elsewhere; the action that pays is the state's."""

    action_space, observation_space = spaces.Discrete(2, start=4), spaces.Discrete(2, start=7)

    def reset(self, *, seed=None, options=None):
        super().reset(seed=seed)
        self.state = int(self.np_random.integers(2))
        return 7 + self.state, {}

    def step(self, action):
        return 7 + self.state, float(action - 4 != self.state), True, False, {}


@pytest.mark.parametrize("name", ["q-learning", "dqn"])
def test_a_policy_speaks_the_environments_language(name, tmp_path):
    values = (
        {} if name == "q-learning" else {"hidden": (), "learning_rate": 0.05, "learning_starts": 32, "batch_size": 32}
    )
    made = train(name, Bandit, **QUIET, max_env_steps=600, eval_episodes=8, **values)
    made.save(tmp_path / "policy")
    for policy in (made.policy, load(tmp_path / "policy"), pickle.loads(pickle.dumps(made)).policy):
        assert policy.act(np.array([7, 8])).tolist() == [5, 4]
    assert made.eval_returns.tolist() == [1.0] * 8


def test_a_policy_takes_observations_of_any_shape():
    grid = spaces.Box(0, 1, (2, 2), np.float32)
    made = train(
        "q-learning",
        lambda: Odd(observation_space=grid, shown=np.full((2, 2), 0.5, np.float32)),
        **QUIET,
        num_buckets=(2,) * 4,
        max_env_steps=30,
        eval_episodes=1,
    )
    assert made.policy.q_values(np.zeros((5, 2, 2))).shape == (5, 2)


class Room(gymnasium.Env):
    """One state; each step pays 1, and each third ends the episode, as it is told."""

    action_space, observation_space = spaces.Discrete(2), spaces.Discrete(1, start=7)
    shown = 7

    def __init__(self, terminates, reward=1.0, period=3):
        self.terminates, self.reward, self.period, self.t = terminates, reward, period, 0

    def reset(self, *, seed=None, options=None):
        super().reset(seed=seed)
        self.t = 0
        return self.shown, {}

    def step(self, action):
        self.t += 1
        last = self.t % self.period == 0
        return self.shown, self.reward, last and self.terminates, last and not self.terminates, {}


@pytest.mark.parametrize(("mode", "terminates"), [("SameStep", True), ("NextStep", False)])
def test_a_truncation_bootstraps_and_a_termination_does_not(mode, terminates):
    """v = 1 + gamma (1 - p) v, where a step terminates with frequency p: 1/3 or 0. The mean of the last updates of a
    table with steps of 0.02 is within a tenth of it."""
    gamma = 0.8
    envs = vector(mode, Room(terminates))
    values = {"gamma": gamma, "alpha_min": 0.02, "alpha_max": 0.02, "max_env_steps": 3000, "stop": "none"}
    table = train("q-learning", envs, **QUIET, **values, eval_episodes=2, epsilon_min=1.0).policy.weights["table"]
    truth = 1 / (1 - gamma * (2 / 3 if terminates else 1))
    np.testing.assert_allclose(table, truth, rtol=0.1)


def test_several_environments_teach_one_network():
    envs = vector("NextStep", Room(True), Room(True), Room(True))
    values = {"hidden": (), "gamma": 0.8, "learning_rate": 0.02, "tau": 1.0, "target_period": 10, "max_env_steps": 4000}
    values |= {"batch_size": 32, "learning_starts": 32, "buffer_size": 1000, "epsilon_decay": 1e6, "eval_episodes": 3}
    made = train("dqn", envs, **QUIET, **values)
    q = made.policy.q_values(np.array([7]))
    np.testing.assert_allclose(q, 1 / (1 - 0.8 * 2 / 3), rtol=0.1)
    np.testing.assert_array_equal(made.eval_returns, [3, 3, 3])
    assert set(made.episodes.length.tolist()) == {3}
    assert np.isnan(made.episodes.max_q[0])
    assert made.episodes.max_q[-1] in made.max_q


def test_dqn_learns_gymnasiums_cartpole():
    values = {"num_envs": 4, "steps_per_update": 1, "max_env_steps": 10_000, "epsilon_decay": 5000.0}
    made = train("dqn", "CartPole-v1", **QUIET, **values, eval_episodes=10, eval_every=5000)
    assert made.settings.stop == "gymnasium"
    assert made.eval_returns.mean() > 100  # random play has about 22
    assert made.curve.shape == (2, 2)
    assert made.curve[0].tolist() == [5000, 10_000]
    assert made.curve[1, 1] == made.eval_returns.mean()  # from the same starts
    values |= {"max_env_steps": 1500, "eval_episodes": 1}
    plain, again = (train("dqn", "CartPole-v1", eval_every=every, **QUIET, **values) for every in (0, 500))
    np.testing.assert_array_equal(plain.max_q, again.max_q)  # who is looked at learns the same
    other = train("dqn", "CartPole-v1", seed=1, **QUIET, **values)
    assert plain.episodes.length.tolist()[:10] != other.episodes.length.tolist()[:10]


def test_ctrl_c_keeps_what_was_learnt(tmp_path):
    before, ended = signal.getsignal(signal.SIGINT), []

    def told(env_steps, length, total):
        ended.append((env_steps, length, total))
        if len(ended) == 5:
            signal.raise_signal(signal.SIGINT)

    made = train("q-learning", lambda: Room(True), on_episode=told, **QUIET)
    assert made.status == "interrupted"
    assert made.eval_returns is None
    assert ended == list(zip(*(column.tolist() for column in made.episodes[:3]), strict=True))
    assert np.any(made.policy.weights["table"])
    assert signal.getsignal(signal.SIGINT) is before
    made.save(tmp_path / "policy")
    seen = np.full(3, 7)
    np.testing.assert_array_equal(load(tmp_path / "policy").act(seen), made.policy.act(seen))


def test_ctrl_c_ends_an_evaluation_too():
    class Slow(Room):
        def step(self, action):
            if self.t == 20:
                signal.raise_signal(signal.SIGINT)
            return super().step(action)

    made = train("q-learning", lambda: Slow(False, period=10**6), **QUIET, max_env_steps=15, eval_episodes=3)
    assert made.status == "finished"
    assert made.eval_returns is None
    assert np.any(made.policy.weights["table"])


def test_a_training_that_would_not_fit_is_refused():
    with pytest.raises(MemoryError, match=r"the training needs about .* of memory, and"):
        train("dqn", lambda: Odd(observation_space=spaces.Discrete(10**9)), **QUIET)


def test_what_is_no_policy_is_not_loaded(tmp_path):
    (tmp_path / "file").write_bytes(b"nothing of the kind")
    for name in ("file", ""):
        with pytest.raises(ValueError, match="holds no policy"):
            load(tmp_path / name)
    with pytest.raises(FileNotFoundError):
        load(tmp_path / "none")


def test_a_reward_that_is_no_number_diverges():
    made = train("q-learning", lambda: Room(True, reward=np.nan), **QUIET, max_env_steps=50, eval_episodes=1)
    assert made.status == "diverged"
    assert made.env_steps < 5
    assert made.eval_returns is None


def test_progress_is_talk(capsys):
    train("q-learning", "CliffWalking-v1", max_env_steps=50, eval_episodes=1)
    said = capsys.readouterr()
    assert said.out == ""
    assert "50 env steps" in said.err


class Odd(Room):
    """A room with spaces of one's own."""

    def __init__(self, **spaces_of):
        super().__init__(True)
        vars(self).update(spaces_of)


SHARED = Room(True)
UNBOUNDED = spaces.Box(-np.inf, np.inf, (2,), np.float32)
NESTED = spaces.Dict({"a": spaces.Discrete(2)})


@pytest.mark.parametrize(
    ("name", "env", "values", "message"),
    [
        ("dqn", "CartPoal-v1", {}, "env: Environment `CartPoal` doesn't exist"),
        ("dqn", "Pendulum-v1", {}, r"env: the actions of Pendulum-v1 are Box\(.*DiscretizeAction"),
        ("dqn", lambda: Odd(observation_space=NESTED), {}, r"env: the observations of .* Dict\(.*FlattenObservation"),
        ("dqn", Room(True), {}, "env: a single environment is not allowed: an id, a function"),
        ("dqn", 3, {}, "env: 3 is not allowed: an id, a function"),
        ("dqm", "CartPole-v1", {}, "preset: 'dqm' is unknown; did you mean 'dqn'\\?"),
        ("dqn", "CartPole-v1", {"gama": 0.9}, "gama: dqn has no such setting; did you mean 'gamma'\\?"),
        ("dqn", "CartPole-v1", {"gamma": 1.5}, "gamma: 1.5"),
        ("dqn", "CartPole-v1", {"num_envs": 0}, "num_envs: 0 is not allowed"),
        ("dqn", "CartPole-v1", {"seed": -1}, "seed: -1 is not allowed"),
        ("q-learning", "CartPole-v1", {"num_envs": 2}, "num_envs: q-learning has no such setting"),
        ("q-learning", lambda: Odd(observation_space=UNBOUNDED), {}, "bounds: .* pass the low and high"),
        ("q-learning", "MountainCar-v0", {"bounds": [(0, 1)]}, "bounds: 1 pairs are not allowed.* 2 coordinates"),
        ("q-learning", "MountainCar-v0", {"bounds": [(0, 1), (1, 1)]}, r"bounds: \(1, 1\) is not allowed"),
        ("q-learning", "CliffWalking-v1", {"bounds": [(0, 1)]}, "bounds: not allowed"),
        ("q-learning", "MountainCar-v0", {"bounds": 3}, "bounds: 3 is not allowed: a pair, low and high"),
        ("q-learning", "CliffWalking-v1", {"eval_steps": 0}, "eval_steps: 0 is not allowed"),
        ("dqn", "CartPole-v1", {"prng": "pgc4d"}, "prng: 'pgc4d' is unknown; did you mean 'pcg4d'\\?"),
        ("dqn", lambda: SHARED, {}, "env: a function that gives the same environment twice is not allowed"),
        ("q-learning", vector("SameStep", Room(True), Room(True)), {}, "env: 2 environments are not allowed"),
        ("dqn", vector("SameStep", Room(True)), {"num_envs": 2}, "num_envs: 2 is not allowed: the VectorEnv has 1"),
        ("dqn", vector("SameStep", Room(True)), {"eval_every": 9}, "eval_every: is not allowed with a VectorEnv"),
    ],
)
def test_what_is_wrong_is_said_in_a_line(name, env, values, message):
    with pytest.raises(ValueError, match=message) as caught:
        train(name, env, **QUIET, **values)
    assert "\n" not in str(caught.value)


def test_a_table_divides_the_space_of_an_environment():
    made = train("q-learning", "MountainCar-v0", **QUIET, max_env_steps=400, eval_episodes=1)
    assert made.policy.weights["table"].shape == (100, 3)
    np.testing.assert_allclose(made.settings.env.bounds, [(-1.2, 0.6), (-0.07, 0.07)], rtol=1e-6)
    assert made.settings.stop == "gymnasium"
    with contextlib.closing(gymnasium.make("MountainCar-v0")) as env:
        obs, _ = env.reset(seed=0)
        assert made.policy.act(obs[None])[0] in range(3)
