"""Our learners in any Gymnasium environment: it steps on the host; acting and learning are compiled."""

from __future__ import annotations

import contextlib
import signal
import threading
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from gymnasium import spaces
from gymnasium.vector import VectorEnv

from jaxq import rounds
from jaxq.families import FAMILIES
from jaxq.interop.gymnasium.foreign import Foreign, Source, check_apart, foreign
from jaxq.interop.gymnasium.learner import Learner
from jaxq.interop.gymnasium.trained import Trained
from jaxq.interop.gymnasium.transitions import Transitions
from jaxq.plans import Plan
from jaxq.presets import Preset, TabularSettings, Training, preset, settle
from jaxq.progress import Display
from jaxq.requests import whole
from jaxq.saved_policy import SavedPolicy, describe, flatten
from jaxq.shared import Progress
from jaxq.suggest import nearest
from jaxq.tally import Episodes
from jaxq.worlds import CartPole


def train(
    name: str,
    env: Source,
    *,
    seed: int = 0,
    prng: str | None = None,
    bounds: Sequence[tuple[float, float]] | None = None,
    eval_steps: int | None = None,
    progress: bool = True,
    on_episode: Callable[[int, int, float], None] | None = None,
    **values: Any,
) -> Trained:
    """Trains a preset in a Gymnasium environment with discrete actions.

    ``train("dqn", "LunarLander-v3", num_envs=8, max_env_steps=300_000)``. ``env`` is an id, a function without
    arguments that makes an environment, or a ``VectorEnv``, which is not closed. All its environments act at once. In
    each of Gymnasium's three modes of auto-reset the learner sees the true successor, bootstraps through a truncation
    and never through a termination; its keys, clock and ends are those of ``jaxq.train``. ``values`` are the preset's
    settings; where a preset's rule of success is about the length of CartPole's episodes, other environments are solved
    at Gymnasium's threshold, where there is one. ``bounds`` are the low and high of each coordinate between which a
    table divides observations, by default those of the space. ``progress`` is talk on stderr, with a bar in a terminal;
    ``on_episode(env_steps, length, total)`` is told of each episode. Ctrl-C ends the training and keeps what it learnt.

    Raises ValueError that names the field, the value and what is allowed.
    """
    seed = int(seed) if isinstance(seed, np.integer) else seed
    whole("seed", seed, 0, 2**32 - 1)
    if eval_steps is not None:
        whole("eval_steps", eval_steps, 1, 10**9)
    if prng is not None and prng not in FAMILIES:
        raise ValueError(f"prng: {prng!r} is unknown{nearest(prng, FAMILIES)}")
    base = preset(name)
    values = {**values, **_environments(base, env, values)}
    of = foreign(env, values.get("num_envs", getattr(base.settings, "num_envs", 1)), bounds)
    judge: Foreign | None = None
    try:
        settings = _settled(base, of, values)
        if of.envs is env and settings.eval_every:
            raise ValueError("eval_every: is not allowed with a VectorEnv, which is in use: pass an id or a function")
        judge = of if of.envs is env else foreign(env, min(of.envs.num_envs, settings.eval_episodes), bounds)
        check_apart(of.envs, *() if judge is of else (judge.envs,))
        plan = Plan(base.name, (settings,), (), (0,), seed, base.prng if prng is None else prng)
        with Display(plan, show=True, talk=progress) as display:
            return _run(plan, of, judge, display, on_episode, eval_steps or settings.env.eval_steps)
    finally:
        for one in (of, judge):
            if one is not None and one.envs is not env:
                one.envs.close()


def _run(
    plan: Plan,
    of: Foreign,
    judge: Foreign,
    display: Display,
    on_episode: Callable[[int, int, float], None] | None,
    eval_steps: int,
) -> Trained:
    (settings,), seed, many = plan.settings, plan.root_seed, of.envs.num_envs
    world = Transitions(of)
    world.begin(_seed(seed, 0, 0))
    display.compiling(1, 1)
    learner = Learner(settings, world.obs, seed, plan.prng)
    done, told = Progress(1), 0.0
    ended: list[tuple[float, ...]] = []
    curve: list[tuple[int, float]] = []
    with _interrupts() as stop:
        while learner.status == rounds.RUNNING and not stop.is_set():
            if world.resetting:
                world.take(np.zeros(many, np.int32))
                continue
            row = world.take(learner.act(world.obs))
            for _, length, total in world.finished:
                ended.append((done.env_steps + many, length, total, learner.next_update))
                if on_episode is not None:
                    on_episode(done.env_steps + many, length, total)
            if row is None:
                learner.skip()
                continue
            done.env_steps += many
            if not learner.add(row):
                continue
            done.updates = len(learner.loss)
            done.share = min(1.0, max(done.env_steps / settings.max_env_steps, len(ended) / settings.max_episodes))
            if time.monotonic() - told > 0.1:
                told = time.monotonic()
                display.progress(done)
            if settings.eval_every and done.env_steps // settings.eval_every > len(curve):
                seen = _greedy(judge, _policy(settings, learner), settings.eval_episodes, eval_steps, seed, stop)
                curve += [] if seen is None else [(done.env_steps, float(seen.mean()))]
        policy = _policy(settings, learner)
        finite = all(np.isfinite(array).all() for array in policy.weights.values())
        status = rounds.STATUS[learner.status if finite else rounds.DIVERGED]
        if learner.status == rounds.RUNNING:
            status = "interrupted"
        ended_well = status in ("solved", "finished")
        returns = _greedy(judge, policy, settings.eval_episodes, eval_steps, seed, stop) if ended_well else None
    done.done, done.share = 1, 1.0
    done.solved, done.diverged = int(status == "solved"), int(status == "diverged")
    display.progress(done)
    at, lengths, totals, update = np.array(ended, float).reshape(-1, 4).T
    max_q = np.array([np.nan, *learner.max_q, np.nan])[update.astype(int)]  # none in the warm-up and in a broken round
    return Trained(
        status=status,
        env_steps=done.env_steps,
        episodes=Episodes(at.astype(int), lengths.astype(int), totals, max_q),
        loss=np.array(learner.loss),
        max_q=np.array(learner.max_q),
        eval_returns=returns,
        curve=np.array(curve, float).reshape(-1, 2).T,
        policy=_spoken(policy, of),
        settings=settings,
    )


def _greedy(
    of: Foreign, policy: SavedPolicy, episodes: int, most: int, seed: int, stop: threading.Event
) -> np.ndarray | None:
    """Returns of greedy episodes, each cut after ``most`` steps, from the same starts each time; one of each
    environment, until there are enough, so that short episodes count no more than long ones. None when stopped."""
    returns: list[float] = []
    world, many, wave = Transitions(of), of.envs.num_envs, 0
    while len(returns) < episodes:
        world.begin(_seed(seed, 1, wave))
        totals, going = np.zeros(many), np.ones(many, bool)
        for _ in range(most):
            if stop.is_set():
                return None
            world.take(policy.act(world.obs))
            for i, _, total in world.finished:
                if going[i]:
                    totals[i], going[i] = total, False
            if not going.any():
                break
        totals[going] = world.total[going]
        returns, wave = [*returns, *totals.tolist()], wave + 1
    return np.array(returns[:episodes])


def _spoken(policy: SavedPolicy, of: Foreign) -> SavedPolicy:
    """The policy in the environment's own integers, where those do not begin at 0."""
    firsts = {"first_state": of.first_state, "first_action": of.first_action}
    return replace(policy, about={**policy.about, **{name: first for name, first in firsts.items() if first}})


def _policy(settings: Training, learner: Learner) -> SavedPolicy:
    about = describe(settings)
    assert about is not None  # of tables and networks alone, which all presets are
    return SavedPolicy(about, flatten(learner.policy()))


def _seed(seed: int, purpose: int, wave: int) -> int:
    """A seed for Gymnasium, which gives its environments the next ones: far from those of the next ``seed``."""
    return int(np.random.SeedSequence(seed, spawn_key=(purpose, wave)).generate_state(1)[0])


def _environments(base: Preset, env: Source, values: Mapping[str, Any]) -> dict[str, int]:
    """How many environments a vector of them has, as the preset's setting. Raises ValueError for a wrong number."""
    if "num_envs" in values:
        whole("num_envs", values["num_envs"], 1, 2**16)
    if not isinstance(env, VectorEnv):
        return {}
    if values.get("num_envs", env.num_envs) != env.num_envs:
        raise ValueError(f"num_envs: {values['num_envs']} is not allowed: the VectorEnv has {env.num_envs}")
    if hasattr(base.settings, "num_envs"):
        return {"num_envs": env.num_envs}
    if env.num_envs > 1:
        raise ValueError(f"env: {env.num_envs} environments are not allowed: {base.name} learns in one")
    return {}


def _settled(base: Preset, of: Foreign, values: Mapping[str, Any]) -> Training:
    """The preset's settings in this environment."""
    suited: dict[str, Any] = {"env": of.world}
    if of.world.id != CartPole.id or of.envs.single_observation_space.shape != (4,):
        if base.settings.stop in ("streak", "window"):
            suited["stop"] = "none" if of.world.reward_threshold is None else "gymnasium"
        box = isinstance(of.envs.single_observation_space, spaces.Box)
        if isinstance(base.settings, TabularSettings) and box and of.world.bounds is None:
            raise ValueError(f"bounds: {of.world} has none of its own: pass the low and high of each coordinate")
    settings: Training = settle(base, **{**suited, **values})
    return settings


@contextlib.contextmanager
def _interrupts() -> Iterator[threading.Event]:
    """Ctrl-C sets the event, between whose looks nothing is half-done; a second one is raised."""
    stop = threading.Event()
    if threading.current_thread() is not threading.main_thread():
        yield stop  # who runs other threads minds Ctrl-C
        return
    before = signal.getsignal(signal.SIGINT)

    def interrupt(number: int, frame: Any) -> None:
        if stop.is_set():
            raise KeyboardInterrupt
        stop.set()

    signal.signal(signal.SIGINT, interrupt)
    try:
        yield stop
    finally:
        signal.signal(signal.SIGINT, before)
