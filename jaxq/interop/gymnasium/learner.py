"""A learner that acts and learns in compiled steps, while somebody else steps the environments."""

from __future__ import annotations

from collections.abc import Callable, Hashable
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from jaxq import estimate, prng, rounds
from jaxq.interop.gymnasium.transitions import Row
from jaxq.presets import Training
from jaxq.programs import hypers, pieces, success_rule
from jaxq.rounds import streams_of
from jaxq.types import Array, Clock, Hypers, Metrics, PyTree, Transition


class State(NamedTuple):
    """A training between two rounds, but for its learner."""

    key_words: Array
    round: Array
    success: PyTree
    clock: Clock
    status: Array


class Functions(NamedTuple):
    """What is compiled once for all settings of a structure."""

    init: Callable[..., tuple[PyTree, State]]
    act: Callable[..., Array]
    store: Callable[..., tuple[PyTree, State]]
    learn: Callable[..., tuple[PyTree, State, Metrics]]
    policy: Callable[..., PyTree]


class Learner:
    """A training as ``experiment`` makes it, with the same keys, clock and ends, and the environments left out.

    ``act`` gives the actions of the round's next step, ``add`` takes what came of it. Raises MemoryError where it would
    not fit.
    """

    def __init__(self, settings: Training, obs: np.ndarray, seed: int, impl: str):
        self.num_envs = len(obs)
        self.steps = getattr(settings, "steps_per_update", 1)
        first = getattr(settings, "learning_starts", 0)
        self.warm_up = rounds.warm_up_rounds(first, self.num_envs, self.steps)
        self.numbers = jax.device_put(hypers(settings))  # once, not in every call
        self.functions = _functions(settings, self.num_envs, self.steps, impl)
        words = jax.random.key_data(jax.random.fold_in(prng.key(seed, impl), 0))
        estimate.check_size(jax.eval_shape(self.functions.init, words, obs[0], self.numbers), "the training")
        self.agent, self.state = self.functions.init(words, obs[0], self.numbers)
        self.rows: list[Row] = []
        self.skipped = 0
        self.status = rounds.RUNNING
        self.loss: list[float] = []
        self.max_q: list[float] = []

    @property
    def next_update(self) -> int:
        """The number of the update that this round ends in, from 1; 0 in the warm-up."""
        return 0 if self.warm_up else len(self.loss) + 1

    def act(self, obs: np.ndarray) -> np.ndarray:
        """The actions of the next step. Shapes: obs [N, ...] -> [N]."""
        ended = sum(int(row.cut_t.sum()) for row in self.rows)
        place = np.array([len(self.rows), ended, self.skipped], np.int32)
        return np.asarray(self.functions.act(self.agent, self.state, self.numbers, obs, place, warm=self.warm_up > 0))

    def skip(self) -> None:
        """The last actions led to no row: the next ones are of the same step, with keys of their own."""
        self.skipped += 1

    def add(self, row: Row) -> bool:
        """Takes the row that the last actions led to; True where it ended a round."""
        self.rows.append(row)
        if len(self.rows) < (1 if self.warm_up else self.steps):
            return False
        rows = Row(*(np.stack(leaves) for leaves in zip(*self.rows, strict=True)))
        self.rows = []
        if self.warm_up:
            self.warm_up -= 1
            self.agent, self.state = self.functions.store(self.agent, self.state, self.numbers, rows)
        else:
            self.agent, self.state, metrics = self.functions.learn(self.agent, self.state, self.numbers, rows)
            for kept, value in ((self.loss, metrics.loss), (self.max_q, metrics.max_q)):
                kept.append(np.asarray(value).item())
        self.status = np.asarray(self.state.status).item()
        return True

    def policy(self) -> PyTree:
        """What acting greedily needs."""
        return jax.tree.map(np.asarray, self.functions.policy(self.agent, self.numbers))


_compiled: dict[Hashable, Functions] = {}


def _functions(settings: Training, num_envs: int, steps: int, impl: str) -> Functions:
    shape = tuple(named for named in settings.structural() if named[0] != "eval_episodes")  # evaluated elsewhere
    key = (shape, num_envs, impl)
    if key not in _compiled:
        _compiled[key] = _made(settings, num_envs, steps, impl)
    return _compiled[key]


def _made(settings: Training, num_envs: int, steps: int, impl: str) -> Functions:
    make_env, make_agent = pieces(settings)
    success = success_rule(settings)

    def init(words: Array, obs: Any, hypers: Hypers) -> tuple[PyTree, State]:
        env = make_env(hypers.env)
        agent = make_agent(hypers.agent, env)
        learner = agent.init(streams_of(words, impl).agent, rounds.example(env.observe(obs)))
        zero = jnp.zeros((), jnp.int32)
        return learner, State(words, zero, success.init(), rounds.new_clock(), zero)

    def act(learner: PyTree, state: State, hypers: Hypers, obs: Any, place: Array, warm: bool) -> Array:
        t, episodes, skipped = place
        env = make_env(hypers.env)
        agent = make_agent(hypers.agent, env)
        key = streams_of(state.key_words, impl).act
        index = rounds.places(state.round, t, 1 if warm else steps, num_envs) + skipped * num_envs
        now = state.clock
        clock = now._replace(env_steps=now.env_steps + t * num_envs, episodes=now.episodes + episodes)
        return jax.vmap(lambda i, one: agent.act(jax.random.fold_in(key, i), learner, env.observe(one), clock))(
            index, obs
        )

    def taken(state: State, hypers: Hypers, rows: Row) -> tuple[State, Array, Transition]:
        observe = jax.vmap(jax.vmap(make_env(hypers.env).observe))
        seen: dict[str, Any] = {name: getattr(rows, name) for name in Transition._fields}
        experience = Transition(**{**seen, "obs_tm1": observe(rows.obs_tm1), "obs_t": observe(rows.obs_t)})
        episodes: Any = rows.cut_t, rows.length, rows.total

        def body(carry: tuple[PyTree, Clock], row: tuple[Array, Array, Array]) -> tuple[tuple[PyTree, Clock], Array]:
            held, met = rounds.judged(success, carry[0], *row, hypers.run)
            return (held, rounds.ticked(carry[1], row[0])), met

        (held, clock), met = jax.lax.scan(body, (state.success, state.clock), episodes)
        return state._replace(round=state.round + 1, success=held, clock=clock), jnp.any(met), experience

    def judged(state: State, solved: Array, diverged: Array, hypers: Hypers) -> State:
        clock, status = rounds.verdict(state.clock, state.status, solved, diverged, hypers.run)
        return state._replace(clock=clock, status=status)

    def store(learner: PyTree, state: State, hypers: Hypers, rows: Row) -> tuple[PyTree, State]:
        agent = make_agent(hypers.agent, make_env(hypers.env))
        state, solved, experience = taken(state, hypers, rows)
        return agent.observe(learner, experience), judged(state, solved, jnp.zeros((), bool), hypers)

    def learn(learner: PyTree, state: State, hypers: Hypers, rows: Row) -> tuple[PyTree, State, Metrics]:
        agent = make_agent(hypers.agent, make_env(hypers.env))
        before = state.clock
        state, solved, experience = taken(state, hypers, rows)
        key = jax.random.fold_in(streams_of(state.key_words, impl).update, state.round)
        learner, metrics = agent.update(key, learner, experience, before)
        state = state._replace(clock=state.clock._replace(updates=before.updates + 1))
        diverged = ~jnp.isfinite(metrics.loss + metrics.max_q)
        return learner, judged(state, solved, diverged, hypers), metrics

    def policy(learner: PyTree, hypers: Hypers) -> PyTree:
        return make_agent(hypers.agent, make_env(hypers.env)).policy(learner)

    return Functions(
        init=jax.jit(init),
        act=jax.jit(act, static_argnames="warm"),
        store=jax.jit(store, donate_argnums=0),
        learn=jax.jit(learn, donate_argnums=0),
        policy=jax.jit(policy),
    )
