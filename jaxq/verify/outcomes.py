"""What may follow each action of a finite world, and how often, against Gymnasium's table."""

from __future__ import annotations

import contextlib
import math
from collections import Counter
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from jaxq.envs import exact
from jaxq.interop.gymnasium import reference
from jaxq.interop.gymnasium.compiled import made
from jaxq.verify.checks import Found
from jaxq.worlds import World

#: Standard errors by which the share of an outcome may miss its probability. Of the some 10,000 shares that a run looks
#: at, one in 50,000 runs would have one so far off by chance; the keys are fixed, so a run gives what it gave before.
ALLOWED = 6.0
#: Sums of at most four probabilities in float64, and of as many rewards of up to 100.
EXACT = 1e-12
#: Draws of each state and action at most, and steps at once.
DRAWS, STEPS = 1000, 2**21
SEED = 0


def tabulated(world: World) -> Found:
    """The largest difference of a probability or of an expected reward between the exact arrays and Gymnasium's;
    infinite where other states are terminal."""
    ours = exact(world)
    with contextlib.closing(reference.make(world)) as theirs:
        table: Any = theirs.unwrapped.P  # type: ignore[attr-defined]
        start = np.asarray(theirs.unwrapped.initial_state_distrib)  # type: ignore[attr-defined]
    transition, reward = np.zeros(ours.transition.shape), np.zeros(ours.reward.shape)
    terminal = np.zeros(len(transition), bool)
    for s, actions in table.items():
        for a, listed in actions.items():
            for probability, after, paid, ends in listed:
                transition[s, a, after] += probability
                reward[s, a] += probability * paid
                terminal[after] |= ends and probability > 0
    wrong = np.flatnonzero(np.asarray(ours.terminal) != terminal)
    begins = np.abs(ours.start - start)
    if len(wrong) or begins.max() > EXACT:
        s = int(wrong[0] if len(wrong) else np.argmax(begins))
        told = f"state {s}: ours terminal {bool(ours.terminal[s])} and first with {ours.start[s]:g}"
        told += f", theirs {bool(terminal[s])} and {start[s]:g}"
        return Found(len(start), math.inf if len(wrong) else begins.max(), EXACT, told)
    error = np.maximum(np.abs(ours.transition - transition).max(-1), np.abs(ours.reward - reward))
    if error.max() <= EXACT:
        return Found(error.size, error.max(), EXACT)
    s, a = np.unravel_index(np.argmax(error), error.shape)
    told = f"ours {ours.transition[s, a].max():g} and reward {ours.reward[s, a]:g}"
    told += f", theirs {transition[s, a].max():g} and {reward[s, a]:g}"
    return Found(error.size, error.max(), EXACT, f"state {s}, action {a}: likeliest successor {told}")


def compared(world: World, cases: int) -> Found:
    """The most standard errors by which an outcome's share misses Gymnasium's probability; infinite where an outcome
    occurs that Gymnasium does not know, or one that is certain there does not."""
    env = made(world)
    with contextlib.closing(reference.make(world)) as theirs:
        table: Any = theirs.unwrapped.P  # type: ignore[attr-defined]
    num_states, num_actions = int(env.num_states or 0), env.num_actions
    draws = 1 if env.deterministic else max(2, min(cases, DRAWS, STEPS // (num_states * num_actions)))
    kind = type(jax.eval_shape(env.reset, jax.random.key(SEED)))

    def step(place: jax.Array, draw: jax.Array) -> Any:
        key = jax.random.fold_in(jax.random.key(SEED), place * draws + draw)
        state = kind(s=place // num_actions, t=jnp.zeros((), jnp.int32))
        happened = env.step(key, state, place % num_actions)[1]
        return happened.obs, happened.reward, happened.terminated

    places = jnp.arange(num_states * num_actions)
    found = jax.jit(jax.vmap(jax.vmap(step, in_axes=(None, 0)), in_axes=(0, None)))(places, jnp.arange(draws))
    successor, reward, terminated = (np.asarray(leaf) for leaf in found)
    largest, detail = 0.0, ""
    for place in range(num_states * num_actions):
        s, a = divmod(place, num_actions)
        expected: Counter[tuple[int, float, bool]] = Counter()
        for probability, after, paid, ends in table[s][a]:
            expected[int(after), float(np.float32(paid)), bool(ends)] += probability
        rows = zip(successor[place].tolist(), reward[place].tolist(), terminated[place].tolist(), strict=True)
        seen = Counter(rows)
        for outcome in {*expected, *seen}:
            p, share = min(1.0, expected[outcome]), seen[outcome] / draws
            spread = math.sqrt(max(0.0, p * (1 - p)) / draws)
            error = 0.0 if math.isclose(share, p) else abs(share - p) / spread if 1e-9 < p < 1 - 1e-9 else math.inf
            if error > largest:
                largest = error
                if error > ALLOWED:
                    detail = f"state {s}, action {a}: {outcome} comes with {share:g}, theirs {p:g}"
    return Found(num_states * num_actions * draws, largest, ALLOWED, detail)
