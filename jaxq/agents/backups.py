"""How one transition changes a table: at once, after n steps, or through eligibility traces.

A ``Backup`` is a pair of pure functions. Its memory belongs to one trajectory (one environment of a lane): the window
of the last n visits, or the traces; it never reaches over a cut.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp

from jaxq import rules
from jaxq.types import Array, PyTree


class Table(NamedTuple):
    """Action values ``values`` [S, A], and how often each was updated, ``counts`` [S, A] int32, where that matters.

    ``step_sizes`` [S, A] are those of the counts, where a step moves all cells, each by its own: to work them out anew
    each time is a power per cell.
    """

    values: Array
    counts: Array | None
    step_sizes: Array | None = None


class Visit(NamedTuple):
    """One transition with what it bootstraps from, all []: the row of its state, its action, and the value v_t.

    ``greedy_tm1`` says that the action was greedy. ``weight`` is 1 for a transition that took place and 0 for none;
    None where there always is one. Of two tables ``coin`` says which one is updated, and ``v_other_t`` is the value
    that the other one would bootstrap from.
    """

    row: Array
    a_tm1: Array
    r_t: Array
    discount_t: Array
    v_t: Array
    cut_t: Array
    greedy_tm1: Array
    weight: Array | None
    coin: Array | None = None
    v_other_t: Array | None = None


#: Step size by how often a cell was updated, this time included: scalar to scalar, table to table; None where that is
#: not counted.
StepSize = Callable[[Any], Array]


@dataclass(frozen=True)
class Backup:
    """``init(values) -> memory`` of one trajectory, and ``apply(table, memory, visit, step_size)``.

    ``apply`` returns (table, memory, loss); the loss is half the squared TD error, of several updates their mean, of
    none 0.
    """

    init: Callable[[Array], PyTree]
    apply: Callable[[Table, PyTree, Visit, StepSize], tuple[Table, PyTree, Array]]


def one_step() -> Backup:
    """q[s, a] += alpha delta, at once. Sutton and Barto, 2018, equation 6.2."""

    def apply(table: Table, memory: PyTree, visit: Visit, step_size: StepSize) -> tuple[Table, PyTree, Array]:
        target_tm1 = rules.td_target(visit.r_t, visit.discount_t, visit.v_t)
        table, delta = _move(table, visit.row, visit.a_tm1, target_tm1, visit.weight, step_size)
        return table, memory, 0.5 * jnp.square(delta)

    return Backup(lambda values: (), apply)


class Window(NamedTuple):
    """The last n visits, oldest first [n]: their cells, the rewards since with the discounts, and which are there.

    Of two tables ``coin`` is which one each visit updates: what it bootstraps from n steps later is of that one.
    """

    row: Array
    action: Array
    rewards: Array
    discount: Array
    present: Array
    coin: Array | None


def n_step(n: int, *, double: bool = False) -> Backup:
    """q[s, a] += alpha (G - q[s, a]), G = r_1 + d_1 r_2 + ... + d_1 ... d_n v, n steps after the visit.

    At a cut every visit of the window is updated, oldest first, with the return of the steps it had. Sutton and Barto,
    2018, section 7.2.
    """

    def init(values: Array) -> Window:
        none, zero = jnp.zeros(n, jnp.int32), jnp.zeros(n, values.dtype)
        return Window(none, none, zero, zero, jnp.zeros(n, bool), none if double else None)

    def apply(table: Table, window: Window, visit: Visit, step_size: StepSize) -> tuple[Table, Window, Array]:
        dtype = table.values.dtype
        entered = Window(
            row=window.row.at[-1].set(visit.row),
            action=window.action.at[-1].set(visit.a_tm1),
            rewards=window.rewards.at[-1].set(0),
            discount=window.discount.at[-1].set(1),
            present=window.present.at[-1].set(True),
            coin=None if window.coin is None else window.coin.at[-1].set(visit.coin),
        )
        rewards = (entered.rewards + entered.discount * visit.r_t).astype(dtype)
        discount = (entered.discount * visit.discount_t).astype(dtype)
        due = entered.present & (visit.cut_t | (jnp.arange(n) == 0))
        if visit.weight is not None:
            due = due & (visit.weight > 0)
        v_t = visit.v_t.astype(dtype)
        if entered.coin is not None and visit.v_other_t is not None:
            v_t = jnp.where(entered.coin == visit.coin, v_t, visit.v_other_t.astype(dtype))
        targets = rewards + discount * v_t

        def update(table: Table, one: tuple[Array, ...]) -> tuple[Table, Array]:
            row, action, target, is_due = one
            return _move(table, row, action, target, is_due.astype(dtype), step_size)

        table, deltas = jax.lax.scan(update, table, (entered.row, entered.action, targets, due))
        loss = jnp.sum(0.5 * jnp.square(deltas)) / jnp.maximum(jnp.sum(due.astype(dtype)), 1)
        after = Window(entered.row, entered.action, rewards, discount, entered.present & ~due, entered.coin)
        after = jax.tree.map(lambda leaf: jnp.roll(leaf, -1), after)
        if visit.weight is not None:
            took_place = visit.weight > 0
            after = jax.tree.map(lambda new, old: jnp.where(took_place, new, old), after, window)
        return table, after, loss

    return Backup(init, apply)


class Traces(NamedTuple):
    """Traces [S, A]; increments that wait for the cut [S, A], where they do; the last v_t [], where it is needed."""

    trace: Array
    increments: Array | None
    v_tm1: Array | None


def traced(kind: str, trace_decay: Array, gamma: Array, *, watkins: bool, offline: bool) -> Backup:
    """q += alpha delta e, e the traces of the visits before, which fade by gamma lambda a step and end at a cut.

    ``kind`` is "accumulating", "replacing", or "dutch" with the corrections of true online learning: q += alpha (delta
    + q[s, a] - v_old) e, then q[s, a] -= alpha (q[s, a] - v_old), both of the value before. With ``watkins`` an action
    that is not greedy, in the table as its transition finds it, ends the traces before it. ``offline`` gathers delta e
    and applies it at the cut: with lambda 1, accumulating traces and SARSA's values that is Monte Carlo of every visit;
    replacing traces are that of first visits where gamma is 1. Sutton and Barto, 2018, chapter 12; Singh and Sutton,
    1996; Van Seijen et al., *True Online Temporal-Difference Learning*, 2016.
    """
    dutch = kind == "dutch"

    def init(values: Array) -> Traces:
        zeros = jnp.zeros_like(values)
        return Traces(zeros, zeros if offline else None, jnp.zeros((), values.dtype) if dutch else None)

    def apply(table: Table, memory: Traces, visit: Visit, step_size: StepSize) -> tuple[Table, Traces, Array]:
        values, row, action = table.values, visit.row, visit.a_tm1
        dtype = values.dtype
        weight = jnp.ones((), dtype) if visit.weight is None else visit.weight.astype(dtype)
        decay = gamma * trace_decay * (visit.greedy_tm1 if watkins else 1)
        counts, alphas = None, None
        if table.counts is None:
            alpha = alpha_tm1 = step_size(None)
        else:
            counts = _counted(table.counts, row, action, weight)
            alpha = alpha_tm1 = step_size(counts[row, action])
            if table.step_sizes is not None:
                alpha = alphas = table.step_sizes.at[row, action].set(alpha_tm1.astype(dtype))
        if dutch and counts is not None:  # visits keep the step size that they were made with: it is in the trace
            faded = memory.trace * decay
            trace = rules.update_table(faded, row, action, alpha_tm1 * (1 - faded[row, action]))
            alpha = jnp.ones((), dtype)
        elif dutch:
            trace = rules.dutch_trace(memory.trace, row, action, decay, alpha)
        else:
            leave = rules.accumulating_trace if kind == "accumulating" else rules.replacing_trace
            trace = leave(memory.trace, row, action, decay)
        delta = rules.td_error(values[row], action, rules.td_target(visit.r_t, visit.discount_t, visit.v_t))
        delta = delta.astype(dtype) * weight
        stays = (1 - visit.cut_t.astype(dtype)) * weight
        increments, v_t = None, None
        if memory.increments is not None:
            gathered = memory.increments + delta * trace
            now = visit.cut_t.astype(dtype) * weight
            values = values + (alpha * now).astype(dtype) * gathered
            increments = gathered * (1 - now)
        elif memory.v_tm1 is not None:
            correction = (rules.action_value(values[row], action) - memory.v_tm1) * weight
            values = values + alpha.astype(dtype) * (delta + correction) * trace
            values = rules.update_table(values, row, action, -(alpha_tm1.astype(dtype) * correction))
            v_t = visit.v_t.astype(dtype) * stays + memory.v_tm1 * (1 - weight)
        else:
            values = values + alpha.astype(dtype) * delta * trace
        trace = trace * stays + memory.trace * (1 - weight)
        return Table(values, counts, alphas), Traces(trace, increments, v_t), 0.5 * jnp.square(delta)

    return Backup(init, apply)


def _move(
    table: Table, row: Array, action: Array, target: Array, weight: Array | None, step_size: StepSize
) -> tuple[Table, Array]:
    """One value a step towards its target; the TD error."""
    values, counts = table.values, table.counts
    delta = rules.td_error(values[row], action, target).astype(values.dtype)
    if weight is not None:
        delta = delta * weight
    if counts is None:
        moved = rules.update_table(values, row, action, step_size(None).astype(values.dtype) * delta)
        return table._replace(values=moved), delta
    counts = _counted(counts, row, action, jnp.ones((), jnp.int32) if weight is None else weight)
    alpha = step_size(counts[row, action]).astype(values.dtype)
    known = None if table.step_sizes is None else table.step_sizes.at[row, action].set(alpha)
    return Table(rules.update_table(values, row, action, alpha * delta), counts, known), delta


def _counted(counts: Array, row: Array, action: Array, weight: Array) -> Array:
    """The counts with one more of a cell."""
    return rules.update_table(counts, row, action, weight.astype(counts.dtype))
