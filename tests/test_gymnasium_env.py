"""Our worlds as Gymnasium environments: alone, many at once, and Gymnasium's own in the same states."""

import copy
import pickle
import subprocess
import sys
import warnings
from collections import Counter

import gymnasium
import numpy as np
import pytest
from gymnasium.error import InvalidAction, ResetNeeded
from gymnasium.utils.env_checker import check_env
from gymnasium.vector import AutoresetMode, SyncVectorEnv
from gymnasium.wrappers.vector import RecordEpisodeStatistics

import jaxq.interop.gymnasium as interop
from jaxq import envs, frames
from jaxq.envs import CartPoleState
from jaxq.interop.gymnasium import compiled
from jaxq.interop.gymnasium.env import PureEnv
from jaxq.interop.gymnasium.vector import PureVectorEnv
from jaxq.worlds import WORLDS, Acrobot, CartPole, FrozenLake, MountainCar, Pendulum, Taxi, world

NAMES = pytest.mark.parametrize("name", WORLDS)
MODES = pytest.mark.parametrize("mode", list(AutoresetMode))


def warned(env, *, draws):
    """What the checker warns of, without the environment's name; Gymnasium's own need pygame to draw."""
    with warnings.catch_warnings(record=True) as found:
        warnings.simplefilter("always")
        check_env(env.unwrapped, skip_render_check=not draws)
    return {str(one.message) for one in found}


@NAMES
def test_gymnasiums_checker_has_nothing_to_say_that_it_does_not_say_of_its_own(name):
    ours, theirs = gymnasium.make(f"jaxq/{name}"), gymnasium.make(name)
    assert warned(ours, draws=True) <= warned(theirs, draws=False)
    assert ours.spec.max_episode_steps == theirs.spec.max_episode_steps
    assert ours.spec.reward_threshold == theirs.spec.reward_threshold
    assert ours.observation_space == theirs.observation_space
    if name == "Pendulum-v1":
        assert ours.action_space == gymnasium.spaces.Discrete(5)
    else:
        assert ours.action_space == theirs.action_space
    assert ours.metadata["render_fps"] == theirs.metadata["render_fps"]


def test_pictures_are_among_the_modes_that_gymnasium_knows():
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        env = gymnasium.make("jaxq/FrozenLake-v1", render_mode="rgb_array_list")
        vector = gymnasium.make_vec("jaxq/FrozenLake-v1", num_envs=2, render_mode="rgb_array")
    env.reset(seed=0)
    env.step(0)
    first, second = env.render()
    assert first.shape == second.shape
    assert first.dtype == np.uint8
    vector.reset(seed=0)
    np.testing.assert_array_equal(vector.render()[0], first)


@NAMES
def test_a_seed_fixes_the_episodes_and_the_time_limit_is_gymnasiums(name):
    runs = []
    for _ in range(2):
        env = gymnasium.make(f"jaxq/{name}", max_episode_steps=15)
        obs, info = env.reset(seed=5)
        rows, t = [obs], 0
        assert info == {}
        for k in range(40):
            obs, reward, terminated, truncated, _ = env.step(k % env.action_space.n)
            assert obs in env.observation_space
            assert type(reward) is float
            assert type(terminated) is type(truncated) is bool
            t += 1
            assert truncated == (t == 15)
            rows.append((obs, reward, terminated))
            if terminated or truncated:
                rows.append(env.reset()[0])
                t = 0
        runs.append(rows)
    assert str(runs[0]) == str(runs[1])
    other = gymnasium.make(f"jaxq/{name}")
    starts = {str(other.reset(seed=seed)[0]) for seed in range(20)}
    assert len(starts) == 1 if "Frozen" in name or "Cliff" in name else len(starts) > 5


@NAMES
def test_physics_is_gymnasiums_from_any_state_that_an_episode_reaches(name):
    ours = gymnasium.make(f"jaxq/{name}")
    one = world(name)
    theirs = interop.make(one)
    obs, _ = ours.reset(seed=1)
    theirs.reset(seed=1)
    for k in range(60):
        interop.place(theirs, one, ours.unwrapped.state)
        action = k * 7 % int(ours.action_space.n)
        obs, reward, terminated, truncated, _ = ours.step(action)
        expected, theirs_reward, theirs_ends, theirs_cut, _ = theirs.step(interop.action(one, action))
        if name not in ("FrozenLake-v1", "FrozenLake8x8-v1"):  # chance goes its own way there
            np.testing.assert_allclose(obs, expected, rtol=2e-5, atol=2e-5)
            assert reward == pytest.approx(float(theirs_reward), rel=1e-4, abs=1e-6)
            assert (terminated, truncated) == (theirs_ends, theirs_cut)
        if terminated or truncated:
            ours.reset()


def test_numbers_and_options_are_keywords():
    short = gymnasium.make("jaxq.interop.gymnasium:jaxq/CartPole-v1", length=0.1, integrator="semi-implicit")
    assert short.unwrapped.world == CartPole(length=0.1, integrator="semi-implicit", max_episode_steps=2_000_000_000)
    assert gymnasium.make("jaxq/Pendulum-v1", num_torques=9).action_space.n == 9
    assert gymnasium.make("jaxq/CartPole-v1", x_threshold=1.0).observation_space.high[0] == 2.0
    with pytest.raises(ValueError, match="lenght: CartPole-v1 has no such setting; did you mean 'length'"):
        gymnasium.make("jaxq/CartPole-v1", lenght=0.1)
    with pytest.raises(ValueError, match=r"length: -1\.0 is not allowed"):
        gymnasium.make("jaxq/CartPole-v1", length=-1.0)
    with pytest.raises(ValueError, match="render_mode: 'human' is not allowed"):
        PureEnv("CartPole-v1", render_mode="human")


def test_options_of_a_reset_are_gymnasiums():
    for name, options, low, high in (
        ("CartPole-v1", {"low": 0.1, "high": 0.2}, 0.1, 0.2),
        ("MountainCar-v0", {"low": -0.9, "high": -0.8}, -0.9, -0.8),
    ):
        env = gymnasium.make(f"jaxq/{name}")
        starts = np.array([env.reset(seed=seed, options=options)[0][0] for seed in range(50)])
        assert low <= starts.min() < low + 0.02
        assert high - 0.02 < starts.max() <= high
    env = gymnasium.make("jaxq/Pendulum-v1")
    starts = np.array([env.reset(seed=s, options={"x_init": 0.0, "y_init": 0.5})[0] for s in range(50)])
    np.testing.assert_array_equal(starts[:, :2], np.tile([1.0, 0.0], (50, 1)))
    assert 0.45 < np.abs(starts[:, 2]).max() <= 0.5
    with pytest.raises(ValueError, match="options: 'lo' is unknown to CartPole-v1; did you mean 'low'"):
        gymnasium.make("jaxq/CartPole-v1").reset(options={"lo": 0.1})


def test_what_cannot_be_done_is_said():
    env = PureEnv("CartPole-v1")
    with pytest.raises(ResetNeeded):
        env.step(0)
    env.reset(seed=0)
    for action in (2, -1, 0.5, "left", None):
        with pytest.raises(InvalidAction, match="action: "):
            env.step(action)
    with pytest.raises(ValueError, match="env: 'CartPole-v7' is unknown"):
        PureEnv("CartPole-v7")
    with pytest.raises(ValueError, match=r"options: low 'a' is not allowed: a number"):
        env.reset(options={"low": "a"})
    with pytest.raises(ValueError, match="autoreset_mode: 'bogus' is not allowed: one of NextStep, SameStep, Disabled"):
        PureVectorEnv(2, autoreset_mode="bogus")
    with pytest.raises(ValueError, match="num_envs: 0 is not allowed"):
        PureVectorEnv(0)
    many = PureVectorEnv(3)
    with pytest.raises(ResetNeeded):
        many.step(np.zeros(3, int))
    with pytest.raises(ValueError, match="seed: 2 of them are not allowed: 3"):
        many.reset(seed=[1, 2])
    many.reset(seed=0)
    many.step(np.zeros(3, np.uint64))
    for actions in (np.zeros(2, int), np.full(3, 2), np.full(3, 2, np.uint64), np.zeros(3)):
        with pytest.raises(InvalidAction):
            many.step(actions)
    with pytest.raises(TypeError, match="reset_mask"):
        many.reset(options={"reset_mask": [True, False, False]})
    with pytest.raises(ValueError, match="reset_mask"):
        many.reset(options={"reset_mask": np.zeros(3, bool)})


def test_a_second_environment_and_another_number_compile_nothing():
    functions = compiled.compiled(CartPole())
    for length in (0.2, 0.3):
        env = PureEnv("CartPole-v1", length=length)
        env.reset(seed=0)
        env.step(0)
    assert compiled.compiled(CartPole(length=0.7)) is functions
    assert functions.step._cache_size() == functions.begin._cache_size() == 1


@pytest.mark.parametrize("make", [lambda: PureEnv("CartPole-v1"), lambda: PureVectorEnv(2)])
def test_copies_and_pickles_go_on_alike(make):
    env = make()
    env.reset(seed=3)
    actions = [np.zeros(2, int) if hasattr(env, "num_envs") else 0] * 3
    env.step(actions[0])
    copies = [copy.deepcopy(env), pickle.loads(pickle.dumps(env))]
    rows = [[one.step(action)[0] for action in actions] for one in (env, *copies)]
    np.testing.assert_array_equal(rows[0], rows[1])
    np.testing.assert_array_equal(rows[0], rows[2])


def test_registration_imports_no_jax():
    code = "import sys, jaxq.interop.gymnasium, gymnasium; gymnasium.spec('jaxq/Taxi-v4'); print('jax' in sys.modules)"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout == "False\n"


# Many at once


@MODES
@pytest.mark.parametrize("name", ["CartPole-v1", "FrozenLake-v1"])
def test_many_at_once_are_gymnasiums_vector_of_one_each(name, mode):
    limit, count = 12, 3
    ours = gymnasium.make_vec(f"jaxq/{name}", num_envs=count, max_episode_steps=limit, autoreset_mode=mode)
    singles = [lambda: gymnasium.make(f"jaxq/{name}", max_episode_steps=limit) for _ in range(count)]
    theirs = SyncVectorEnv(singles, autoreset_mode=mode)
    assert isinstance(ours.unwrapped, PureVectorEnv)
    assert ours.metadata["autoreset_mode"] is mode
    assert ours.observation_space == theirs.observation_space
    assert ours.action_space == theirs.action_space
    assert ours.single_observation_space == theirs.single_observation_space
    rng, ended = np.random.default_rng(0), 0
    rows = [env.reset(seed=7) for env in (ours, theirs)]
    np.testing.assert_array_equal(rows[0][0], rows[1][0])
    assert rows[0][1] == rows[1][1] == {}
    for _ in range(60):
        actions = rng.integers(ours.single_action_space.n, size=count)
        (obs, reward, ends, cut, info), (obs_, reward_, ends_, cut_, info_) = (e.step(actions) for e in (ours, theirs))
        np.testing.assert_array_equal(obs, obs_)
        np.testing.assert_array_equal(reward, reward_)
        np.testing.assert_array_equal(ends, ends_)
        np.testing.assert_array_equal(cut, cut_)
        assert (obs.dtype, reward.dtype, ends.dtype) == (obs_.dtype, reward_.dtype, ends_.dtype)
        assert str(info) == str(info_)
        over = ends | cut
        ended += over.sum()
        if mode is AutoresetMode.DISABLED and over.any():
            with pytest.raises(ResetNeeded):
                ours.step(actions)
            resets = [env.reset(options={"reset_mask": over.copy()}) for env in (ours, theirs)]
            np.testing.assert_array_equal(resets[0][0], resets[1][0])
    assert ended > 6


@MODES
def test_later_resets_with_seeds_and_options_are_gymnasiums_vector_of_one_each(mode):
    ours = gymnasium.make_vec("jaxq/CartPole-v1", num_envs=3, autoreset_mode=mode)
    theirs = SyncVectorEnv([lambda: gymnasium.make("jaxq/CartPole-v1")] * 3, autoreset_mode=mode)
    rng, ended = np.random.default_rng(0), 0
    for seed, options in ((5, None), (7, {"low": 0.01, "high": 0.02}), ([1, None, 3], None)):
        first = [env.reset(seed=seed, options=options and dict(options))[0] for env in (ours, theirs)]
        np.testing.assert_array_equal(*first)
        for k in range(40):
            actions = rng.integers(2, size=3)
            rows = [env.step(actions) for env in (ours, theirs)]
            for mine, other in zip(rows[0][:4], rows[1][:4], strict=True):
                np.testing.assert_array_equal(mine, other)
            over = rows[0][2] | rows[0][3]
            ended += over.sum()
            if mode is AutoresetMode.DISABLED and over.any():
                again = {"seed": [11, 12, 13] if k % 2 else None}
                resets = [
                    env.reset(options={"reset_mask": over.copy(), "low": 0.03, "high": 0.04}, **again)[0]
                    for env in (ours, theirs)
                ]
                np.testing.assert_array_equal(*resets)
    assert ended > 9
    assert ours.np_random_seed == theirs.np_random_seed


def test_chance_differs_between_steps_episodes_and_seeds():
    """Two steps ahead on the ice, three ways each: as often as Gymnasium's table says."""
    env = gymnasium.make("jaxq/FrozenLake-v1")
    seen = []
    for episode in range(400):
        env.reset(seed=3 if episode == 0 else None)
        seen.append((int(env.step(2)[0]), int(env.step(2)[0])))
    table = interop.make(FrozenLake()).unwrapped.P
    expected = Counter()
    for p, s, _, ends in table[0][2]:
        for q, after, *_ in [(1.0, s)] if ends else table[s][2]:
            expected[int(s), int(after)] += p * q
    counts = Counter(seen)
    assert set(counts) == set(expected)
    for fate, p in expected.items():
        assert abs(counts[fate] / 400 - p) < 5 * np.sqrt(p * (1 - p) / 400)
    words = [np.random.default_rng(k).integers(0, 2**32, 2, dtype=np.uint32) for k in range(2)]
    step = compiled.compiled(FrozenLake()).step
    given = compiled.numbers(FrozenLake())
    state, _ = compiled.compiled(FrozenLake()).begin(words[0], np.uint32(0), given)
    for place in (0, 1):  # both words of a seed count
        mixed = [np.where(np.arange(2) == place, words[0], np.uint32(k)) for k in range(64)]
        assert len({int(step(of, np.uint32(0), state, np.int32(2), given)[1]) for of in mixed}) == 3


def test_every_environment_has_its_own_picture_and_observations_may_be_written_into():
    many = gymnasium.make_vec("jaxq/CartPole-v1", num_envs=2, render_mode="rgb_array")
    with pytest.raises(ResetNeeded):
        many.render()
    many.reset(seed=0, options={"low": -0.05, "high": 0.05})
    for _ in range(6):
        obs = many.step(np.array([0, 1]))[0]
    left, right = many.render()
    assert np.any(left != right)
    for picture, one in zip((left, right), obs, strict=True):
        state = CartPoleState(*one.tolist(), 6)
        np.testing.assert_array_equal(picture, frames.draw(many.unwrapped.world, state))
    alone = gymnasium.make("jaxq/CartPole-v1")
    seen, _ = alone.reset(seed=0)
    seen[:] = 9
    assert abs(alone.step(0)[0]).max() < 1
    obs[:] = 9
    assert abs(many.step(np.array([0, 1]))[0]).max() < 9


def test_an_environment_of_the_users_own():
    def make_env(length=0.3):
        return envs.make("CartPole-v1", length=length, max_episode_steps=7)

    for env in (PureEnv(make_env), PureEnv(make_env, length=0.3)):
        ours, theirs = env.reset(seed=1)[0], gymnasium.make("jaxq/CartPole-v1", length=0.3)
        np.testing.assert_array_equal(ours, theirs.reset(seed=1)[0])
        for k in range(7):
            row = env.step(k % 2)
            np.testing.assert_allclose(row[0], theirs.step(k % 2)[0], rtol=1e-6)
            assert row[3] == (k == 6)
    chain = PureVectorEnv(2, envs.two_states, p=0.25)
    assert chain.single_observation_space == gymnasium.spaces.Discrete(2)
    chain.reset(seed=0)
    assert chain.step(np.ones(2, int))[0].shape == (2,)
    assert PureEnv(CartPole(max_episode_steps=20)).world.max_episode_steps == 20
    with pytest.raises(ValueError, match=r"lenght: .* has no such setting; did you mean 'length'"):
        PureEnv(make_env, lenght=0.1)


def test_a_fork_is_refused_where_it_would_wait_for_ever_and_another_context_runs():
    code = """
import warnings
warnings.simplefilter("ignore")
import gymnasium, jaxq.interop.gymnasium
name = "jaxq.interop.gymnasium:jaxq/CartPole-v1"
if __name__ == "__main__":
    try:
        gymnasium.make_vec(name, 2, vectorization_mode="async", vector_kwargs={"context": "fork"}).reset(seed=0)
    except Exception as error:
        print(type(error).__name__, error)
    envs = gymnasium.make_vec(name, 2, vectorization_mode="async", vector_kwargs={"context": "forkserver"})
    print(envs.reset(seed=0)[0].shape)
    envs.close()
"""
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=300)
    assert "JAX does not survive a fork" in done.stderr  # of the worker; its parent hears that it has gone
    assert done.stdout.splitlines()[-1] == "(2, 4)"


def test_seeds_may_be_listed_and_go_on_without():
    ours = gymnasium.make_vec("jaxq/CartPole-v1", num_envs=3)
    one = ours.reset(seed=[4, None, 9])[0]
    singles = [gymnasium.make("jaxq/CartPole-v1").reset(seed=seed)[0] for seed in (4, 9)]
    np.testing.assert_array_equal(one[[0, 2]], singles)
    following = ours.reset()[0]
    single = gymnasium.make("jaxq/CartPole-v1")
    single.reset(seed=9)
    np.testing.assert_array_equal(following[2], single.reset()[0])
    assert not np.any(one == following)


def test_statistics_and_options_of_many():
    env = RecordEpisodeStatistics(gymnasium.make_vec("jaxq/CartPole-v1", num_envs=4))
    obs, _ = env.reset(seed=0, options={"low": 0.01, "high": 0.02})
    assert 0.01 <= obs.min() < obs.max() <= 0.02
    lengths = []
    for _ in range(40):
        *_, infos = env.step(np.zeros(4, int))
        if "episode" in infos:
            lengths += infos["episode"]["l"][infos["_episode"]].tolist()
    assert len(lengths) >= 8
    assert 7 <= min(lengths) <= max(lengths) <= 12


# Gymnasium's own


@pytest.mark.parametrize(
    ("one", "said"),
    [
        (Acrobot(gravity=5.0), "env.gravity: 5.0 is not allowed: Gymnasium's Acrobot-v1 has 9.8"),
        (Acrobot(torque_noise_max=0.1), "env.torque_noise_max: 0.1 is not allowed"),
        (type("Other", (CartPole,), {"__module__": __name__, "id": "Other-v0"})(), "env: Gymnasium has no Other-v0"),
    ],
)
def test_what_gymnasium_has_not_is_refused(one, said):
    with pytest.raises(ValueError, match=r"^env") as error:
        interop.make(one)
    assert said in str(error.value)


@pytest.mark.parametrize(
    "one",
    [
        CartPole(gravity=5.0, masscart=2.0, masspole=0.3, length=0.7, force_mag=8.0, tau=0.03, x_threshold=1.0),
        CartPole(integrator="semi-implicit", sutton_barto_reward=True),
        Acrobot(link_length_1=1.2, link_mass_1=0.8, link_mass_2=1.1, link_com_pos_1=0.4, link_com_pos_2=0.6, dt=0.1),
        Acrobot(dynamics="nips", link_moi=1.3, torque=0.7, max_vel_1=1.0, max_vel_2=1.5),
        MountainCar(force=0.002, gravity=0.003, max_speed=0.05, min_position=-1.0, goal_position=0.3),
        Pendulum(gravity=5.0, mass=1.5, length=0.8, dt=0.1, max_speed=4.0, max_torque=3.0, num_torques=4),
        Taxi(),
        FrozenLake(is_slippery=False, goal_reward=3.0, hole_reward=-2.0, frozen_reward=-0.1),
    ],
    ids=lambda one: repr(one)[:70],
)
def test_gymnasiums_environment_of_a_world_has_its_numbers(one):
    ours = gymnasium.make(f"jaxq/{one.id}", **{k: v for k, v in one if k != "max_episode_steps"})
    theirs = interop.make(one)
    ours.reset(seed=2)
    theirs.reset(seed=2)
    interop.place(theirs, one, ours.unwrapped.state)
    for k in range(50):
        action = k // 3 % int(ours.action_space.n)
        rows = ours.step(action), theirs.step(interop.action(one, action))
        np.testing.assert_allclose(rows[0][0], rows[1][0], rtol=1e-3, atol=1e-3)
        assert rows[0][1] == pytest.approx(float(rows[1][1]), rel=1e-3, abs=1e-3)
        assert rows[0][2:4] == rows[1][2:4]
        if rows[0][2] or rows[0][3]:
            break
    assert k > 3
