"""XLA's settings: they are made before JAX starts, never over the user's own, and XLA heeds them."""

import os
import subprocess
import sys

import jax
import jax.numpy as jnp

from jaxq import cpu

PRINTS_FLAGS = "from jaxq import cpu; import os; print(cpu.tune(), os.environ['XLA_FLAGS'])"


def flags_of_a_new_process(**environment):
    outside = {name: value for name, value in os.environ.items() if name != "XLA_FLAGS"}
    done = subprocess.run(
        [sys.executable, "-c", PRINTS_FLAGS], env={**outside, **environment}, capture_output=True, text=True, check=True
    )
    return done.stdout.split()


def test_all_flags_are_set_before_jax_starts():
    assert flags_of_a_new_process() == ["True", *cpu.FLAGS]


def test_flags_of_the_user_stay():
    own = "--xla_cpu_prefer_vector_width=256"
    changed, first, *others = flags_of_a_new_process(XLA_FLAGS=own)
    assert (changed, first) == ("True", own)
    assert others == [flag for flag in cpu.FLAGS if not flag.startswith("--xla_cpu_prefer_vector_width")]


def test_too_late_changes_nothing(monkeypatch):
    monkeypatch.setenv("XLA_FLAGS", "--own")
    assert not cpu.tune()
    assert os.environ["XLA_FLAGS"] == "--own"


def test_no_operation_is_cut_into_tasks_for_other_threads():
    compiled = jax.jit(lambda x: jnp.sin(x) * 2).lower(jnp.zeros((64, 128, 128))).compile().as_text()
    assert 'outer_dimension_partitions":["' not in compiled
