"""Every environment, every wrapper, and towers of wrappers keep the contract; broken ones are caught."""

from dataclasses import replace

import contract
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxq import envs
from jaxq.envs import (
    Outcomes,
    auto_reset,
    discretise,
    finite_mdp,
    frame_history,
    normalise_observation,
    normalise_reward,
    one_hot,
    outcome_mdp,
    random_mdp,
    scale_reward,
    sticky_actions,
    time_limit,
    tutorial_edges,
)
from jaxq.worlds import WORLDS


def some_mdp(limit=30):
    mdp = random_mdp(np.random.default_rng(0), 7, 3)
    return finite_mdp(mdp.transition, mdp.reward, mdp.start, terminal=mdp.terminal, max_episode_steps=limit)


def some_mdp_by_transition():
    mdp = random_mdp(np.random.default_rng(1), 9, 2, branching=3)
    rewards = np.random.default_rng(2).normal(size=mdp.transition.shape)
    return finite_mdp(mdp.transition, rewards, mdp.start, terminal=mdp.terminal, max_episode_steps=20)


def some_outcomes():
    rng, shape = np.random.default_rng(3), (6, 3, 4)
    outcomes = Outcomes(rng.integers(6, size=shape), rng.integers(2, size=shape), rng.uniform(size=shape) < 0.1)
    return outcome_mdp(outcomes, rng.dirichlet(np.ones(4), shape[:2]), np.array([0.5, -1]), np.arange(3))


def short(name, **settings):
    """A world whose episodes end within a walk."""
    return envs.make(name, max_episode_steps=60, **settings)


def usual_buckets(name):
    world = WORLDS[name]()
    low, high = zip(*world.bounds, strict=True)
    return discretise(short(name), tutorial_edges(low, high, world.buckets))


def buckets(env):
    return discretise(env, [np.array([0.0], np.float32)] * env.obs_shape[0])


def cartpole():
    return envs.make("CartPole-v1")


ENVS = {
    **{name: lambda name=name: short(name) for name in envs.names()},
    "CartPole-v1 semi-implicit": lambda: envs.make("CartPole-v1", integrator="semi-implicit", sutton_barto_reward=True),
    "Acrobot-v1 nips": lambda: short("Acrobot-v1", dynamics="nips", torque_noise_max=0.3),
    "Pendulum-v1 of 3": lambda: short("Pendulum-v1", num_torques=3),
    "FrozenLake-v1 dry": lambda: envs.make("FrozenLake-v1", is_slippery=False),
    "CliffWalking-v1 slippery": lambda: short("CliffWalking-v1", is_slippery=True),
    "Taxi-v4 rainy": lambda: short("Taxi-v4", is_rainy=True),
    "two states": envs.two_states,
    "random MDP": some_mdp,
    "random MDP of rewards by transition": some_mdp_by_transition,
    "outcomes": some_outcomes,
    **{f"probe {probe.name}": lambda probe=probe: probe.env for probe in envs.probes()},
}
WRAPPED = {
    "time limit": lambda env: time_limit(env, 9),
    "sticky": lambda env: sticky_actions(env, 0.3),
    "scaled": lambda env: scale_reward(env, 0.1, shift=1.0),
    "history": lambda env: frame_history(env, 3),
    "history of zeros": lambda env: frame_history(env, 2, padding="zero"),
    "normal observation": normalise_observation,
    "normal reward": normalise_reward,
    "auto-reset": auto_reset,
}
TOWERS = {
    "sticky history normal": lambda: normalise_observation(frame_history(sticky_actions(cartpole(), 0.25), 4)),
    "history normal sticky": lambda: sticky_actions(normalise_observation(frame_history(cartpole(), 2)), 0.25),
    "limit normal reward": lambda: normalise_reward(normalise_observation(time_limit(cartpole(), 12))),
    "normal limit history": lambda: frame_history(time_limit(normalise_observation(cartpole()), 12), 2),
    "buckets one-hot": lambda: scale_reward(one_hot(buckets(cartpole())), 0.5),
    "one-hot history": lambda: time_limit(frame_history(one_hot(some_mdp()), 3), 5),
}
ALL = {
    **ENVS,
    **{f"{name} of CartPole": lambda wrap=wrap: wrap(cartpole()) for name, wrap in WRAPPED.items()},
    **{f"{name} of an MDP": lambda wrap=wrap: wrap(some_mdp()) for name, wrap in WRAPPED.items()},
    "buckets": lambda: buckets(cartpole()),
    **{
        f"usual buckets of {name}": lambda name=name: usual_buckets(name)
        for name in ("MountainCar-v0", "Acrobot-v1", "Pendulum-v1")
    },
    "one-hot": lambda: one_hot(some_mdp()),
    **TOWERS,
}


@pytest.fixture(scope="module", params=ALL)
def env(request):
    return ALL[request.param]()


@pytest.mark.parametrize("check", contract.CHECKS, ids=lambda check: check.__name__)
def test_the_contract(env, check):
    check(env)


#: They have one start.
ONE_START = ("FrozenLake-v1", "FrozenLake8x8-v1", "CliffWalking-v1")


@pytest.mark.parametrize(
    "name", [n for n in envs.names() if n not in ONE_START] + ["probe observation", "history of an MDP"]
)
def test_several_starts_differ(name):
    contract.several_starts_differ(ALL[name]())


@pytest.mark.parametrize("name", [n for n in ALL if " of CartPole" in n or n in TOWERS])
def test_episodes_of_wrapped_worlds_begin_as_their_key_says(name):
    env = ALL[name]()
    contract.several_starts_differ(env)
    contract.several_restarts_differ(env)


@pytest.mark.parametrize("name", envs.names())
def test_truncation_comes_at_the_limit_and_not_before(name):
    env = envs.make(name, max_episode_steps=7)
    state = env.reset(jax.random.key(0))
    at = {leaf: state._replace(t=jnp.int32(leaf)) for leaf in (5, 6)}
    for t, start in at.items():
        assert bool(env.step(jax.random.key(1), start, 0)[1].truncated) == (t == 6)
    assert WORLDS[name]().max_episode_steps >= 100


@pytest.mark.parametrize("name", envs.names())
def test_every_number_is_traced_and_a_batch_of_them_is_each_alone(name):
    factory, params_type = envs.registered(name)
    world = WORLDS[name]()
    assert {k: v for k, v in world.flat().items() if not world.is_structure(k)} == params_type()._asdict()
    low = params_type(*(value * 0.9 if isinstance(value, float) else 3 for value in params_type()))
    both = params_type(*(jnp.stack([jnp.asarray(a), jnp.asarray(b)]) for a, b in zip(params_type(), low, strict=True)))

    def one(params):
        env = factory(params)
        reset_key, step_key = jax.random.split(jax.random.key(0))
        state = env.reset(reset_key)._replace(t=jnp.int32(2))
        return env.step(step_key, state, 1)

    batch = jax.jit(jax.vmap(one))(both)
    for lane, params in enumerate((params_type(), low)):
        for a, b in zip(jax.tree.leaves(one(params)), jax.tree.leaves(batch), strict=True):
            np.testing.assert_allclose(a, b[lane], rtol=2e-6, atol=2e-6)
    assert np.asarray(batch[1].truncated).tolist() == [False, True]


# The contract can fail


def broken(change):
    env = cartpole()
    return replace(env, **change(env))


def leaking(env):
    """The reset observation in the Step's place after an end, as many auto-resets have it."""
    inner = auto_reset(time_limit(env, 5))

    def step(key, state, action):
        after, happened = inner.step(key, state, action)
        return after, happened._replace(obs=env.observe(env.reset(jax.random.key(0))))

    return {"step": step, "reset": inner.reset, "observe": inner.observe}


BROKEN = {
    "a_reset_depends_on_its_key_alone": None,
    "shapes_and_dtypes_are_stable": lambda env: {
        "step": lambda k, s, a: (lambda r: (r[0]._replace(t=r[0].t + 1.0), r[1]))(env.step(k, s, a))
    },
    "a_walk_is_finite_and_in_range": lambda env: {
        "step": lambda k, s, a: (lambda r: (r[0], r[1]._replace(reward=r[1].reward / (r[0].t < 3))))(env.step(k, s, a))
    },
    "the_true_successor_is_kept": leaking,
    "a_deterministic_step_does_not_use_its_key": lambda env: {
        "step": lambda k, s, a: env.step(k, s._replace(x=s.x + jax.random.normal(k)), a)
    },
    "a_batch_is_each_alone": lambda env: {
        "step": lambda k, s, a: env.step(k, s._replace(x=s.x + (0.0 if isinstance(s.x, jax.core.Tracer) else 0.1)), a)
    },
}


@pytest.mark.parametrize("name", [name for name, change in BROKEN.items() if change])
def test_a_broken_environment_is_caught(name):
    check = getattr(contract, name)
    check(cartpole())
    with pytest.raises((AssertionError, TypeError)):
        check(broken(BROKEN[name]))


def test_a_start_that_remembers_is_caught():
    count = iter(range(10))
    env = cartpole()
    fickle = replace(env, reset=lambda key: env.reset(key)._replace(x=jnp.float32(next(count))))
    with pytest.raises(AssertionError, match="a key gives two starts"):
        contract.a_reset_depends_on_its_key_alone(fickle)


@pytest.mark.parametrize(
    ("name", "settings", "said"),
    [
        ("CartPole-v1", {"length": float("nan")}, "length: nan is not allowed"),
        ("CartPole-v1", {"length": -1}, "length: -1 is not allowed"),
        ("CartPole-v1", {"max_episode_steps": 2.5}, "max_episode_steps: 2.5 is not allowed: a whole number"),
        ("CartPole-v1", {"reset_low": 1.0}, r"reset_low: 1.0 must not be above reset_high \(0.05\)"),
        ("FrozenLake-v1", {"success_rate": 1.5}, "success_rate: 1.5 is not allowed"),
        ("FrozenLake-v1", {"is_slippery": "maybe"}, "is_slippery: maybe is not allowed"),
        ("Pendulum-v1", {"num_torques": 2.5}, "num_torques: 2.5 is not allowed"),
        (None, {}, "environment: None is unknown"),
    ],
)
def test_numbers_outside_of_their_ranges_are_refused_by_name(name, settings, said):
    with pytest.raises(ValueError, match=said):
        envs.make(name, **settings)


def test_a_word_for_a_switch_is_that_switch():
    assert envs.make("FrozenLake-v1", is_slippery="no").deterministic
