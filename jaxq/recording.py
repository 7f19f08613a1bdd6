"""Recordings: greedy episodes of a saved policy as moving pictures."""

from __future__ import annotations

import math
import shutil
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from jaxq import frames, prng, replayed, run_files
from jaxq.evaluation import begin
from jaxq.frames import films
from jaxq.frames.films import Shot
from jaxq.frames.panel import Moment, Scale, beside, fitted
from jaxq.replayed import Trained
from jaxq.requests import whole
from jaxq.worlds import World

#: A film shows no more frames in a second: a GIF's are whole hundredths of a second long.
MOST_FRAMES_PER_SECOND = 25
#: How long the last frame of an episode stays, seconds.
PAUSE = 1.0
#: Endings of the names of films.
ENDINGS = GIF, MP4 = ".gif", ".mp4"
#: After an episode's end none is taken.
NO_ACTION = -1


class Taken(NamedTuple):
    """A step of a greedy episode: the state that was left, and what came of it; at the end the last state, and none."""

    state: Any
    values: np.ndarray | None  # [A]; none after a termination, where nothing follows
    action: int
    reward: float
    terminated: bool
    truncated: bool


class Scene(NamedTuple):
    """A step that is shown: the panel's words and bars, the greatest values of the episode so far, and for how long."""

    state: Any
    moment: Moment
    past: list[float]  # of the episode; it grows with the next scenes
    seconds: float


def play(
    outcome: Trained,
    config: int,
    seed: int,
    count: int,
    max_steps: int,
    tell: Callable[[float, int], None] = lambda done, of: None,
) -> list[list[Taken]]:
    """Greedy episodes of a lane's policy, from starts that its training and evaluation did not see.

    Each is cut at ``max_steps``. ``tell`` is called with how many were played, in parts of the longest that one can be,
    and of how many. Raises ValueError where no policy was kept.
    """
    longest = min(max_steps, getattr(outcome.settings(config).env, "max_episode_steps", max_steps))
    made, q_values, _, before = replayed.lane(outcome, config, seed)
    step, reset, value = (
        jax.jit(made.env.step),
        jax.jit(lambda key: begin(made.env, key, before)),
        jax.jit(lambda s: q_values(made.env.observe(s))),
    )
    found = []
    for k, key in enumerate(jax.random.split(jax.random.fold_in(prng.key(0, "threefry"), 2), count)):
        reset_key, step_key = jax.random.split(key)
        state, rows = reset(reset_key), list[Taken]()
        for t in range(max_steps):
            values = np.asarray(value(state))
            action = int(values.argmax())
            after, happened = step(jax.random.fold_in(step_key, t), state, jnp.int32(action))
            ends = bool(happened.terminated), bool(happened.truncated)
            rows.append(Taken(jax.tree.map(np.asarray, state), values, action, float(happened.reward), *ends))
            state = after
            tell(k + min(1.0, (t + 1) / longest), count)
            if any(ends):
                break
        last = None if rows[-1].terminated else np.asarray(value(state))
        state = jax.tree.map(np.asarray, state)
        rows.append(rows[-1]._replace(state=state, values=last, action=NO_ACTION, reward=0.0))
        tell(k + 1, count)
        found.append(rows)
    return found


def tempo(world: World, fps: float | None = None) -> tuple[int, float]:
    """Every how many steps one is shown, and the steps per second: the world's own, or ``fps``."""
    rate = world.frame_rate if fps is None else fps
    return max(1, math.ceil(rate / MOST_FRAMES_PER_SECOND)), rate


def scale(played: Sequence[Sequence[Taken]]) -> Scale:
    """The least and greatest action value of all episodes."""
    everything = np.concatenate([taken.values for rows in played for taken in rows if taken.values is not None])
    finite = everything[np.isfinite(everything)]
    return Scale(float(finite.min()), float(finite.max())) if finite.size else Scale(0.0, 1.0)


def scenes(world: World, played: Sequence[Sequence[Taken]], fps: float | None = None) -> Iterator[Scene]:
    """What is shown of episodes, at the world's own pace or at ``fps`` steps a second.

    Above ``MOST_FRAMES_PER_SECOND`` steps are left out, though never an episode's last, which stays.
    """
    stride, rate = tempo(world, fps)
    for k, rows in enumerate(played):
        which = f"episode {k + 1} of {len(played)}" if len(played) > 1 else ""
        total, past, last = 0.0, list[float](), len(rows) - 1
        for t, taken in enumerate(rows):
            if taken.values is not None:
                past.append(float(taken.values.max()))
            if t % stride == 0 or t == last:
                ended = "terminated" if taken.terminated else "truncated" if taken.truncated else "still going"
                moment = Moment(taken.values, taken.action, t, total, ended if t == last else "", which)
                yield Scene(taken.state, moment, past, PAUSE if t == last else stride / rate)
            total += taken.reward


def shots(
    world: World,
    played: Sequence[Sequence[Taken]],
    title: str,
    fps: float | None = None,
    tell: Callable[[int, int], None] = lambda done, of: None,
) -> Iterator[Shot]:
    """The frames of episodes, drawn one at a time: the world's picture, where it has one, with the action values beside
    it. ``tell`` is called with the number of frames that were taken, and of all.
    """
    stride, _ = tempo(world, fps)
    count = sum(-(-(len(rows) - 1) // stride) + 1 for rows in played)
    between, names = scale(played), actions(world, played)
    usual = frames.size_of(world)
    size = None if usual is None else fitted(usual)
    for k, scene in enumerate(scenes(world, played, fps)):
        picture = None if size is None else frames.draw(world, scene.state, size=size)
        yield Shot(beside(picture, scene.moment, scene.past, between, (title, *names)), scene.seconds)
        tell(k + 1, count)


def actions(world: World, played: Sequence[Sequence[Taken]]) -> tuple[str, ...]:
    """The names of the actions, each empty where nobody has said."""
    values = played[0][0].values
    return world.actions() or ("",) * (0 if values is None else len(values))


def record(
    outcome: Trained,
    path: Path,
    config: int = 0,
    seed: int = 0,
    *,
    episodes: int = 1,
    max_steps: int = 1000,
    fps: float | None = None,
) -> list[float]:
    """Writes a film of a lane's greedy episodes, each cut at ``max_steps``, at ``fps`` steps a second or at the world's
    own pace; returns what they returned. An environment of the user's own has its action values filmed alone.

    Raises ValueError for what is not allowed and where no policy was kept, WriteError where the file cannot be written.
    """
    if path.suffix.lower() not in ENDINGS:
        raise ValueError(f"path: {path} is not allowed: a name that ends in {' or '.join(ENDINGS)}")
    check(episodes, max_steps, fps)
    played = play(outcome, config, seed, episodes, max_steps)
    write(path, outcome.settings(config).env, played, title(outcome, config, seed), fps)
    return returns(played)


def check(episodes: int, max_steps: int, fps: float | None) -> None:
    """Raises ValueError for what is out of its range."""
    whole("episodes", episodes, 1, 100)
    whole("max_steps", max_steps, 1, 100_000)
    if fps is not None and not 0.1 <= fps <= 1000:
        raise ValueError(f"fps: {fps} is not allowed: from 0.1 to 1000")


def title(outcome: Trained, config: int, seed: int) -> str:
    """What a lane's episodes are called."""
    return f"{outcome.settings(config).env}  setting {config}, seed {seed}"


def returns(played: Sequence[Sequence[Taken]]) -> list[float]:
    """The sum of rewards of each episode."""
    return [sum(taken.reward for taken in rows) for rows in played]


def write(
    path: Path,
    world: World,
    played: Sequence[Sequence[Taken]],
    title: str,
    fps: float | None = None,
    tell: Callable[[int, int], None] = lambda done, of: None,
) -> None:
    """Writes episodes as a film, a GIF or an MP4 by the name's ending, whole or not at all; see ``shots``.

    Raises WriteError.
    """
    coming = shots(world, played, title, fps, tell)
    program = ffmpeg()
    if path.suffix.lower() != MP4:
        films.write_gif(path, coming)
    elif program is None:
        raise run_files.WriteError(f"{path}: needs ffmpeg, which is not on the path")
    else:
        stride, rate = tempo(world, fps)
        films.write_mp4(path, coming, stride / rate, program)


def ffmpeg() -> str | None:
    """The program that writes MP4, where it is on the path."""
    return shutil.which("ffmpeg")
