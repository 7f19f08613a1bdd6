"""Acrobot, MountainCar and Pendulum equal Gymnasium's, one step at a time, at their edges and over episodes."""

import contextlib
import functools
import itertools
import math
from dataclasses import dataclass, field
from typing import Any

import gymnasium
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy import stats

from jaxq import envs
from jaxq.envs import AcrobotState, MountainCarState, PendulumState
from jaxq.envs.acrobot import wrapped
from jaxq.envs.pendulum import normalised, torques
from jaxq.worlds import WORLDS

KEY = 20
ACROBOT_SPEEDS = (4 * math.pi, 9 * math.pi)


@dataclass(frozen=True)
class Case:
    """An environment of ours and of Gymnasium's, and how to compare them."""

    id: str
    state: Any
    low: tuple[float, ...]
    high: tuple[float, ...]
    error: dict[Any, float]  # of a step from such a state, by precision: measured, and twice that
    options: dict[str, Any] = field(default_factory=dict)
    attributes: dict[str, Any] = field(default_factory=dict)  # Gymnasium's, for the options

    def gym(self, **numbers):
        env = gymnasium.make(self.id, disable_env_checker=True)
        env.reset(seed=0)
        for name, value in {**self.attributes, **numbers}.items():
            if name == "torque":
                name, value = "AVAIL_TORQUE", [-value, 0.0, value]
            theirs = ATTRIBUTES.get(name, name)
            assert hasattr(env.unwrapped, theirs), theirs
            setattr(env.unwrapped, theirs, value)
        return env

    def action(self, a):
        return np.array([-2.0 + a]) if self.id == "Pendulum-v1" else int(a)


#: Gymnasium's name of a number of ours, where it is another.
ATTRIBUTES = {
    **{name: name.upper() for name in ("link_length_1", "link_mass_1", "link_mass_2", "link_com_pos_1")},
    **{name: name.upper() for name in ("link_com_pos_2", "link_moi", "max_vel_1", "max_vel_2")},
    "mass": "m",
    "length": "l",
}
CIRCLE = (math.pi, math.pi, *ACROBOT_SPEEDS)
ACROBOT = Case("Acrobot-v1", AcrobotState, tuple(-x for x in CIRCLE), CIRCLE, {np.float32: 2e-5, np.float64: 1e-12})
NIPS = Case(
    "Acrobot-v1",
    AcrobotState,
    tuple(-x for x in CIRCLE),
    CIRCLE,
    {np.float32: 2e-5, np.float64: 1e-12},
    {"dynamics": "nips"},
    {"book_or_nips": "nips"},
)
CAR = Case("MountainCar-v0", MountainCarState, (-1.2, -0.07), (0.6, 0.07), {np.float32: 3e-7, np.float64: 1e-15})
PENDULUM = Case("Pendulum-v1", PendulumState, (-25.0, -8.0), (25.0, 8.0), {np.float32: 5e-6, np.float64: 1e-13})
CASES = pytest.mark.parametrize(
    "case", [ACROBOT, NIPS, CAR, PENDULUM], ids=lambda c: c.id + "".join(c.attributes.values())
)
DTYPES = pytest.mark.parametrize("dtype", [np.float32, np.float64])


def precision(dtype):
    return jax.enable_x64(True) if np.dtype(dtype) == np.float64 else contextlib.nullcontext()


def theirs(case, states, actions, **numbers):
    """Gymnasium's successors, observations, rewards and terminations, each from its own state."""
    env, rows = case.gym(**numbers), []
    for state, action in zip(np.asarray(states, np.float64), actions, strict=True):
        env.unwrapped.state = state.copy()
        obs, reward, terminated, _, _ = env.unwrapped.step(case.action(action))
        rows.append((np.array(env.unwrapped.state, float), obs, reward, terminated))
    return tuple(np.array(column) for column in zip(*rows, strict=True))


def ours(case, states, actions, dtype, t=0, **numbers):
    """Our successors [n, D] and Steps."""
    states = np.asarray(states)
    count = len(states)
    padded = np.resize(states, (1 << (count - 1).bit_length(), states.shape[1]))  # few shapes, few programs
    size = len(padded)
    _, params_type = envs.registered(case.id)
    options = {**case.options, **{k: v for k, v in numbers.items() if k not in params_type._fields}}
    params = params_type(**{k: v for k, v in numbers.items() if k in params_type._fields})
    with precision(dtype):
        columns = jnp.asarray(padded, dtype).T
        times = np.resize(np.broadcast_to(t, (count,)), size)
        state = case.state(*columns, jnp.asarray(times, jnp.int32))
        step = stepper(case.id, dtype, tuple(sorted(options.items())))
        traced = params_type(*(jnp.asarray(x, jnp.int32 if isinstance(x, int) else dtype) for x in params))
        after, happened = step(traced, state, jnp.asarray(np.resize(np.asarray(actions), size), jnp.int32))
        rows = np.stack([np.asarray(leaf) for leaf in after[:-1]], -1)
        return rows[:count], jax.tree.map(lambda leaf: np.asarray(leaf)[:count], happened)


@functools.cache
def stepper(name, dtype, options):
    """One program for all numbers of an environment."""
    factory = envs.registered(name)[0]

    def steps(params, states, actions):
        env = factory(params, dtype=dtype, **dict(options))
        return jax.vmap(env.step, in_axes=(None, 0, 0))(jax.random.key(KEY), states, actions)

    return jax.jit(steps)


def random_states(case, count, dtype=np.float64, seed=1):
    """Uniform over the state space; as ``dtype``, and then in float64, so that both sides begin at the same numbers."""
    rows = np.random.default_rng(seed).uniform(case.low, case.high, (count, len(case.low)))
    return rows.astype(dtype).astype(np.float64)


def own_sensitivity(case, states, actions, dtype):
    """How far Gymnasium's own successors move when a coordinate of the start moves by an ulp: [n]."""
    plain, most = theirs(case, states, actions)[0], 0
    for i, way in itertools.product(range(states.shape[1]), (-1, 1)):
        moved = states.copy()
        moved[:, i] += way * np.spacing(np.abs(states[:, i]).astype(dtype)).astype(float)
        most = np.maximum(most, apart(case, theirs(case, moved, actions)[0], plain).max(-1))
    return most


def apart(case, one, other):
    """Distances; an angle at pi may be at -pi for the other."""
    distance = np.abs(one - other)
    if case.id == "Acrobot-v1":
        distance[:, :2] = np.minimum(distance[:, :2], np.abs(2 * math.pi - distance[:, :2]))
    return distance


@CASES
@DTYPES
def test_one_step_equals_gymnasium_from_any_state(case, dtype):
    count = 3
    states = np.repeat(random_states(case, 10_000, dtype), count, 0)
    actions = np.tile(np.arange(count), 10_000)
    expected, expected_obs, expected_reward, expected_ends = theirs(case, states, actions)
    found, happened = ours(case, states, actions, dtype)
    error = apart(case, found, expected).max(-1)
    # Near the bounds of its speeds Acrobot's step is chaotic: what is further apart than roundings explain must be so
    # where Gymnasium's own step turns an ulp into as much.
    far = error > case.error[dtype]
    assert np.mean(far) < (0.02 if case.id == "Acrobot-v1" else 1e-9)
    if far.any():
        assert np.all(error[far] < 100 * own_sensitivity(case, states[far], actions[far], dtype))
    near = ~far
    np.testing.assert_allclose(happened.obs[near], expected_obs[near], rtol=2e-7, atol=case.error[np.float32])
    same = happened.terminated == expected_ends
    assert np.all(same) if dtype == np.float64 else np.mean(~same) < 1e-4
    np.testing.assert_allclose(happened.reward[same], expected_reward[same], rtol=1e-5, atol=2e-6)
    assert happened.reward.dtype == happened.obs.dtype == np.float32
    assert not happened.truncated.any()
    if case.id != "Pendulum-v1":
        assert 100 < expected_ends.sum() < len(states) - 100


# Edges


@pytest.mark.parametrize("ulps", [-2, -1, 0, 1, 2])
def test_the_goal_of_mountain_car_counts_from_its_very_number_on(ulps):
    """A state that lands within ulps of the goal: its velocity is what is missing."""
    goal = 0.5 + ulps * np.spacing(0.5)
    rows = []
    for velocity in (0.01, 0.03):
        position = 0.5 - velocity
        for _ in range(50):  # moved until Gymnasium's own step lands there
            after = theirs(CAR, [[position, velocity]], [1])[0][0, 0]
            position += goal - after
        rows.append([position, velocity])
    expected, _, _, ends = theirs(CAR, rows, [1, 1])
    assert np.abs(expected[:, 0] - goal).max() <= np.spacing(0.5)
    found, happened = ours(CAR, rows, [1, 1], np.float64)
    np.testing.assert_array_equal(found, expected)
    np.testing.assert_array_equal(happened.terminated, ends)


def test_the_wall_of_mountain_car_takes_a_velocity_to_the_left_alone():
    states = [[-1.2, -0.05], [-1.19, -0.07], [-1.2, 0.0], [-1.2, 0.02], [0.6, 0.07], [0.59, 0.07]]
    for action in range(3):
        expected, _, _, ends = theirs(CAR, states, [action] * 6)
        found, happened = ours(CAR, states, [action] * 6, np.float64)
        np.testing.assert_array_equal(found, expected)
        np.testing.assert_array_equal(happened.terminated, ends)
    assert found[0].tolist() == [-1.2, 0.0]
    assert found[4, 0] == 0.6


def test_the_goal_needs_its_velocity():
    for velocity in (0.0, 0.02, -0.01):
        states = [[0.55, 0.01], [0.55, 0.03], [0.55, -0.02]]
        _, _, _, ends = theirs(CAR, states, [1] * 3, goal_velocity=velocity)
        _, happened = ours(CAR, states, [1] * 3, np.float64, goal_velocity=velocity)
        np.testing.assert_array_equal(happened.terminated, ends)


@pytest.mark.parametrize("angle", [0.0, 1.0, -1.0, math.pi, -math.pi, 3.5, -3.5, 9.0, -9.0, 9.5, -16.0, 40.0])
def test_angles_are_wrapped_as_gymnasium_wraps_them(angle):
    from gymnasium.envs.classic_control.acrobot import wrap
    from gymnasium.envs.classic_control.pendulum import angle_normalize

    with jax.enable_x64(True):
        for near in (np.nextafter(angle, -100), angle, np.nextafter(angle, 100)):
            assert float(wrapped(jnp.asarray(near))) == pytest.approx(wrap(near, -math.pi, math.pi), abs=1e-14)
            assert float(normalised(jnp.asarray(near))) == pytest.approx(angle_normalize(near), abs=1e-14)
    inside = np.float32([-np.pi, -1, 0, 2, np.pi])
    np.testing.assert_array_equal(wrapped(inside), inside)


def test_speeds_are_clipped_at_their_bounds():
    for case, columns, bounds in ((ACROBOT, (2, 3), ACROBOT_SPEEDS), (CAR, (1,), (0.07,)), (PENDULUM, (1,), (8.0,))):
        states = random_states(case, 3000, seed=5)
        for column, bound in zip(columns, bounds, strict=True):
            states[::2, column] = bound
            states[1::2, column] = -bound
        actions = np.arange(3000) % 3
        expected, found = theirs(case, states, actions)[0], ours(case, states, actions, np.float64)[0]
        np.testing.assert_allclose(found, expected, atol=2e-11)
        for column, bound in zip(columns, bounds, strict=True):
            assert np.mean(np.abs(found[:, column]) == bound) > 0.1
            assert np.abs(found[:, column]).max() == bound


def test_torques_are_even_with_exact_ends_and_middle():
    assert torques(5, 2.0).tolist() == [-2, -1, 0, 1, 2]
    assert torques(2, 3.0).tolist() == [-3, 3]
    assert torques(7, 2.0)[3] == 0
    assert envs.make("Pendulum-v1", num_torques=9).num_actions == 9
    with pytest.raises(ValueError, match="num_torques: 1 is not allowed"):
        envs.make("Pendulum-v1", num_torques=1)
    states = random_states(PENDULUM, 50)
    env = PENDULUM.gym()
    _, happened = ours(PENDULUM, states, np.arange(50) % 3, np.float64, num_torques=3)
    for state, k, reward in zip(states, np.arange(50) % 3, happened.reward, strict=True):
        env.unwrapped.state = state
        assert env.unwrapped.step(np.array([2.0 * (k - 1)]))[1] == pytest.approx(float(reward), rel=1e-5)


# Numbers


NUMBERS = [
    *((ACROBOT, name, value) for name, value in (("link_length_1", 1.3), ("link_mass_1", 0.7), ("link_mass_2", 1.4))),
    *((ACROBOT, name, value) for name, value in (("link_com_pos_1", 0.4), ("link_com_pos_2", 0.6), ("link_moi", 1.2))),
    *((ACROBOT, name, value) for name, value in (("max_vel_1", 3.0), ("max_vel_2", 4.0), ("dt", 0.1), ("torque", 2.0))),
    *((CAR, name, value) for name, value in (("min_position", -0.9), ("max_position", 0.4), ("max_speed", 0.03))),
    *((CAR, name, value) for name, value in (("goal_position", 0.2), ("goal_velocity", 0.03), ("force", 0.01))),
    (CAR, "gravity", 0.004),
    *((PENDULUM, name, value) for name, value in (("mass", 1.5), ("length", 0.8), ("dt", 0.1), ("max_speed", 3.0))),
]


@pytest.mark.parametrize(("case", "name", "value"), NUMBERS, ids=lambda x: str(getattr(x, "id", x)))
def test_every_number_moves_the_world_as_gymnasiums_does(case, name, value):
    states, actions = random_states(case, 400, seed=3), np.arange(400) % 3
    expected, _, reward, ends = theirs(case, states, actions, **{name: value})
    found, happened = ours(case, states, actions, np.float64, **{name: value})
    np.testing.assert_allclose(found, expected, atol=1e-10)
    np.testing.assert_array_equal(happened.terminated, ends)
    np.testing.assert_allclose(happened.reward, reward, rtol=1e-5, atol=1e-6)
    plain, as_it_was = ours(case, states, actions, np.float64)
    assert np.any(plain != found) or np.any(as_it_was.terminated != happened.terminated)


def test_gravity_and_greatest_torque_are_in_the_equations():
    """Gymnasium writes Acrobot's gravity into its equations and Pendulum's torque into its action space."""
    states = random_states(PENDULUM, 300)
    env = gymnasium.make("Pendulum-v1", g=3.7, disable_env_checker=True).unwrapped
    env.reset(seed=0)
    env.max_torque = 5.0
    found, _ = ours(PENDULUM, states, np.full(300, 4), np.float64, gravity=3.7, max_torque=5.0)
    for state, after in zip(states, found, strict=True):
        env.state = state
        env.step(np.array([5.0]))
        np.testing.assert_allclose(after, env.state, atol=1e-12)
    # Without gravity, and with both masses and lengths as they are, a resting acrobot without torque stays.
    rest = np.array([[0.3, -0.7, 0.0, 0.0]])
    assert np.abs(ours(ACROBOT, rest, [1], np.float64, gravity=1e-6)[0] - rest).max() < 1e-7
    # Four times the gravity in half the time: the same path, twice as fast. Acceleration is linear in g at rest.
    slow = ours(ACROBOT, rest, [1], np.float64, gravity=2.0, dt=0.2)[0]
    fast = ours(ACROBOT, rest, [1], np.float64, gravity=8.0, dt=0.1)[0]
    np.testing.assert_allclose(fast[:, :2], slow[:, :2], atol=1e-12)
    np.testing.assert_allclose(fast[:, 2:], 2 * slow[:, 2:], atol=1e-12)


def test_noise_on_the_torque_is_uniform_and_draws_nothing_that_shows_without_it():
    env = envs.make("Acrobot-v1", torque_noise_max=0.5)
    quiet = envs.make("Acrobot-v1")
    state = AcrobotState(*jnp.float32([0.3, -0.2, 0.1, 0.4]), jnp.int32(0))
    keys = jax.random.split(jax.random.key(0), 4000)
    speeds = np.asarray(jax.jit(jax.vmap(lambda key: env.step(key, state, 1)[0].theta2_dot))(keys))
    ends = [float(envs.make("Acrobot-v1", torque=0.5).step(jax.random.key(0), state, a)[0].theta2_dot) for a in (0, 2)]
    # The torque acts linearly but for terms of the fourth order in dt.
    assert stats.kstest(speeds, stats.uniform(ends[0], ends[1] - ends[0]).cdf).pvalue > 1e-3
    same = jax.jit(jax.vmap(lambda key: quiet.step(key, state, 1)[0].theta2_dot))(
        jax.random.split(jax.random.key(1), 50)
    )
    assert len(np.unique(same)) == 1


@pytest.mark.parametrize("name", ["Acrobot-v1", "MountainCar-v0", "Pendulum-v1"])
def test_defaults_are_the_worlds(name):
    world = WORLDS[name]()
    numbers = {k: v for k, v in world.flat().items() if not world.is_structure(k)}
    assert envs.registered(name)[1]()._asdict() == numbers


# Episodes


def pump(obs):
    """Pushes the car the way it moves."""
    return 2 if obs[1] >= 0 else 0


def swing(obs):
    """Drives the hip the way it moves."""
    return 2 if obs[5] > 0 else 0


POLICIES = {
    "Acrobot-v1": {"random": None, "swing": swing, "still": lambda obs: 1},
    "MountainCar-v0": {"random": None, "pump": pump, "left": lambda obs: 0},
    "Pendulum-v1": {"random": None, "right": lambda obs: 4},
}


@pytest.mark.parametrize(
    ("case", "policy"),
    [(c, p) for c in (ACROBOT, CAR, PENDULUM) for p in POLICIES[c.id]],
    ids=lambda x: getattr(x, "id", x),
)
@DTYPES
def test_whole_episodes_equal_gymnasium(case, policy, dtype):
    rng, chosen = np.random.default_rng(0), POLICIES[case.id][policy]
    before, actions, rows, lengths = [], [], [], []
    for seed in range(3):
        env = gymnasium.make(case.id)
        obs, _ = env.reset(seed=seed)
        over, t = False, 0
        while not over:
            before.append((*np.array(env.unwrapped.state, float), t))
            actions.append(int(rng.integers(3)) if chosen is None else chosen(obs))
            obs, reward, terminated, truncated, _ = env.step(case.action(actions[-1]))
            rows.append((*np.array(env.unwrapped.state, float), reward, terminated, truncated))
            over, t = terminated or truncated, t + 1
        lengths.append(t)
    before, rows = np.array(before), np.array(rows, float)
    found, happened = ours(case, before[:, :-1], actions, dtype, before[:, -1])
    width = found.shape[1]
    np.testing.assert_allclose(found, rows[:, :width], rtol=0, atol=1e-12 if dtype == np.float64 else 3e-5)
    np.testing.assert_allclose(happened.reward, rows[:, width], rtol=1e-5, atol=1e-5)
    np.testing.assert_array_equal(happened.terminated, rows[:, width + 1] > 0)
    np.testing.assert_array_equal(happened.truncated, rows[:, width + 2] > 0)
    limit = WORLDS[case.id]().max_episode_steps
    if policy in ("pump", "swing"):
        assert max(lengths) < limit
    elif policy != "random":
        assert lengths == [limit] * 3


@pytest.mark.parametrize(
    ("case", "policy", "steps"),
    [(ACROBOT, swing, 60), (CAR, pump, 90), (PENDULUM, lambda obs: 4, 150)],
    ids=["a", "c", "p"],
)
def test_running_freely_in_float64_stays_with_gymnasium(case, policy, steps):
    env = gymnasium.make(case.id)
    obs, _ = env.reset(seed=3)
    with jax.enable_x64(True):
        pure = envs.make(case.id, dtype=np.float64)
        step = jax.jit(pure.step)
        state = case.state(*jnp.asarray(np.array(env.unwrapped.state, float)), jnp.int32(0))
        for _ in range(steps):
            action = policy(obs)
            obs, *_ = env.step(case.action(action))
            state, _ = step(jax.random.key(KEY), state, action)
            np.testing.assert_allclose(np.array(state[:-1], float), np.array(env.unwrapped.state, float), atol=1e-7)


def test_a_limit_of_our_own_truncates_and_an_end_there_is_both():
    state = MountainCarState(*jnp.float32([0.49, 0.05]), jnp.int32(6))
    _, happened = envs.make("MountainCar-v0", max_episode_steps=7).step(jax.random.key(0), state, 2)
    assert bool(happened.terminated)
    assert bool(happened.truncated)
    _, happened = envs.make("MountainCar-v0", max_episode_steps=8).step(jax.random.key(0), state, 2)
    assert not bool(happened.truncated)


# Reset


@pytest.mark.parametrize("case", [ACROBOT, CAR, PENDULUM], ids=lambda c: c.id)
def test_a_reset_is_uniform_as_in_gymnasium(case):
    env = envs.make(case.id)
    keys = jax.random.split(jax.random.key(KEY), 5000)
    found = np.stack([np.asarray(leaf) for leaf in jax.jit(jax.vmap(env.reset))(keys)], -1)
    gym = gymnasium.make(case.id).unwrapped
    states = []
    for seed in range(1500):
        gym.reset(seed=seed)
        states.append(np.array(gym.state, float))
    states = np.array(states)
    assert np.all(found[:, -1] == 0)
    for i in range(states.shape[1]):
        if np.ptp(states[:, i]) == 0:
            assert np.all(found[:, i] == states[0, i])
            continue
        assert stats.ks_2samp(found[:, i], states[:, i]).pvalue > 1e-3
        assert stats.pearsonr(found[:-1, i], found[1:, i]).pvalue > 1e-3
    for i, j in itertools.combinations([k for k in range(states.shape[1]) if np.ptp(states[:, k])], 2):
        table = np.histogram2d(found[:, i], found[:, j], bins=6)[0]
        assert stats.chi2_contingency(table).pvalue > 1e-3


@pytest.mark.parametrize("name", ["Acrobot-v1", "MountainCar-v0", "Pendulum-v1"])
def test_what_cannot_be_is_refused(name):
    with pytest.raises(ValueError, match="dtype: float16 is not one of float32, float64"):
        envs.make(name, dtype=np.float16)
    with pytest.raises(ValueError, match=r"float64 needs jax\.config\.update"):
        envs.make(name, dtype=np.float64)
    if name == "Acrobot-v1":
        with pytest.raises(ValueError, match="dynamics: paper is not allowed: input should be 'book' or 'nips'"):
            envs.make(name, dynamics="paper")
