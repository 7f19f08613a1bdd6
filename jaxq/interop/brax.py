"""brax, both ways: our environments for its trainers and wrappers, and its environments for our learners.

brax is imported by the first call here and nowhere else; what it says on import goes nowhere, and warnings that its own
import causes are not raised.
"""

from __future__ import annotations

import contextlib
import functools
import inspect
import io
import itertools
import types
import warnings
from collections.abc import Callable, Iterator, Sequence
from importlib import metadata
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from jaxq.envs import time_limit
from jaxq.envs.mdp import check_steps
from jaxq.interop.dtypes import as_arrays, like
from jaxq.requests import whole
from jaxq.suggest import nearest
from jaxq.types import Array, ArrayLike, Env, Key, Step

#: More actions than this are more than a table of action values should have.
MOST_ACTIONS = 1000


#: The family of the keys that a brax state carries as words, whatever the key of its reset was.
FAMILY = "threefry2x32"


@functools.cache
def _brax() -> Any:
    """brax.envs, imported without a word."""
    with contextlib.redirect_stdout(io.StringIO()), _without_warnings():
        from brax import envs
    return envs


@functools.cache
def _ppo() -> Any:
    """brax's PPO trainer, imported without a word."""
    with contextlib.redirect_stdout(io.StringIO()), _without_warnings():
        from brax.training import pmap
        from brax.training.agents.ppo import train as ppo
    if not hasattr(jax, "device_put_replicated"):  # gone since jax 0.10, and brax 0.14 calls it
        for module in (ppo, pmap):
            module.jax = _Jax("jax")  # type: ignore[attr-defined]
    return ppo


class _Jax(types.ModuleType):
    """jax as brax knows it: all of it, and ``device_put_replicated`` as it was."""

    def __getattr__(self, name: str) -> Any:
        return getattr(jax, name)

    @staticmethod
    def device_put_replicated(x: Any, devices: Sequence[Any]) -> Any:
        """A copy of each leaf on each device, on a new leading axis."""
        mesh = jax.sharding.Mesh(np.array(devices), ("devices",))
        spread = jax.sharding.NamedSharding(mesh, jax.sharding.PartitionSpec("devices"))
        return jax.tree.map(lambda leaf: jax.device_put(jnp.stack([jnp.asarray(leaf)] * len(devices)), spread), x)


@contextlib.contextmanager
def _without_warnings() -> Iterator[None]:
    """While brax and what it is built on are imported or traced: nobody here can heed what they deprecate."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        yield


def to_brax(env: Env) -> Any:
    """``env`` as a ``brax.envs.Env``, for brax's wrappers and trainers.

    Its one action, in [-1, 1], is cut into as many equal bins as ``env`` has actions: index = floor((a + 1) / 2 * A),
    at most A - 1. Observations are flat floats, integers one-hot. ``done`` is a termination alone, since in brax time
    limits are the ``EpisodeWrapper``'s: it cuts at its ``episode_length``, sets ``info["truncation"]``, and the trainer
    bootstraps there. Where ``env`` has a limit of its own it shows in ``info["truncation"]`` too, which that wrapper
    replaces. brax's ``AutoResetWrapper`` returns to the first state of each environment; chance goes on from there.

    Raises TypeError for what is no ``jaxq.types.Env``, and ValueError for one whose statistics outlive an episode,
    which brax's auto-reset would drop.
    """
    if not isinstance(env, Env):
        raise TypeError(f"env: {env!r} is not allowed: a jaxq.types.Env, as jaxq.envs.make gives")
    if env.restart is not None:
        raise ValueError("env: statistics that outlive an episode are not allowed: brax's auto-reset would drop them")
    base = _brax()

    class PureBrax(base.Env):  # type: ignore[name-defined,misc]
        """A jaxq environment that brax can run."""

        @property
        def observation_size(self) -> int:
            return int(env.num_states or np.prod(env.obs_shape))

        @property
        def action_size(self) -> int:
            return 1

        @property
        def backend(self) -> str:
            return "jaxq"

        def reset(self, rng: Key) -> Any:
            """A first state; ``rng`` is a key, typed or, as brax's wrappers have it, its words. It is consumed."""
            typed = jnp.issubdtype(rng.dtype, jax.dtypes.prng_key)
            reset_key, step_key = jax.random.split(rng if typed else jax.random.wrap_key_data(rng))
            state, zero = env.reset(reset_key), jnp.zeros((), float)
            # In the info, not in the state: brax's auto-reset returns to the first state, and chance must go on.
            info = {"truncation": zero, "key": jax.random.bits(step_key, (2,), jnp.uint32)}
            return base.State(state, self._flat(env.observe(state)), zero, zero, {}, info)

        def step(self, state: Any, action: Array) -> Any:
            """What comes of an action, shape [1]."""
            step_key, rest = jax.random.split(jax.random.wrap_key_data(state.info["key"], impl=FAMILY))
            after, happened = env.step(step_key, state.pipeline_state, binned(action[..., 0], env.num_actions))
            over = happened.terminated.astype(float)
            truncation = happened.truncated.astype(float) * (1 - over)
            info = {**state.info, "truncation": truncation, "key": jax.random.key_data(rest)}
            obs, reward = self._flat(happened.obs), happened.reward.astype(float)
            return state.replace(pipeline_state=after, obs=obs, reward=reward, done=over, info=info)

        def _flat(self, obs: Array) -> Array:  # floats as wide as brax's own, which JAX's settings say
            if env.num_states is not None:
                return (jnp.arange(env.num_states) == obs).astype(float)
            return jnp.ravel(obs).astype(float)

    return PureBrax()


def ppo(env: Any, **options: Any) -> tuple[Callable[..., Any], Any, dict[str, Any]]:
    """Runs brax's PPO trainer in an environment of ours, or of brax's.

    ``options`` are those of ``brax.training.agents.ppo.train.train``, of which it needs ``num_timesteps`` and
    ``episode_length``; ``eval_env`` may be ours as well. Returned is what it returns: a function that makes policies,
    the parameters, and the last metrics. Raises TypeError for an unknown option. Schulman et al., *Proximal Policy
    Optimization Algorithms*, 2017.
    """
    trainer = _ppo().train
    known = inspect.signature(trainer).parameters.keys() - {"environment"}
    for name in options:
        if name not in known:
            raise TypeError(f"{name}: brax's PPO has no such option{nearest(name, known)}")
    if "eval_env" in options:
        options["eval_env"] = _for_brax(options["eval_env"])
    environment = _for_brax(env)
    with _without_warnings():
        return trainer(environment=environment, **options)  # type: ignore[no-any-return]


def _for_brax(env: Any) -> Any:
    """An environment of ours for brax, its own as they are, and so is None."""
    return env if env is None or isinstance(env, _brax().Env) else to_brax(env)


def binned(action: Array, num_actions: int) -> Array:
    """The index of a real action in [-1, 1]: floor((a + 1) / 2 * A), kept within 0 .. A - 1. Shapes: [...] -> [...].

    >>> [int(binned(jnp.float32(a), 3)) for a in (-1.0, -0.4, 0.0, 0.9, 1.0)]
    [0, 0, 1, 2, 2]
    """
    return jnp.clip(jnp.floor((action + 1) / 2 * num_actions), 0, num_actions - 1).astype(jnp.int32)


def from_brax(env: Any, *, bins: int = 5, episode_length: ArrayLike = 1000, backend: str = "generalized") -> Env:
    """A brax environment, by name or itself, as one of ours with discrete actions.

    Each dimension of its action takes ``bins`` values, evenly from -1 to 1; several dimensions take their product, the
    last one changing fastest. An episode terminates where brax says ``done`` and is truncated after ``episode_length``
    steps, which may be traced. Raises TypeError for an environment that is not brax's, and ValueError for one with
    brax's wrappers, which reset by themselves, for fewer than two bins, more than a thousand actions, a length below 1
    and an unknown name.
    """
    check_steps(episode_length, "episode_length")
    base = _brax()
    if isinstance(env, str):
        if env not in base._envs:
            known = sorted(base._envs)
            raise ValueError(f"env: {env!r} is unknown{nearest(env, known)}; brax has {', '.join(known)}")
        with _without_warnings():
            env = base.get_environment(env, backend=backend)
    if not isinstance(env, base.Env):
        raise TypeError(f"env: {env!r} is not allowed: a brax environment or its name")
    if isinstance(env, base.Wrapper):
        raise ValueError(f"env: {type(env).__name__} is not allowed: a bare brax environment, as get_environment gives")
    whole("bins", bins, 2, MOST_ACTIONS)
    if (count := bins**env.action_size) > MOST_ACTIONS:
        raise ValueError(
            f"bins: {bins} in each of {env.action_size} dimensions are {count} actions: at most {MOST_ACTIONS}"
        )
    each = np.linspace(-1, 1, bins, dtype=np.float32)
    choices = np.array(list(itertools.product(each, repeat=env.action_size)))

    def reset(key: Key) -> Any:
        with _without_warnings():
            return as_arrays(env.reset(key))

    def step(key: Key, state: Any, action: Array) -> tuple[Any, Step]:
        del key
        # brax writes into the dictionaries of the state it is given: it gets others.
        given = jax.tree.map(lambda leaf: leaf, state)
        with _without_warnings():
            after = like(env.step(given, jnp.asarray(choices)[action]), state)
        return after, Step(after.obs, after.reward.astype(jnp.float32), after.done > 0, jnp.zeros((), bool))

    bare = Env(
        reset,
        step,
        lambda state: state.obs,
        num_actions=count,
        obs_shape=jax.eval_shape(reset, jax.random.key(0)).obs.shape,
        deterministic=True,
    )
    return time_limit(bare, episode_length)


def world(name: str, *, bins: int = 5, backend: str = "generalized") -> Callable[..., Env]:
    """A function that makes a brax environment, for ``jaxq.sweep("dqn", env=world("inverted_pendulum"))``.

    Its number ``episode_length`` is an axis like any other. A run directory of it is not resumed under another version
    of brax or mujoco. Raises as ``from_brax``.
    """
    versions = {package: metadata.version(package) for package in ("brax", "mujoco")}

    def make(episode_length: int = 1000) -> Env:
        assert versions  # what is bound to a function is part of what ``sources.digest`` says of it
        return from_brax(name, bins=bins, episode_length=episode_length, backend=backend)

    make.__name__ = make.__qualname__ = f"brax.{name}"
    make(1)
    return make
