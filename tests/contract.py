"""What every environment and wrapper keeps to, a function each. The message beside a check says what is broken."""

import functools

import jax
import jax.numpy as jnp
import numpy as np

from jaxq.envs.auto_reset import next_episode

STEPS = 300


def words(seed, count):
    """Words of keys: JAX takes the keys of a scan in a vmap for used."""
    return jax.random.key_data(jax.random.split(jax.random.key(seed), count))


@functools.lru_cache(maxsize=2)  # several checks look at one walk
def roll(env, seed=0, steps=STEPS):
    """A random walk over several episodes: Steps, what is observed of the states after them, and those that the walk
    went on from, [steps, ...].
    """

    @jax.jit
    def walk(first, each):
        def body(state, given):
            act, again, action = given
            after, happened = env.step(jax.random.wrap_key_data(act), state, action)
            seen, on = env.observe(after), after
            if not env.resets:
                over = happened.terminated | happened.truncated
                fresh = next_episode(env, jax.random.wrap_key_data(again), after)
                on = jax.tree.map(lambda new, old: jnp.where(over, new, old), fresh, after)
            return on, (happened, seen, on)

        return jax.lax.scan(body, env.reset(jax.random.wrap_key_data(first)), each)[1]

    rows, rng = words(seed, 2 * steps + 1), np.random.default_rng(seed)
    actions = rng.integers(env.num_actions, size=steps, dtype=np.int32)
    return walk(rows[0], (rows[1 : steps + 1], rows[steps + 1 :], actions))


def shapes_and_dtypes_are_stable(env):
    reset_key, step_key = jax.random.split(jax.random.key(0))
    state = env.reset(reset_key)
    after, happened = env.step(step_key, state, jnp.int32(0))
    assert jax.tree.structure(state) == jax.tree.structure(after), "step changes the state's structure"
    types = [jax.tree.map(lambda leaf: (leaf.shape, leaf.dtype), jax.eval_shape(lambda x=x: x)) for x in (state, after)]
    assert types[0] == types[1], "step changes a shape or dtype of the state: it cannot be scanned"
    for name in ("terminated", "truncated"):
        flag = getattr(happened, name)
        assert (flag.shape, flag.dtype) == ((), bool), f"{name} is no single truth value"
    reward = happened.reward
    assert (reward.shape, reward.dtype) == ((), jnp.float32), "the reward is no single float32"
    observed = [jax.eval_shape(lambda x=x: x) for x in (env.observe(state), env.observe(after), happened.obs)]
    assert len({(x.shape, x.dtype) for x in observed}) == 1, "observe and step do not give observations of one kind"
    assert observed[0].shape == env.obs_shape, "obs_shape is not the shape of observations"
    if env.num_states is not None:
        assert jnp.issubdtype(observed[0].dtype, jnp.integer), "num_states is set but observations are no integers"


def a_walk_is_finite_and_in_range(env):
    happened, seen, _ = roll(env)
    for name, leaf in (("observation", seen), ("successor", happened.obs), ("reward", happened.reward)):
        assert np.all(np.isfinite(np.asarray(leaf))), f"a {name} is not finite"
    if env.num_states is not None:
        assert 0 <= np.min(happened.obs) <= np.max(happened.obs) < env.num_states, "an index outside num_states"


def the_true_successor_is_kept(env):
    """The Step's observation is that of the state which the step leads to, at an episode's end as well."""
    happened, seen, _ = roll(env)
    over = np.asarray(happened.terminated | happened.truncated)
    close = np.isclose(happened.obs, seen, rtol=1e-5, atol=1e-5).reshape(len(over), -1).all(1)
    # Who resets shows the next episode's first observation beside the last one's successor.
    assert np.all(close | over if env.resets else close), "observe(state) is not that of the step that led there"


def an_ended_episode_gives_way_to_a_start(env):
    """States after an end are among those that ``reset`` or ``restart`` can give: time starts anew."""
    happened, _, afters = roll(env)
    over = np.asarray(happened.terminated | happened.truncated)
    assert over.any(), "no episode ended: the walk is too short to see one"
    start = env.reset(jax.random.key(3))
    for path, leaf in jax.tree_util.tree_leaves_with_path(afters):
        if jax.tree_util.keystr(path).endswith(".t"):
            (first,) = (x for p, x in jax.tree_util.tree_leaves_with_path(start) if p == path)
            assert np.all(np.asarray(leaf)[over] == first), "time goes on after an episode's end"


def a_reset_depends_on_its_key_alone(env):
    one, again = (env.reset(jax.random.key(1)) for _ in range(2))
    assert jax.tree.all(jax.tree.map(lambda a, b: bool(np.array_equal(a, b)), one, again)), "a key gives two starts"


def several_starts_differ(env):
    starts = jax.jit(jax.vmap(lambda key: env.observe(env.reset(key))))(jax.random.split(jax.random.key(0), 64))
    assert len(np.unique(np.asarray(starts).reshape(64, -1), axis=0)) > 1, "every key gives the same start"


def several_restarts_differ(env):
    """Where something outlives an episode, the next one begins as its key says."""
    keys, state = jax.random.split(jax.random.key(1), 16), env.reset(jax.random.key(0))
    starts = jax.jit(jax.vmap(lambda key: env.observe(next_episode(env, key, state))))(keys)
    assert len(np.unique(np.asarray(starts).reshape(16, -1), axis=0)) > 1, "every key begins the same next episode"


def a_deterministic_step_does_not_use_its_key(env):
    if not env.deterministic:
        return
    state = env.reset(jax.random.key(2))
    outcomes = jax.jit(jax.vmap(lambda key: env.step(key, state, jnp.int32(0))))(
        jax.random.split(jax.random.key(0), 16)
    )
    for leaf in jax.tree.leaves(outcomes):
        assert np.all(np.asarray(leaf) == np.asarray(leaf)[:1]), "deterministic, but step depends on its key"


def a_batch_is_each_alone(env):
    """A compiled batch gives what the functions give as they are written, one at a time."""
    count = 4
    starts, steps = words(4, count), words(5, count)
    actions = jnp.arange(count) % env.num_actions

    def one(start, step, action):
        state = env.reset(jax.random.wrap_key_data(start))
        return env.step(jax.random.wrap_key_data(step), state, action)

    batch = jax.jit(jax.vmap(one))(starts, steps, actions)
    for i in range(count):
        for a, b in zip(jax.tree.leaves(one(starts[i], steps[i], actions[i])), jax.tree.leaves(batch), strict=True):
            np.testing.assert_allclose(a, b[i], rtol=2e-6, atol=2e-6, err_msg="vmap and jit are not the loop")


CHECKS = (
    shapes_and_dtypes_are_stable,
    a_walk_is_finite_and_in_range,
    the_true_successor_is_kept,
    an_ended_episode_gives_way_to_a_start,
    a_reset_depends_on_its_key_alone,
    a_deterministic_step_does_not_use_its_key,
    a_batch_is_each_alone,
)
