"""Networks: PyTorch's initialisation, and the function that the layers make."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxq import networks


def linear_params(params, index):
    return params["params"][f"Linear_{index}"]


def plain_apply(params, obs):
    """The same network in plain products."""
    layers = [linear_params(params, i) for i in range(len(params["params"]))]
    x = jnp.ravel(obs)
    for layer in layers[:-1]:
        x = jnp.maximum(x @ layer["kernel"] + layer["bias"], 0)
    return x @ layers[-1]["kernel"] + layers[-1]["bias"]


def assert_close(actual, expected):
    jax.tree.map(lambda a, b: np.testing.assert_allclose(a, b, rtol=1e-5, atol=1e-5), actual, expected)


@pytest.fixture(scope="module")
def net():
    return networks.mlp((16, 8), 3)


def initial_lanes(net, count):
    return jax.jit(jax.vmap(lambda key: net.init(key, jnp.zeros(4))))(jax.random.split(jax.random.key(2), count))


def test_initial_weights_are_uniform_within_one_over_root_fan_in():
    params = jax.jit(networks.mlp((400, 300), 200).init)(jax.random.key(1), jnp.zeros((5, 5)))
    for index, fan_in in enumerate((25, 400, 300)):
        bound = fan_in**-0.5
        for values in linear_params(params, index).values():
            assert jnp.abs(values).max() <= bound
            assert jnp.abs(values).max() > 0.97 * bound
            np.testing.assert_allclose(jnp.std(values), bound / np.sqrt(3), rtol=0.1)
            assert abs(jnp.mean(values)) < 4 * bound / np.sqrt(3 * values.size)


def test_layers_and_lanes_start_differently(net):
    layer = jax.jit(networks.mlp((4,), 4).init)(jax.random.key(0), jnp.zeros(4))["params"]
    assert not np.allclose(layer["Linear_0"]["kernel"], layer["Linear_1"]["kernel"])
    lanes = initial_lanes(net, 2)
    for values in jax.tree.leaves(lanes):
        assert not np.allclose(values[0], values[1])


def test_observations_of_any_shape_are_flattened(net):
    obs = jnp.arange(12.0).reshape(3, 4)
    params = jax.jit(net.init)(jax.random.key(0), obs)
    assert net.apply(params, obs).shape == (3,)
    np.testing.assert_array_equal(net.apply(params, obs), net.apply(params, obs.ravel()))
    np.testing.assert_array_equal(net.apply(params, obs), net.apply(params, obs.astype(jnp.uint8)))


def test_no_hidden_layer_is_a_linear_function():
    net = networks.mlp((), 2)
    params = net.init(jax.random.key(0), jnp.zeros(3))
    assert set(params["params"]) == {"Linear_0"}
    zero, x = net.apply(params, jnp.zeros(3)), jnp.array([1.0, -2.0, 3.0])
    assert_close(net.apply(params, 2 * x) - zero, 2 * (net.apply(params, x) - zero))


def test_batches_and_lanes_equal_plain_products(net):
    lanes = initial_lanes(net, 3)
    obs = jax.random.normal(jax.random.key(1), (3, 7, 4))

    def gradient(apply):
        def total(params, obs):
            return jnp.sum(jax.vmap(apply, (None, 0))(params, obs) ** 2)

        return jax.jit(jax.vmap(jax.value_and_grad(total)))(lanes, obs)

    assert_close(gradient(net.apply), gradient(plain_apply))


@pytest.mark.parametrize("num_inputs", [4, 9])
@pytest.mark.parametrize("hidden", [(), (6,), (3, 9), (10, 12), (12, 9, 10)])
def test_gradients_are_those_of_plain_products_through_narrow_and_wide_layers(hidden, num_inputs):
    net = networks.mlp(hidden, 2)
    rng = np.random.default_rng(0)

    def random(shape):
        return rng.normal(scale=0.5, size=shape).astype(np.float32)

    shapes = jax.eval_shape(net.init, jax.random.key(0), jnp.zeros(num_inputs))
    lanes, batch = jax.tree.map(lambda leaf: random((3, *leaf.shape)), shapes), random((7, num_inputs))

    def loss(apply):
        return lambda params, batch: jnp.sum(jnp.sin(jax.vmap(apply, (None, 0))(params, batch)))

    def gradients(apply):
        return jax.jit(jax.vmap(jax.grad(loss(apply), (0, 1)), (0, None)))(lanes, batch)

    assert_close(gradients(net.apply), gradients(plain_apply))
    # The derivative of all gradients along a direction in which each number has a part of its own.
    one = jax.tree.map(lambda leaf: leaf[0], lanes), batch
    along = jax.tree.map(lambda leaf: random(leaf.shape), one)

    def second(apply):
        return jax.jit(lambda at, along: jax.jvp(jax.grad(lambda at: loss(apply)(*at)), (at,), (along,)))(one, along)

    assert_close(second(net.apply), second(plain_apply))


@pytest.mark.parametrize("name", ["wide", "spread", "narrow"])
def test_each_form_of_a_layer_has_the_value_and_the_derivatives_of_a_plain_product(name):
    keys = jax.random.split(jax.random.key(4), 3)
    x, kernel, bias = (jax.random.normal(k, s) for k, s in zip(keys, [(5,), (5, 6), (6,)], strict=True))

    def ours(x, kernel, bias):
        if name == "wide":
            return networks.wide(x, networks.with_one(x), kernel, bias)
        return networks.spread(x, kernel, bias) if name == "spread" else networks.narrow(x, kernel.T, bias)

    def plain(x, kernel, bias):
        return x @ kernel + bias

    assert_close(ours(x, kernel, bias), plain(x, kernel, bias))
    for derive in (jax.jacfwd, jax.jacrev):
        assert_close(derive(ours, (0, 1, 2))(x, kernel, bias), derive(plain, (0, 1, 2))(x, kernel, bias))
