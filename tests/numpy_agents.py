"""Textbook learners with a table as plain Python loops over NumPy in float64, and the agents on the same experience.

Everything here is written from the books, not from ``jaxq``: episodes are lists, traces are dictionaries, returns are
sums. ``run`` is the one place that knows in which order the experience of several environments is learnt.
"""

from __future__ import annotations

import functools
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from jaxq.agents.tabular import TabularHypers, tabular
from jaxq.types import Clock, Transition

STATES, ACTIONS, STEPS, ENVS = 4, 3, 48, 3
GAMMA, ALPHA, DECAY, EPSILON = 0.9, 0.3, 0.7, 0.25

#: Programs that run once are not worth optimising.
FAST_COMPILE = {"xla_backend_optimization_level": 0}


class Record(NamedTuple):
    """Experience [T, N]: in each environment episodes one after the other, the last one not at its end."""

    s: np.ndarray
    a: np.ndarray
    r: np.ndarray
    terminated: np.ndarray
    truncated: np.ndarray
    s_next: np.ndarray


class One(NamedTuple):
    """One transition of one environment; ``a_next`` is None where nothing was done in ``s_next``."""

    s: int
    a: int
    r: float
    discount: float
    s_next: int
    a_next: int | None
    cut: bool


def record(seed=0, steps=STEPS, envs=ENVS, *, states=STATES, actions=ACTIONS, ends=0.12, cut_at=None):
    """Random experience; at the time ``cut_at`` all environments are truncated."""
    rng = np.random.default_rng(seed)
    s, s_next = np.zeros((2, steps, envs), int)
    terminated, truncated = rng.random((2, steps, envs)) < ends
    if cut_at is not None:
        truncated[cut_at] = True
    state = rng.integers(states, size=envs)
    for t in range(steps):
        s[t], s_next[t] = state, rng.integers(states, size=envs)
        state = np.where(terminated[t] | truncated[t], rng.integers(states, size=envs), s_next[t])
    shape = (steps, envs)
    return Record(s, rng.integers(actions, size=shape), rng.normal(size=shape), terminated, truncated, s_next)


def in_order(it, *, sarsa, gamma=GAMMA, bootstrap_terminal=False):
    """(t, n, One) in the order of learning: SARSA waits for the next action, or for a cut."""
    cut = it.terminated | it.truncated

    def one(t, n, a_next):
        discount = gamma * (bootstrap_terminal or not it.terminated[t, n])
        return One(it.s[t, n], it.a[t, n], it.r[t, n], discount, it.s_next[t, n], a_next, bool(cut[t, n]))

    for t in range(len(it.r)):
        for n in range(it.r.shape[1]):
            if not sarsa:
                yield t, n, one(t, n, None)
                continue
            if t > 0 and not cut[t - 1, n]:
                yield t, n, one(t - 1, n, it.a[t, n])
            if cut[t, n]:
                yield t, n, one(t, n, None)


def episodes(it, **how):
    """The whole episodes of a record of one environment, as lists."""
    episode = []
    for _, _, one in in_order(it, **how):
        episode.append(one)
        if one.cut:
            yield episode
            episode = []


# What a transition bootstraps from


def greedy(q, one):
    return max(q[one.s_next])


def sarsa(q, one):
    """Epsilon is 0 wherever an action must be drawn here."""
    return q[one.s_next][np.argmax(q[one.s_next]) if one.a_next is None else one.a_next]


def expected(q, one, epsilon=EPSILON):
    return epsilon * np.mean(q[one.s_next]) + (1 - epsilon) * np.max(q[one.s_next])


VALUES = {"greedy": greedy, "sarsa": sarsa, "expected": expected}


# Learners of one trajectory: ``see`` takes a transition with its value and changes q


class Constant:
    def __init__(self, alpha=ALPHA):
        self.alpha = alpha

    def visit(self, cell):
        pass

    def __call__(self, cell):
        return self.alpha


class ByVisits:
    """max(alpha_min, alpha_max / N^omega)."""

    def __init__(self, least=0.1, most=0.8, power=0.7):
        self.least, self.most, self.power, self.counts = least, most, power, {}

    def visit(self, cell):
        self.counts[cell] = self.counts.get(cell, 0) + 1

    def __call__(self, cell):
        return max(self.least, self.most / self.counts[cell] ** self.power)


def returns(steps, v):
    """r_1 + d_1 (r_2 + d_2 (... + d_n v))."""
    for one in reversed(steps):
        v = one.r + one.discount * v
    return v


class NStep:
    """Sutton and Barto, section 7.2: at time t the visit tau = t - n + 1 is updated; n = 1 is their section 6.4."""

    def __init__(self, q, alpha, n=1):
        self.q, self.alpha, self.n, self.episode, self.errors = q, alpha, n, [], []

    def see(self, one, v):
        self.episode.append(one)
        self.errors = []
        last = len(self.episode) - 1
        tau = last - self.n + 1
        for k in range(max(tau, 0), last + 1) if one.cut else range(tau, tau + 1):
            if k >= 0:
                cell = self.episode[k].s, self.episode[k].a
                self.alpha.visit(cell)
                self.errors.append(returns(self.episode[k:], v) - self.q[cell])
                self.q[cell] += self.alpha(cell) * self.errors[-1]
        if one.cut:
            self.episode = []


class Lambda:
    """Sutton and Barto, first edition, figures 7.11 and 7.14; with replacing traces, section 7.8."""

    def __init__(self, q, alpha, kind, *, watkins, decay=DECAY, gamma=GAMMA, offline=False):
        self.q, self.alpha, self.kind, self.watkins = q, alpha, kind, watkins
        self.decay, self.offline, self.traces, self.waiting = gamma * decay, offline, {}, []

    def see(self, one, v):
        cell = one.s, one.a
        self.alpha.visit(cell)
        if self.watkins and self.q[cell] < max(self.q[one.s]):
            self.traces = {}
        self.traces = {c: e * self.decay for c, e in self.traces.items()}
        self.traces[cell] = 1 + (self.traces.get(cell, 0) if self.kind == "accumulating" else 0)
        delta = one.r + one.discount * v - self.q[cell]
        self.waiting += [(c, delta * e) for c, e in self.traces.items()]
        if one.cut or not self.offline:
            for c, increment in self.waiting:
                self.q[c] += self.alpha(c) * increment
            self.waiting = []
        if one.cut:
            self.traces = {}


class TrueOnline:
    """Van Seijen and Sutton, 2014, with features x that are 1 in one place; step sizes are within the trace."""

    def __init__(self, q, alpha, *, watkins, decay=DECAY, gamma=GAMMA):
        self.q, self.alpha, self.watkins, self.decay = q, alpha, watkins, gamma * decay
        self.z, self.old = np.zeros(q.size), 0.0

    def see(self, one, v):
        x, w, cell = np.zeros_like(self.q), self.q.reshape(-1), (one.s, one.a)
        x[cell], now = 1, self.q[cell]
        x = x.reshape(-1)
        self.alpha.visit(cell)
        alpha, decay = self.alpha(cell), self.decay
        if self.watkins and now < max(self.q[one.s]):
            decay = 0
        self.z = decay * self.z + alpha * (1 - decay * (self.z @ x)) * x
        w += (one.r + one.discount * v - self.old) * self.z - alpha * (now - self.old) * x
        self.old = v
        if one.cut:
            self.z, self.old = 0 * self.z, 0.0


def run(it, q, make, target, alpha=None, **how):
    """Tables [T, S, A] after each time, the environments in turn; ``make(q, alpha)`` is the learner of each."""
    q, tables, alpha = q.copy(), np.tile(q, (len(it.r), 1, 1)), alpha or Constant()
    learners = [make(q, alpha) for _ in range(it.r.shape[1])]
    for t, n, one in in_order(it, sarsa=target == "sarsa", **how):
        learners[n].see(one, VALUES[target](q, one))
        tables[t:] = q
    return tables


# The agents, on the same experience

NUMBERS = TabularHypers(ALPHA, ALPHA, EPSILON, EPSILON, 25.0, GAMMA, 0.0, DECAY, 1.0)


def numbers(dtype=np.float64, **changed):
    """Numbers of an agent that explores only where its target expects it to, and at one step size."""
    return TabularHypers(*(jnp.asarray(number, dtype) for number in NUMBERS._replace(**changed)))


def transitions(it, dtype=np.float64):
    return Transition(
        obs_tm1=jnp.asarray(it.s, jnp.int32),
        a_tm1=jnp.asarray(it.a, jnp.int32),
        r_t=jnp.asarray(it.r, dtype),
        continues_t=jnp.asarray(~it.terminated, dtype),
        obs_t=jnp.asarray(it.s_next, jnp.int32),
        cut_t=jnp.asarray(it.terminated | it.truncated),
    )


def clock(live=1.0):
    return Clock(jnp.int32(0), jnp.int32(0), jnp.int32(0), jnp.asarray(live, jnp.float32))


def example(experience):
    return jax.tree.map(lambda leaf: jnp.zeros((), leaf.dtype), experience)


def advance(agent, state, experience, key, chunk=1, live=1.0):
    """(state, tables after each update [T / chunk, ...]) of updates with so many steps at once."""
    cut_up = jax.tree.map(lambda leaf: leaf.reshape(-1, chunk, *leaf.shape[1:]), experience)

    def update(state, given):
        state = agent.update(jax.random.fold_in(key, given[0]), state, given[1], clock(live))[0]
        return state, state.table

    return jax.lax.scan(update, state, (jnp.arange(len(cut_up.r_t)), cut_up))


@functools.cache
def program(chunk, envs, parts):
    """(hypers, q [S, A], experience [T, N], key) -> tables after each update [T / chunk, S, A]; compiled once."""

    def train(hypers, q, experience, key):
        sizes = {"num_states": STATES, "num_actions": ACTIONS, "num_envs": envs, "dtype": hypers.gamma.dtype}
        agent = tabular(hypers, **sizes, **dict(parts))
        state = agent.init(jax.random.key(0), example(experience))
        state = state._replace(table=state.table.at[: len(q)].set(q))
        return advance(agent, state, experience, key, chunk)[1][:, : len(q)]

    return jax.jit(train, compiler_options=FAST_COMPILE)


def tables(it, q, *, chunk=1, seed=0, hypers=None, **parts):
    """What ``run`` returns, of an agent in float64, after every ``chunk`` times."""
    with jax.enable_x64(True):
        hypers = numbers(
            **{"epsilon_min": 0.0, "epsilon_max": 0.0} | EXPLORES.get(parts["target"], {}) | (hypers or {})
        )
        train = program(chunk, it.r.shape[1], tuple(sorted(parts.items())))
        return np.asarray(train(hypers, jnp.asarray(q), transitions(it), jax.random.key(seed)))


#: Where the expected value needs it; elsewhere what SARSA draws at a cut is known.
EXPLORES = {"expected": {"epsilon_min": EPSILON, "epsilon_max": EPSILON}}


def random_table(seed=0, states=STATES, actions=ACTIONS):
    return np.random.default_rng(seed).normal(size=(states, actions))
