"""Rules inside a scan under jit: TD(lambda) with eligibility traces on a random walk whose values are known.

Sutton and Barto, 2018, example 7.1: states 1 to 19 in a row, each step goes left or right by chance, -1 for leaving on
the left and 1 on the right. State s is worth (s - 10) / 10. All seeds and all lambdas are one program.

python docs/examples/scan.py
"""

import jax
import jax.numpy as jnp
import numpy as np

from jaxq import rules

STATES, START, STEPS, SEEDS = 21, 10, 2000, 200  # states 0 and 20 are the ends; an episode has 100 steps on average
STEP_SIZE = 0.05
LAMBDAS = (0.0, 0.4, 0.8, 0.9, 1.0)
EXACT = (np.arange(STATES) - 10) / 10


def walk(s, go_right):
    """One step of the walk: the state it comes to, the reward, and whether it ended there."""
    s_t = s + jnp.where(go_right, 1, -1)
    ended = (s_t == 0) | (s_t == STATES - 1)
    return s_t, jnp.where(ended, jnp.sign(s_t - START), 0), ended


def rms(table):
    """Error of the values of the 19 states. Shapes: table [S, 1] -> []."""
    return jnp.sqrt(jnp.mean((table[1:-1, 0] - EXACT[1:-1]) ** 2))


def train(key, lambda_):
    """RMS errors after each step, [STEPS]: one seed, one lambda. In a walk there is one action, 0, and nothing else."""

    def step(carry, go_right):
        table, trace, s, decay = carry
        s_t, r_t, ended = walk(s, go_right)
        discount_t = 1.0 - ended  # gamma is 1
        # The rule and the trace see one transition. SARSA with one action is TD.
        delta = rules.sarsa(table[s], 0, r_t, discount_t, table[s_t], 0)
        trace = rules.accumulating_trace(trace, s, 0, decay)
        table = table + STEP_SIZE * delta * trace
        # The next step may be another episode's: then nothing is left of the trace.
        return (table, trace, jnp.where(ended, START, s_t), lambda_ * discount_t), rms(table)

    table = jnp.zeros((STATES, 1))
    start = (table, jnp.zeros_like(table), jnp.int32(START), jnp.float32(0))
    return jax.lax.scan(step, start, jax.random.bernoulli(key, shape=(STEPS,)))[1]


# The inner vmap is over lambdas, which see the same walk, the outer one over seeds.
train_all = jax.jit(jax.vmap(jax.vmap(train, in_axes=(None, 0)), in_axes=(0, None)))


def main():
    keys = jax.random.split(jax.random.key(0), SEEDS)
    errors = train_all(keys, jnp.array(LAMBDAS))  # [SEEDS, LAMBDAS, STEPS]
    print(f"RMS error, mean of {SEEDS} walks; with all values 0 it is {rms(jnp.zeros((STATES, 1))):.3f}")
    for i, lambda_ in enumerate(LAMBDAS):
        early, late = errors[:, i, 199].mean(), errors[:, i, -1].mean()
        print(f"lambda {lambda_:.1f}: {early:.3f} after 200 steps, {late:.3f} after {STEPS:,}")
    return errors


if __name__ == "__main__":
    main()
