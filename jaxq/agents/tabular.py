"""Learners with a table of action values: one factory, whose parts are chosen.

``target`` says what a transition bootstraps from, ``double`` which of two tables says so, ``n_steps``, ``traces`` and
``offline`` how far back a transition reaches and when (``backups``), ``planning_steps`` how often a learned model is
asked (``model``), and ``step_size`` what the step sizes follow. Q-learning is none of them.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jax.typing import DTypeLike

from jaxq import policies, rules, schedules
from jaxq.agents import backups, model
from jaxq.agents.backups import Table, Visit
from jaxq.rules import tables
from jaxq.rules.indexing import once
from jaxq.table_parts import unfit
from jaxq.types import Agent, Array, Clock, Key, Metrics, PyTree, Transition

#: A small table is a multiple of so many cells, the widest vector of float32, so that no pass over it has a remainder.
WHOLE_CELLS = 16


class TabularHypers(NamedTuple):
    """The numbers of a tabular learner, all [], all may be traced.

    Epsilon falls by episode on the tutorial's log10 schedule, and so does the step size, unless it follows visits:
    alpha = max(alpha_min, alpha_max / visits^visit_power). ``trace_decay`` is lambda.
    """

    alpha_min: Array
    alpha_max: Array
    epsilon_min: Array
    epsilon_max: Array
    decay_coeff: Array
    gamma: Array
    initial_value: Array
    trace_decay: Array
    visit_power: Array


class TabularState(NamedTuple):
    """The table of action values, [S', A]: a row per state and, in a small table, unused rows after them.

    A double learner has two such tables, one after the other. ``counts`` [S', A] are the updates of each cell, where
    step sizes follow them, and ``step_sizes`` [S', A] these, where traces move all cells by them. ``trajectories`` is
    what is remembered of each environment's episode [N]: the transition that waits for its next action, and the
    backup's memory.
    """

    table: Array
    counts: Array | None = None
    step_sizes: Array | None = None
    trajectories: PyTree = ()
    model: model.Model | None = None


class Waiting(NamedTuple):
    """SARSA's last transition of an episode under way, which waits for the action that is taken next."""

    transition: Transition
    present: Array


def tabular(
    hypers: TabularHypers,
    *,
    num_states: int,
    num_actions: int,
    target: str = "greedy",
    double: bool = False,
    n_steps: int = 1,
    traces: str = "none",
    offline: bool = False,
    planning_steps: int = 0,
    model_outcomes: int = 1,
    step_size: str = "episodes",
    bootstrap_terminal: bool = False,
    num_envs: int = 1,
    dtype: DTypeLike = jnp.float32,
) -> Agent:
    """A learner with a table: q[s, a] += alpha (r + gamma c v - q[s, a]), c = 0 after a termination.

    ``target``: v is "greedy" max_b q[s', b] (Q-learning; Watkins and Dayan, 1992), "sarsa" q[s', a'] with the action a'
    that is taken next, or at a cut drawn as if it were, "expected" sum_b pi(b) q[s', b] of the epsilon-greedy policy.
    ``double``: of two tables each update draws one, whose v the other gives; actions follow their mean (Van Hasselt,
    2010). ``n_steps``, ``traces`` and ``offline``: see ``backups``. ``planning_steps``: after each transition so many
    updates from a model that keeps the last ``model_outcomes`` of each state and action (Dyna-Q). ``step_size``: by
    "episodes" or by "visits" of a cell. With ``bootstrap_terminal`` c is always 1, as in the tutorial's update, which
    bootstraps through death: kept to reproduce it.

    Experience [T, N] is applied in the order of time, then environment. ``Metrics.loss`` is the mean of half the
    squared TD error, ``Metrics.max_q`` the largest value of the last successor before its update, the tutorial's
    ``best_q``.
    Raises ValueError for a count below 1, an unknown name, and parts that do not go together.
    """
    for name, count in {"num_states": num_states, "num_actions": num_actions, "num_envs": num_envs}.items():
        if count < 1:
            raise ValueError(f"{name}: {count} must be at least 1")
    if wrong := unfit(
        target=target,
        double=double,
        n_steps=n_steps,
        traces=traces,
        offline=offline,
        planning_steps=planning_steps,
        model_outcomes=model_outcomes,
        step_size=step_size,
    ):
        raise ValueError(wrong)
    sarsa, by_visits = target == "sarsa", step_size == "visits"
    rows = _rows(num_states, num_actions)
    if traces != "none":
        watkins = target == "greedy"
        backup = backups.traced(traces, hypers.trace_decay, hypers.gamma, watkins=watkins, offline=offline)
    else:
        backup = backups.one_step() if n_steps == 1 else backups.n_step(n_steps, double=double)
    draws = sarsa or double or planning_steps > 0

    def alpha(clock: Clock) -> backups.StepSize:
        if not by_visits:
            decayed = schedules.log10_decay(clock.episodes, hypers.alpha_min, hypers.alpha_max, hypers.decay_coeff)
            return lambda visits: clock.live * decayed
        return lambda visits: jnp.maximum(
            hypers.alpha_min, hypers.alpha_max / jnp.maximum(visits, 1).astype(dtype) ** hypers.visit_power
        )

    def exploration(clock: Clock) -> Array:
        return schedules.log10_decay(clock.episodes, hypers.epsilon_min, hypers.epsilon_max, hypers.decay_coeff)

    def init(key: Key, example: Transition) -> TabularState:
        del key
        table = jnp.full((2 * rows if double else rows, num_actions), hypers.initial_value, dtype)
        one: PyTree = backup.init(table)
        if sarsa:
            blank = jax.tree.map(lambda x: jnp.zeros(jnp.shape(x), jnp.result_type(x)), example)
            one = (Waiting(blank, jnp.zeros((), bool)), one)
        return TabularState(
            table=table,
            counts=jnp.zeros(table.shape, jnp.int32) if by_visits else None,
            step_sizes=jnp.zeros(table.shape, dtype) if by_visits and traces not in ("none", "dutch") else None,
            trajectories=jax.tree.map(lambda x: jnp.broadcast_to(x, (num_envs, *x.shape)), one),
            model=model.empty(num_states, num_actions, model_outcomes) if planning_steps else None,
        )

    def behaviour(values: Array, obs: Array) -> Array:
        """The row of action values that actions follow."""
        return (values[obs] + values[rows + obs]) / 2 if double else values[obs]

    def act(key: Key, state: TabularState, obs: Array, clock: Clock) -> Array:
        return policies.epsilon_greedy(key, behaviour(state.table, obs), exploration(clock))

    def learn(
        table: Table,
        memory: PyTree,
        how: backups.Backup,
        one: Transition,
        a_t: Array | None,
        weight: Array | None,
        coin: Array | None,
        clock: Clock,
    ) -> tuple[Table, PyTree, Metrics]:
        """One transition, whose next action is ``a_t``; ``coin`` says which of two tables."""
        if by_visits:  # what a cell was visited for stands still with the lane, and so do its step sizes
            weight = clock.live.astype(dtype) * (1 if weight is None else weight)
        values, row, own, other = table.values, one.obs_tm1, one.obs_t, None
        if coin is not None:
            row, own, other = one.obs_tm1 + coin * rows, one.obs_t + coin * rows, one.obs_t + (1 - coin) * rows

        def value(selector: Array, by: Array) -> Array:
            if a_t is not None:
                return once(by, a_t, num_actions)  # as rules.action_value, a tenth quicker with traces
            if target == "expected":
                probs = policies.epsilon_greedy_probs(behaviour(values, one.obs_t), exploration(clock))
                return rules.expected_value(by, probs)
            return rules.double_value(by, selector) if double else rules.greedy_value(by)

        q_t = values[own]
        q_other_t = q_t if other is None else values[other]
        v_t = value(q_t, q_other_t)
        visit = Visit(
            row=row,
            a_tm1=one.a_tm1,
            r_t=one.r_t,
            discount_t=hypers.gamma * (1.0 if bootstrap_terminal else one.continues_t),
            v_t=v_t,
            cut_t=one.cut_t,
            greedy_tm1=rules.action_value(values[row], one.a_tm1) == jnp.max(values[row]),
            weight=weight,
            coin=coin,
            v_other_t=value(q_other_t, q_t) if double else None,
        )
        table, memory, loss = how.apply(table, memory, visit, alpha(clock))
        return table, memory, Metrics(loss, jnp.max(q_t))

    def flip(key: Key | None) -> Array | None:
        return None if key is None or not double else (jax.random.bits(key, (), jnp.uint32) & 1).astype(jnp.int32)

    def draw(key: Key, table: Table, obs: Array, clock: Clock) -> Array:
        return policies.epsilon_greedy(key, behaviour(table.values, obs), exploration(clock))

    def real(
        key: Key | None, table: Table, memory: PyTree, one: Transition, clock: Clock
    ) -> tuple[Table, PyTree, Metrics]:
        """A transition that took place."""
        if not sarsa:
            return learn(table, memory, backup, one, None, None, flip(key), clock)
        assert key is not None
        first, last, end = jax.random.split(key, 3)
        waiting, memory = memory
        present = waiting.present.astype(dtype)
        table, memory, before = learn(table, memory, backup, waiting.transition, one.a_tm1, present, flip(first), clock)
        ends = one.cut_t.astype(dtype)
        a_t = draw(end, table, one.obs_t, clock)
        table, memory, after = learn(table, memory, backup, one, a_t, ends, flip(last), clock)
        done = jnp.maximum(present + ends, 1)
        return table, (Waiting(one, ~one.cut_t), memory), Metrics((before.loss + after.loss) / done, after.max_q)

    def plan(key: Key, table: Table, known: model.Model, clock: Clock) -> Table:
        """Updates from transitions that the model makes."""
        how = backups.one_step()

        def body(table: Table, index: Array) -> tuple[Table, None]:
            which, at, coin = jax.random.split(jax.random.fold_in(key, index), 3)
            made = model.imagine(which, known, num_actions)
            one = Transition(made.s_tm1, made.a_tm1, made.r_t, made.continues_t, made.s_t, jnp.ones((), bool))
            a_t = draw(at, table, made.s_t, clock) if sarsa else None
            return learn(table, (), how, one, a_t, None, flip(coin), clock)[0], None

        return jax.lax.scan(body, table, jnp.arange(planning_steps, dtype=jnp.int32))[0]

    def update(key: Key, state: TabularState, experience: Transition, clock: Clock) -> tuple[TabularState, Metrics]:
        rollout, envs = experience.r_t.shape
        if jax.tree.leaves(state.trajectories) and envs != num_envs:
            raise ValueError(f"experience: {envs} environments, where num_envs is {num_envs}")

        def of_one(
            shared: tuple[Table, model.Model | None], given: tuple[PyTree, Transition, Array]
        ) -> tuple[Any, tuple[PyTree, Metrics]]:
            (table, known), (memory, one, index) = shared, given
            own = jax.random.fold_in(key, index) if draws else None
            learning, planning = jax.random.split(own) if own is not None and planning_steps else (own, None)
            table, memory, metrics = real(learning, table, memory, one, clock)
            if known is not None and planning is not None:
                cell = one.obs_tm1 * num_actions + one.a_tm1
                continues = jnp.ones_like(one.continues_t) if bootstrap_terminal else one.continues_t
                known = model.record(known, cell, one.r_t, continues, one.obs_t)
                table = plan(planning, table, known, clock)
            return (table, known), (memory, metrics)

        def at_once(carry: Any, given: tuple[Transition, Array]) -> tuple[Any, Metrics]:
            (shared, trajectories), (together, time) = carry, given
            index = time * envs + jnp.arange(envs, dtype=jnp.int32)
            shared, (trajectories, metrics) = jax.lax.scan(
                of_one, shared, (trajectories, together, index), unroll=envs == 1
            )
            return (shared, trajectories), metrics

        start = (Table(state.table, state.counts, state.step_sizes), state.model), state.trajectories
        ((table, known), trajectories), measured = jax.lax.scan(
            at_once, start, (experience, jnp.arange(rollout, dtype=jnp.int32)), unroll=rollout == 1
        )
        after = TabularState(*table, trajectories, known)
        return after, Metrics(jnp.mean(measured.loss), measured.max_q[-1, -1])

    def observe(state: TabularState, experience: Transition) -> TabularState:
        del experience
        return state

    def policy(state: TabularState) -> Array:
        values = state.table
        return (values[:num_states] + values[rows : rows + num_states]) / 2 if double else values[:num_states]

    def q_values(policy: Array, obs: Array) -> Array:
        return policy[obs]

    return Agent(init, act, exploration, update, observe, policy, q_values)


def _rows(num_states: int, num_actions: int) -> int:
    """Rows of a table, with those that make a small one whole."""
    whole = WHOLE_CELLS // math.gcd(WHOLE_CELLS, num_actions)
    rows = -(-num_states // whole) * whole
    return rows if rows * num_actions <= tables.DENSE_CELLS else num_states
