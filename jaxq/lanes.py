"""The engine: many lanes through one compiled program, a small group of lanes per core.

A *group* is ``width`` slots that are vmapped together. Each core has a worker thread with a group of its own, and runs
one compiled program over it, a segment at a time; XLA lets go of the interpreter lock meanwhile, so groups run side by
side and none waits for another. Between segments the worker hands on lanes that ended and refills their slots from the
queue. Memory is that of the slots, whatever the number of lanes.

Invariant: what a lane computes depends on its hypers, its seed, the key family and the width, never on its slot, its
neighbours or its worker. All groups run the same executable, lanes meet no reduction across the group, and a lane's
keys derive from the root seed and its seed index alone.
"""

from __future__ import annotations

import os
import queue
import threading
import time
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, field
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from jaxq import experiment as runs
from jaxq import prng
from jaxq.programs import Program
from jaxq.types import Hypers, PyTree

STATUS = {runs.SOLVED: "solved", runs.FINISHED: "finished", runs.DIVERGED: "diverged"}


class Lane(NamedTuple):
    """One training to be done: a setting's index and numbers, and a seed index."""

    config: int
    seed: int
    hypers: Hypers


class Episodes(NamedTuple):
    """The finished episodes of a lane, in the order in which they ended; arrays of one length."""

    env_steps: np.ndarray  # of the lane, when the episode ended
    length: np.ndarray
    total: np.ndarray  # the return
    max_q: np.ndarray  # of the update at its last step; NaN in the warm-up


class Segment(NamedTuple):
    """A lane's totals at the end of a segment; means over the segment, NaN where there was nothing to average."""

    env_steps: int
    episodes: int
    updates: int
    train_return: float
    loss: float
    max_q: float
    epsilon: float


@dataclass(frozen=True)
class Result:
    """A lane that ended."""

    lane: Lane
    status: str
    env_steps: int
    updates: int
    episodes: Episodes
    curve: list[Segment]
    policy: PyTree
    eval_returns: np.ndarray | None  # None for a diverged lane
    max_q: np.ndarray | None  # of every update, when asked for


@dataclass
class Progress:
    """What has been done so far; ``share`` counts the lanes that ended and the parts of those under way."""

    lanes: int
    done: int = 0
    solved: int = 0
    diverged: int = 0
    env_steps: int = 0
    updates: int = 0
    share: float = 0.0


@dataclass
class Compiled:
    """The executables of one structure, and the seconds that it took to make them."""

    program: Program
    start: Callable[..., Any]
    advance: Callable[..., Any]
    evaluate: Callable[..., Any]
    policy: Callable[..., Any]
    empty: PyTree  # the shapes of a group's state
    seconds: float


def cores() -> int:
    """The cores this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def compile_program(program: Program, example: Hypers, impl: str) -> Compiled:
    """Traces and compiles a structure, once for all settings, seeds and roots. ``example``: any setting's hypers."""
    began = time.perf_counter()
    made, width = program.experiment, program.width

    def lane_key(root: jax.Array, seed: jax.Array) -> jax.Array:
        return jax.random.fold_in(prng.wrap(root, impl), seed)

    def start(root: jax.Array, state: PyTree, fresh: jax.Array, seed: jax.Array, hypers: Hypers) -> Any:
        new, log = made.init(lane_key(root, seed), hypers)
        return jax.tree.map(lambda a, b: jnp.where(fresh, a, b), new, state), log

    def evaluate(root: jax.Array, seed: jax.Array, policy: PyTree, hypers: Hypers) -> jax.Array:
        return made.evaluate(lane_key(root, seed), policy, hypers)

    def shapes(tree: PyTree) -> PyTree:
        return jax.tree.map(lambda leaf: jax.ShapeDtypeStruct((width, *leaf.shape), leaf.dtype), tree)

    root = jax.eval_shape(lambda: jax.random.key_data(prng.key(0, impl)))
    seed = jax.ShapeDtypeStruct((), jnp.uint32)
    one = jax.eval_shape(lambda r, s, h: made.init(lane_key(r, s), h)[0], root, seed, example)
    state, hypers, seeds = shapes(one), shapes(example), shapes(seed)
    policy = shapes(jax.eval_shape(made.policy, one, example))
    fresh = jax.ShapeDtypeStruct((width,), bool)
    log_axes = runs.Log(over=1, total=1, max_q=1, loss=1, epsilon=0)

    jobs = {
        "start": (jax.vmap(start, (None, 0, 0, 0, 0), (0, log_axes)), (root, state, fresh, seeds, hypers), (1,)),
        "advance": (jax.vmap(made.advance, out_axes=(0, log_axes)), (state, hypers), (0,)),
        "evaluate": (jax.vmap(evaluate, (None, 0, 0, 0)), (root, seeds, policy, hypers), ()),
        "policy": (jax.vmap(made.policy), (state, hypers), ()),
    }
    built = {
        name: jax.jit(fn, donate_argnums=donated).lower(*args).compile() for name, (fn, args, donated) in jobs.items()
    }
    return Compiled(program=program, empty=state, seconds=time.perf_counter() - began, **built)


def run(
    compiled: Compiled,
    lanes: Iterable[Lane],
    *,
    root_seed: int,
    impl: str,
    total: int,
    workers: int | None = None,
    keep_max_q: bool = False,
    on_progress: Callable[[Progress], None] | None = None,
    stop: threading.Event | None = None,
) -> Iterator[Result]:
    """Yields each lane's Result as it ends, in no fixed order.

    ``total`` is the number of lanes, for the progress. ``stop`` set: every worker finishes its segment, hands on what
    ended, and the iterator ends. An exception in a worker is raised here.
    """
    stop = stop or threading.Event()
    shared = _Shared(iter(lanes), Progress(total), stop)
    root = np.asarray(jax.random.key_data(prng.key(root_seed, impl)))
    count = workers or (cores() if jax.default_backend() == "cpu" else 1)
    count = max(1, min(count, -(-total // compiled.program.width)))
    threads = [
        threading.Thread(target=_Worker(compiled, shared, root, keep_max_q).run, daemon=True) for _ in range(count)
    ]
    for thread in threads:
        thread.start()
    running = count
    try:
        while running:
            try:
                item = shared.results.get(timeout=0.1)
            except queue.Empty:
                item = None
            if isinstance(item, BaseException):
                raise item
            if isinstance(item, Result):
                yield item
            elif item is _DONE:
                running -= 1
            if on_progress:
                on_progress(shared.progress)
    finally:
        stop.set()


_DONE = object()


class _Shared:
    """What the workers share: the queue of pending lanes, the results, the progress."""

    def __init__(self, lanes: Iterator[Lane], progress: Progress, stop: threading.Event):
        self.lanes, self.progress, self.stop = lanes, progress, stop
        self.results: queue.Queue[Any] = queue.Queue()
        self.lock = threading.Lock()
        self.shares: dict[int, float] = {}

    def take(self) -> Lane | None:
        with self.lock:
            return None if self.stop.is_set() else next(self.lanes, None)

    def count(self, worker: int, share: float, env_steps: int, updates: int, ended: list[str]) -> None:
        with self.lock:
            self.shares[worker] = share
            p = self.progress
            p.env_steps += env_steps
            p.updates += updates
            p.done += len(ended)
            p.solved += ended.count("solved")
            p.diverged += ended.count("diverged")
            p.share = p.done + sum(self.shares.values())


@dataclass
class _Slot:
    """A lane under way, and what it has done so far."""

    lane: Lane
    env_steps: int = 0
    updates: int = 0
    chunks: list[tuple[np.ndarray, ...]] = field(default_factory=list)
    curve: list[Segment] = field(default_factory=list)
    max_q: list[np.ndarray] = field(default_factory=list)


class _Worker:
    """One group of slots, and the loop that keeps it full."""

    def __init__(self, compiled: Compiled, shared: _Shared, root: np.ndarray, keep_max_q: bool):
        self.compiled, self.shared, self.root, self.keep_max_q = compiled, shared, root, keep_max_q
        self.width = compiled.program.width
        self.slots: list[_Slot | None] = [None] * self.width
        self.seeds = np.zeros(self.width, np.uint32)
        self.hypers: Hypers | None = None
        self.state = jax.tree.map(lambda leaf: np.zeros(leaf.shape, leaf.dtype), compiled.empty)
        self.waiting: list[tuple[_Slot, str, PyTree]] = []  # ended, not yet evaluated

    def run(self) -> None:
        try:
            while self._refill():
                self._advance()
                if len(self.waiting) >= self.width:
                    self._hand_on()
                if self.shared.stop.is_set():
                    break
            while self.waiting:
                self._hand_on()
            self.shared.results.put(_DONE)
        except BaseException as error:  # it belongs to the caller's thread
            self.shared.results.put(error)

    def _refill(self) -> bool:
        """Fills free slots from the queue; False when no slot holds a lane."""
        fresh = np.zeros(self.width, bool)
        for i, slot in enumerate(self.slots):
            if slot is None and (lane := self.shared.take()) is not None:
                if self.hypers is None:
                    self.hypers = jax.tree.map(lambda leaf: np.stack([leaf] * self.width), lane.hypers)
                self.slots[i], self.seeds[i], fresh[i] = _Slot(lane), lane.seed, True
                # A new array each time: the program may still read the old one.
                self.hypers = jax.tree.map(lambda rows, leaf: _with_row(rows, i, leaf), self.hypers, lane.hypers)
        if fresh.any():
            self.state, log = self.compiled.start(self.root, self.state, fresh, self.seeds.copy(), self.hypers)
            self._absorb(log, fresh)
        return any(slot is not None for slot in self.slots)

    def _advance(self) -> None:
        self.state, log = self.compiled.advance(self.state, self.hypers)
        steps, updates = self._absorb(log, np.array([slot is not None for slot in self.slots]))
        status = np.asarray(self.state.status)
        ended = [i for i, slot in enumerate(self.slots) if slot is not None and status[i] != runs.RUNNING]
        if ended:
            policies = jax.tree.map(np.asarray, self.compiled.policy(self.state, self.hypers))
            for i in ended:
                slot = self.slots[i]
                assert slot is not None
                policy = jax.tree.map(lambda leaf: leaf[i].copy(), policies)
                self.waiting.append((slot, STATUS[int(status[i])], policy))
                self.slots[i] = None
        names = [STATUS[int(status[i])] for i in ended]
        share = sum(_share(slot) for slot in self.slots if slot is not None)
        self.shared.count(id(self), share, steps, updates, names)

    def _absorb(self, log: runs.Log, which: np.ndarray) -> tuple[int, int]:
        """Sorts a log into the slots' records; returns the env steps and updates that were done."""
        program, clock = self.compiled.program, self.state.clock
        env_steps, updates, episodes = (np.asarray(x) for x in (clock.env_steps, clock.updates, clock.episodes))
        over, total, max_q, loss, epsilon = (np.asarray(x) for x in log)
        rounds, width, per_round, num_envs = over.shape
        before = np.array([slot.env_steps if slot else 0 for slot in self.slots])
        valid = np.where(which, (env_steps - before) // (per_round * num_envs), 0)
        inside = np.arange(rounds)[:, None] < valid
        u, lane, t, n = np.nonzero(over & inside[:, :, None, None])
        order = np.argsort(lane, kind="stable")
        edges = np.searchsorted(lane[order], np.arange(width + 1))
        tick = before[lane] // num_envs + u * per_round + t
        returns, values = total[u, lane, t, n], max_q[u, lane]
        done_steps = done_updates = 0
        for i in np.flatnonzero(which):
            slot = self.slots[i]
            assert slot is not None
            mine = order[edges[i] : edges[i + 1]]
            if mine.size:
                slot.chunks.append((tick[mine], n[mine], returns[mine], values[mine]))
            learned = updates[i] > slot.updates
            done_steps, done_updates = done_steps + env_steps[i] - slot.env_steps, done_updates + updates[i] - slot.updates
            slot.env_steps, slot.updates = int(env_steps[i]), int(updates[i])
            if valid[i]:
                slot.curve.append(
                    Segment(
                        env_steps=slot.env_steps,
                        episodes=int(episodes[i]),
                        updates=slot.updates,
                        train_return=float(returns[mine].mean()) if mine.size else float("nan"),
                        loss=float(loss[: valid[i], i].mean()) if learned else float("nan"),
                        max_q=float(max_q[: valid[i], i].mean()) if learned else float("nan"),
                        epsilon=float(epsilon[i]),
                    )
                )
                if self.keep_max_q:
                    slot.max_q.append(max_q[: valid[i], i].copy())
        return int(done_steps), int(done_updates)

    def _hand_on(self) -> None:
        """Evaluates up to a group of ended lanes together, and emits their results."""
        batch, self.waiting = self.waiting[: self.width], self.waiting[self.width :]
        padded = batch + batch[:1] * (self.width - len(batch))
        policy = jax.tree.map(lambda *rows: np.stack(rows), *(entry[2] for entry in padded))
        hypers = jax.tree.map(lambda *rows: np.stack(rows), *(entry[0].lane.hypers for entry in padded))
        seeds = np.array([entry[0].lane.seed for entry in padded], np.uint32)
        returns = np.asarray(self.compiled.evaluate(self.root, seeds, policy, hypers))
        for (slot, status, weights), row in zip(batch, returns, strict=False):
            self.shared.results.put(
                Result(
                    lane=slot.lane,
                    status=status,
                    env_steps=slot.env_steps,
                    updates=slot.updates,
                    episodes=_episodes(slot, self.compiled.program.num_envs),
                    curve=slot.curve,
                    policy=weights,
                    eval_returns=None if status == "diverged" else row.copy(),
                    max_q=np.concatenate(slot.max_q) if slot.max_q else None,
                )
            )


def _with_row(rows: np.ndarray, i: int, leaf: np.ndarray) -> np.ndarray:
    rows = rows.copy()
    rows[i] = leaf
    return rows


def _share(slot: _Slot) -> float:
    """The part of a lane that is surely done: it may end before its limits."""
    limits = slot.lane.hypers.run
    done = [slot.env_steps / max(1, float(limits.max_env_steps))]
    if slot.curve:
        done.append(slot.curve[-1].episodes / max(1, float(limits.max_episodes)))
    return min(1.0, max(done))


def _episodes(slot: _Slot, num_envs: int) -> Episodes:
    if not slot.chunks:
        nothing = np.zeros(0)
        return Episodes(nothing.astype(int), nothing.astype(int), nothing, nothing)
    tick, env, returns, max_q = (np.concatenate(column) for column in zip(*slot.chunks, strict=True))
    length = np.empty(tick.shape, int)
    for n in range(num_envs):
        own = env == n
        length[own] = np.diff(tick[own], prepend=-1)
    return Episodes((tick + 1) * num_envs, length, returns.astype(float), max_q.astype(float))
