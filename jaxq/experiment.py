"""An environment and an agent meet: one training, as two pure functions that the engine vmaps over lanes.

``advance`` runs a fixed number of *rounds* (see ``rounds``), a *segment*, and logs every step, so the same compiled
program serves a sweep that looks at totals and a train command that shows each episode. The state holds the words of
the lane's key, never a typed key.
"""

from __future__ import annotations

import functools
from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp

from jaxq.envs.auto_reset import auto_reset
from jaxq.evaluation import greedy_returns, lasting, parted
from jaxq.rounds import (
    Limits,
    Streams,
    example,
    judged,
    new_clock,
    places,
    streams_of,
    ticked,
    verdict,
    warm_up_rounds,
)
from jaxq.success import Success
from jaxq.types import Agent, Array, Clock, Env, Experiment, Hypers, Key, Step, Transition

#: A segment is a loop over loops of at most this many rounds. XLA compiles a loop of few bytes into one function (see
#: ``cpu``), and the rows logged in it count.
INNER_ROUNDS = 100


class LaneState(NamedTuple):
    """Everything one training is, between two segments."""

    key_words: Array  # the words of the lane's key
    round: Array  # rounds done, warm-up included; it goes on where the clock stops
    env: Any  # [N, ...]
    obs: Any  # [N, ...] what the agent acts on next; held, so that it is made once and read as often as needed
    length: Array  # [N] steps of the episode under way
    total: Array  # [N] its return
    agent: Any
    success: Any
    clock: Clock
    status: Array


class Log(NamedTuple):
    """What happened in U rounds, step by step. Rows past the lane's end are to be ignored: its clock stopped there."""

    over: Array  # [U, T, N] bool, an episode ended at this step
    total: Array  # [U, T, N] the return of the episode up to this step
    max_q: Array  # [U]; NaN where there was no update (warm-up)
    loss: Array  # [U]
    epsilon: Array  # [], the exploration rate after the last round


def experiment(
    make_env: Callable[[Any], Env],
    make_agent: Callable[[Any, Env], Agent],
    *,
    success: Success,
    rounds: int,
    num_envs: int = 1,
    steps_per_round: int = 1,
    warm_up_steps: int = 0,
    eval_episodes: int = 10,
    eval_steps: int = 10**6,
    impl: str = "threefry",
) -> Experiment:
    """A training of what ``make_agent(hypers.agent, env)`` learns on ``make_env(hypers.env)``.

    One segment is ``rounds`` rounds of ``steps_per_round`` steps of ``num_envs`` environments and one update. Before
    the first round the agent acts, without learning, until ``warm_up_steps`` transitions less one round are stored, so
    that the first update sees at least ``warm_up_steps``. ``hypers.run`` is a Limits; ``impl`` is the family of the
    keys. Evaluation plays ``eval_episodes`` whole episodes, cut at ``eval_steps`` where an environment does not end
    them itself; what outlives an episode goes on from the training of the first environment. ``advance`` cannot be
    differentiated, and under ``vmap`` what the factories close over must not be batched: numbers that differ between
    lanes come by ``hypers``. Raises ValueError for a count below 1 (``warm_up_steps`` below 0).
    """
    counts = {"rounds": rounds, "num_envs": num_envs, "steps_per_round": steps_per_round}
    counts |= {"eval_episodes": eval_episodes, "eval_steps": eval_steps, "warm_up_steps": warm_up_steps + 1}
    for name, count in counts.items():
        if count < 1:
            raise ValueError(f"{name}: {count} is too small")
    warm_up = warm_up_rounds(warm_up_steps, num_envs, steps_per_round)

    def make(hypers: Hypers) -> tuple[Env, Agent]:
        env = make_env(hypers.env)
        return auto_reset(env), make_agent(hypers.agent, env)

    def init(key: Key, hypers: Hypers) -> tuple[LaneState, Log]:
        env, agent = make(hypers)
        words, zero = jax.random.key_data(key), jnp.zeros((), jnp.int32)
        streams = streams_of(words, impl)
        env_state = jax.vmap(env.reset)(jax.random.split(streams.reset, num_envs))
        obs = jax.vmap(env.observe)(env_state)
        state = LaneState(
            key_words=words,
            round=zero,
            env=env_state,
            obs=obs,
            length=jnp.zeros((num_envs,), jnp.int32),
            total=jnp.zeros((num_envs,), jnp.float32),
            agent=agent.init(streams.agent, example(env.observe(jax.tree.map(lambda leaf: leaf[0], env_state)))),
            success=success.init(),
            clock=new_clock(),
            status=zero,
        )
        if warm_up == 0:
            empty = jnp.zeros((0, 1, num_envs))
            none = jnp.zeros((0,))
            return state, Log(empty.astype(bool), empty, none, none, agent.exploration(state.clock))

        def body(state: LaneState, _: None) -> tuple[LaneState, tuple[Array, ...]]:
            state, experience, solved, (over, total) = _rollout(env, agent, success, streams, state, hypers.run, 1)
            state = state._replace(agent=agent.observe(state.agent, experience))
            nan = jnp.full((), jnp.nan)
            return _judge(state, solved, jnp.zeros((), bool), hypers.run), (over, total, nan, nan)

        state, (over, total, max_q, loss) = jax.lax.scan(body, state, length=warm_up)
        return state, Log(over, total, max_q, loss, agent.exploration(state.clock))

    def one_round(state: LaneState, hypers: Hypers) -> tuple[LaneState, dict[str, Array]]:
        env, agent = make(hypers)
        streams = streams_of(state.key_words, impl)
        before = state.clock
        state, experience, solved, (over, total) = _rollout(
            env, agent, success, streams, state, hypers.run, steps_per_round
        )
        key = jax.random.fold_in(streams.update, state.round)
        learner, metrics = agent.update(key, state.agent, experience, before)
        done = (before.live > 0).astype(jnp.int32)
        state = state._replace(agent=learner, clock=state.clock._replace(updates=before.updates + done))
        diverged = ~jnp.isfinite(metrics.loss + metrics.max_q)
        state = _judge(state, solved, diverged, hypers.run)
        measured = {name: value.astype(jnp.float32) for name, value in metrics._asdict().items()}
        return state, {"over": over, "total": total, **measured}

    def loop(
        body: Callable[[LaneState], tuple[LaneState, dict[str, Array]]], state: LaneState
    ) -> tuple[LaneState, dict[str, Array]]:
        """A segment of rounds; what they log by name, on a leading axis."""
        inner = max(n for n in range(1, INNER_ROUNDS + 1) if rounds % n == 0)
        state, rows = jax.lax.scan(
            lambda outer, _: jax.lax.scan(lambda held, _: body(held), outer, length=inner),
            state,
            length=rounds // inner,
        )
        return state, jax.tree.map(lambda leaf: leaf.reshape(rounds, *leaf.shape[2:]), rows)

    def exploration(clock: Clock, hypers: Hypers) -> Array:
        return make(hypers)[1].exploration(clock)

    @jax.custom_batching.custom_vmap
    def advance(state: LaneState, hypers: Hypers) -> tuple[LaneState, Log]:
        state, rows = loop(lambda held: one_round(held, hypers), state)
        return state, Log(**rows, epsilon=exploration(state.clock, hypers))

    @advance.def_vmap
    def _(lanes: int, batched: Any, state: LaneState, hypers: Hypers) -> Any:
        # A loop over a round of all lanes, where a plain vmap would batch the loop: the mathematics is the same, but
        # XLA makes code of it that is a third faster.
        axes = jax.tree.map(lambda is_batched: 0 if is_batched else None, tuple(batched))
        held_axes = jax.tree.map(lambda _: 0, state)
        state = jax.tree.map(
            lambda leaf, is_batched: leaf if is_batched else jnp.broadcast_to(leaf, (lanes, *leaf.shape)),
            state,
            batched[0],
        )
        each = jax.vmap(one_round, in_axes=(held_axes, axes[1]))
        state, rows = loop(lambda held: each(held, hypers), state)
        rates = jax.vmap(exploration, in_axes=(0, axes[1]))(state.clock, hypers)
        log = Log(**{name: jnp.moveaxis(leaf, 1, 0) for name, leaf in rows.items()}, epsilon=rates)
        return (state, log), jax.tree.map(lambda _: True, (state, log))

    def evaluate(key: Key, policy: Any, hypers: Hypers) -> Array:
        env = make_env(hypers.env)
        agent = make_agent(hypers.agent, env)
        streams = streams_of(jax.random.key_data(key), impl)
        learnt, before = parted(policy)
        play = functools.partial(agent.q_values, learnt)
        return greedy_returns(streams.evaluate, env, play, eval_episodes, eval_steps, before)

    def policy(state: LaneState, hypers: Hypers) -> Any:
        env, agent = make(hypers)
        return lasting(env, agent.policy(state.agent), jax.tree.map(lambda leaf: leaf[0], state.env))

    return Experiment(init, advance, evaluate, policy)


def _rollout(
    env: Env, agent: Agent, success: Success, streams: Streams, state: LaneState, limits: Limits, steps: int
) -> tuple[LaneState, Transition, Array, tuple[Array, Array]]:
    """``steps`` steps of all environments. Experience has axes [steps, N]."""
    num_envs = state.length.shape[0]

    def one_env(
        index: Array, env_state: Any, obs: Any, learner: Any, clock: Clock
    ) -> tuple[tuple[Any, Any], Transition, Step]:
        act_key, env_key = jax.random.fold_in(streams.act, index), jax.random.fold_in(streams.step, index)
        action = agent.act(act_key, learner, obs, clock)
        env_state, happened = env.step(env_key, env_state, action)
        continues = 1.0 - happened.terminated.astype(jnp.float32)
        cut = happened.terminated | happened.truncated
        after = env_state, env.observe(env_state)
        return after, Transition(obs, action, happened.reward, continues, happened.obs, cut), happened

    def body(carry: tuple[LaneState, Array], t: Array) -> tuple[tuple[LaneState, Array], Any]:
        state, solved = carry
        index = places(state.round, t, steps, num_envs)
        (env_state, obs), experience, happened = jax.vmap(one_env, in_axes=(0, 0, 0, None, None))(
            index, state.env, state.obs, state.agent, state.clock
        )
        if env.restart is not None:  # what outlives an episode stays where the lane ended
            ended = state.clock.live == 0
            env_state, obs = jax.tree.map(
                lambda old, new: jnp.where(ended, old, new), (state.env, state.obs), (env_state, obs)
            )
        over = experience.cut_t
        length, total = state.length + 1, state.total + happened.reward.astype(jnp.float32)
        success_state, met = judged(success, state.success, over, length, total, limits)
        state = state._replace(
            env=env_state,
            obs=obs,
            length=jnp.where(over, 0, length),
            total=jnp.where(over, 0.0, total),
            success=success_state,
            clock=ticked(state.clock, over),
        )
        return (state, solved | met), (experience, over, total)

    start = (state, jnp.zeros((), bool))
    (state, solved), (experience, over, total) = jax.lax.scan(
        body, start, jnp.arange(steps, dtype=jnp.int32), unroll=steps == 1
    )
    return state._replace(round=state.round + 1), experience, solved, (over, total)


def _judge(state: LaneState, solved: Array, diverged: Array, limits: Limits) -> LaneState:
    """Ends a live lane that diverged, succeeded or reached a limit."""
    clock, status = verdict(state.clock, state.status, solved, diverged, limits)
    return state._replace(status=status, clock=clock)
