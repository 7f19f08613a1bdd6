"""A function of the user's own is known by its source and by what is bound to it."""

import functools
import pathlib
import subprocess
import sys

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxq import sources


def made(held, default=1):
    def fn(key, hypers):
        return hypers.x * default, held

    return fn


class Scaled:
    def __init__(self, by):
        self.by = by

    def __call__(self, key, hypers):
        return hypers.x * self.by

    def method(self, key, hypers):
        return hypers.x - self.by


def itself(key, hypers):
    return hypers.x


def recursive():
    def down(n):
        return n and down(n - 1)

    return down


SAME_AND_OTHER = {
    "a closed-over number": (made(2.0), made(2.0), made(3.0)),
    "a number and a truth value": (made(1), made(1), made(True)),
    "an array": (made(np.arange(3)), made(np.arange(3)), made(np.arange(3) + 1)),
    "an array of another type": (made(jnp.zeros(3)), made(jnp.zeros(3)), made(jnp.zeros(3, int))),
    "a function in a closure": (made(made(1)), made(made(1)), made(made(2))),
    "what holds others": (made({"a": [1, (2,)]}), made({"a": [1, (2,)]}), made({"a": [1, (3,)]})),
    "how it is nested": (made([1, [2]]), made([1, [2]]), made([[1], 2])),
    "a part": (functools.partial(made, 1), functools.partial(made, 1), functools.partial(made, 2)),
    "an object": (Scaled(2), Scaled(2), Scaled(3)),
    "a method": (Scaled(2).method, Scaled(2).method, Scaled(3).method),
    "its way of being compiled": (made(1), jax.jit(made(1)), jax.jit(made(2))),
    "the source": (itself, itself, recursive()),
}


@pytest.mark.parametrize("what", SAME_AND_OTHER)
def test_equal_functions_have_one_digest_and_others_another(what):
    one, same, other = map(sources.digest, SAME_AND_OTHER[what])
    assert one == same
    assert other not in (None, one)


def test_a_default_counts():
    def early(key, hypers, scale=1.0):
        return hypers.x * scale

    before = sources.digest(early)
    early.__defaults__ = (2.0,)
    assert sources.digest(early) != before


def test_there_is_none_of_what_is_built_in():
    assert sources.digest(len) is None
    assert sources.digest(np.sin) is None


def test_another_process_finds_the_same():
    code = "import test_sources as t; from jaxq import sources; print(sources.digest(t.made({'a': (1.5, None)})))"
    done = subprocess.run(
        [sys.executable, "-c", code],
        cwd=pathlib.Path(__file__).parent,
        capture_output=True,
        text=True,
        check=True,
    )
    assert done.stdout.strip() == sources.digest(made({"a": (1.5, None)}))
