"""Our rules beside what is kept of rlax's; ``tests/reference/rlax_parity.py`` says how it was made, and compares."""

from __future__ import annotations

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from reference import rlax_parity as parity
from reference.rlax_rules import RULES

from jaxq import rules
from jaxq.rules import one_step


@pytest.mark.parametrize("title", RULES)
def test_a_rule_is_that_of_rlax(title):
    row = parity.beside_kept(title)
    assert row.right, row.line()


def test_every_rule_of_the_comparison_is_kept():
    with np.load(parity.KEPT) as kept:
        names = set(kept) - {"versions"}
        assert [one.split()[0] for one in kept["versions"]] == ["python", "rlax", "optax", "jax", "jaxlib", "numpy"]
    shapes = range(parity.KEPT_SHAPES)
    assert names == {f"{title}/{shape}/{part}" for title in RULES for shape in shapes for part in ("inputs", "truth")}


def test_the_page_tells_every_rule_and_every_difference():
    page = (parity.KEPT.parents[2] / "docs" / "parity.md").read_text()
    rows = [tuple(cell.strip() for cell in line.strip("|").split(" | ")) for line in page.splitlines()]
    assert {row[0] for row in rows if row[-1] == "same"} == set(RULES)
    assert set(parity.DIFFERENCES) <= set(rows)


@pytest.fixture
def q_learning_alone(monkeypatch):
    for title in set(RULES) - {"q_learning"}:
        monkeypatch.delitem(RULES, title)


@pytest.mark.usefixtures("q_learning_alone")
def test_a_rule_that_is_right_ends_with_0(capsys):
    assert parity.main(["--kept"]) == 0
    assert "1 rules, 0 off\n" in capsys.readouterr().out


def one_in_a_thousand(monkeypatch):
    right = rules.q_learning
    monkeypatch.setattr(rules, "q_learning", lambda *arguments: 1.001 * right(*arguments))


def no_number(monkeypatch):
    monkeypatch.setattr(rules, "q_learning", lambda *arguments: jnp.nan * one_step.q_learning(*arguments))


def gradient_through_the_target(monkeypatch):
    monkeypatch.setattr(one_step, "td_error", lambda q_tm1, a_tm1, target_tm1: target_tm1 - q_tm1[a_tm1])


@pytest.mark.usefixtures("q_learning_alone")
@pytest.mark.parametrize("broken", [one_in_a_thousand, no_number, gradient_through_the_target])
def test_a_rule_that_is_off_is_told_and_ends_with_1(broken, monkeypatch, capsys):
    broken(monkeypatch)
    assert parity.main(["--kept"]) == 1
    told = capsys.readouterr().out
    assert "| OFF  |" in told
    assert "1 rules, 1 off: q_learning\n" in told


def test_our_side_of_the_differences():
    for squash, slope in ((rules.signed_hyperbolic, 0.501), (rules.signed_parabolic, 1 / 0.501)):
        assert float(jax.grad(squash)(0.0)) == pytest.approx(slope)
    assert float(rules.signed_parabolic(1e-3)) == pytest.approx(0.0019970021, rel=1e-6)
    assert float(rules.signed_parabolic(1.0, eps=0.0)) == 3.0
    q, loss = jnp.array([1.0, 2.0]), jax.jit(rules.quantile_regression_loss)
    for action in (-1, 2):
        assert float(rules.q_learning(q, jnp.array(action), 1, 0.0, q)) == 1.0
    assert float(loss(q, q / 4, q + 4, jnp.array(1.0))) == 0.25 * 4 + 0.5 * 3
    with jax.enable_x64(True):
        ones = jnp.ones(3, jnp.float32)
        assert rules.n_step_bootstrapped_returns(ones, ones, ones, 2).dtype == jnp.float32
