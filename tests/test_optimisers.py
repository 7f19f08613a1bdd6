"""The optimiser against a loop in float64, and the properties that freezing and sweeps rest on."""

import jax
import jax.numpy as jnp
import numpy as np
import optax
import pytest

from jaxq import optimisers


def numpy_adamw(params, grads, learning_rate, weight_decay, b1=0.9, b2=0.999, eps=1e-8, amsgrad=True):
    """PyTorch's AdamW, line by line, in float64."""
    params = params.astype(np.float64)
    mean, square, largest = (np.zeros_like(params) for _ in range(3))
    for t, grad in enumerate(grads.astype(np.float64), start=1):
        params = params * (1 - learning_rate * weight_decay)
        mean = b1 * mean + (1 - b1) * grad
        square = b2 * square + (1 - b2) * grad**2
        largest = np.maximum(largest, square) if amsgrad else square
        step = learning_rate / (1 - b1**t)
        params = params - step * mean / (np.sqrt(largest) / np.sqrt(1 - b2**t) + eps)
    return params


def run(optimiser, params, grads):
    state = optimiser.init(params)
    for grad in grads:
        updates, state = optimiser.update(grad, state, params)
        params = optax.apply_updates(params, updates)
    return params, state


@pytest.fixture(scope="module")
def problem():
    rng = np.random.default_rng(0)
    # Gradients that shrink, so that the maximum of AMSGrad is not the last average.
    scale = np.geomspace(10, 0.01, 60)[:, None]
    return rng.normal(size=30).astype(np.float32), (scale * rng.normal(size=(60, 30))).astype(np.float32)


@pytest.mark.parametrize("amsgrad", [True, False])
@pytest.mark.parametrize("weight_decay", [0.0, 0.5])
def test_equals_a_numpy_loop(problem, amsgrad, weight_decay):
    params, grads = problem
    optimiser = optimisers.adamw(0.03, weight_decay, amsgrad=amsgrad)
    actual, _ = run(optimiser, jnp.asarray(params), jnp.asarray(grads))
    np.testing.assert_allclose(actual, numpy_adamw(params, grads, 0.03, weight_decay, amsgrad=amsgrad), atol=3e-6)


def test_first_steps_are_corrected_exactly(problem):
    """After one gradient the step is lr in the direction of its sign, to rounding: b2 = 0.999 in float32 is enough."""
    params, grads = problem
    actual, _ = run(optimisers.adamw(1.0, 0.0), jnp.zeros_like(params), jnp.asarray(grads[:1]))
    np.testing.assert_allclose(actual, -np.sign(grads[0]), rtol=1e-6)


def test_maximum_is_taken_before_the_correction(problem):
    """Where PyTorch and optax differ; the loop above tells them apart only because they do."""
    params, grads = problem
    ours, _ = run(optimisers.adamw(0.03, 0.0), jnp.asarray(params), jnp.asarray(grads))
    theirs, _ = run(optax.amsgrad(0.03), jnp.asarray(params), jnp.asarray(grads))
    assert np.abs(np.asarray(ours) - np.asarray(theirs)).max() > 1e-3


def test_without_amsgrad_it_is_optax_adamw(problem):
    params, grads = problem
    ours, state = run(optimisers.adamw(0.03, 0.1, amsgrad=False), jnp.asarray(params), jnp.asarray(grads))
    theirs, _ = run(optax.adamw(0.03, weight_decay=0.1), jnp.asarray(params), jnp.asarray(grads))
    np.testing.assert_allclose(ours, theirs, atol=3e-6)
    assert state.largest == ()


def test_learning_rate_zero_changes_no_bit(problem):
    params, grads = problem
    actual, state = run(optimisers.adamw(0.0, 0.5), jnp.asarray(params), jnp.asarray(grads))
    np.testing.assert_array_equal(np.asarray(actual).view(np.uint32), params.view(np.uint32))
    assert np.abs(np.asarray(state.mean)).max() > 0


def test_every_number_may_be_traced(problem):
    params, grads = problem
    traces = []

    @jax.jit
    @jax.vmap
    def train(learning_rate, weight_decay, b1, b2, eps):
        traces.append(1)
        optimiser = optimisers.adamw(learning_rate, weight_decay, b1=b1, b2=b2, eps=eps)

        def step(carry, grad):
            params, state = carry
            updates, state = optimiser.update(grad, state, params)
            return (optax.apply_updates(params, updates), state), None

        start = jnp.asarray(params)
        return jax.lax.scan(step, (start, optimiser.init(start)), jnp.asarray(grads))[0][0]

    columns = [(0.01, 0.1), (0.0, 0.3), (0.9, 0.5), (0.999, 0.9), (1e-8, 1e-2)]
    lanes = train(*(jnp.array(column) for column in columns))
    for lane in range(2):
        lr, wd, b1, b2, eps = (column[lane] for column in columns)
        np.testing.assert_allclose(lanes[lane], numpy_adamw(params, grads, lr, wd, b1, b2, eps), atol=1e-5)
    assert len(traces) == 1


def test_update_without_params_says_what_to_call():
    optimiser = optimisers.adamw(0.1, 0.0)
    with pytest.raises(ValueError, match="update\\(grads, state, params\\)"):
        optimiser.update(jnp.ones(2), optimiser.init(jnp.ones(2)))
