"""Every public rule says what it is, its equation, shapes, errors and source, and shows itself at work."""

import inspect
import re

import pytest

from jaxq import rules

FUNCTIONS = [name for name in rules.__all__ if inspect.isfunction(getattr(rules, name))]


def test_all_that_is_public_is_listed_in_order():
    public = {name for name, value in vars(rules).items() if not name.startswith("_") and not inspect.ismodule(value)}
    assert set(rules.__all__) == public
    assert rules.__all__ == sorted(rules.__all__)


@pytest.mark.parametrize("name", FUNCTIONS)
def test_a_rule_is_documented_in_full(name):
    text = inspect.getdoc(getattr(rules, name))
    sentence = " ".join(text.split("\n\n")[0].split())
    assert re.fullmatch(r"\w(?:[^.]|\.(?=\w))*\.", sentence), f"{name}: one sentence first, got {sentence!r}"
    assert re.search(r"[Ss]hapes", text), f"{name}: no shapes"
    assert re.search(r" \+?= |<-|h\(", text), f"{name}: no equation"
    assert re.search(r"Raises|errors as|elementwise", text), f"{name}: no errors"
    assert re.search(r"(19|20)\d\d|et\s+al\.", text), f"{name}: no source"
    assert ">>>" in text, f"{name}: no example"


@pytest.mark.parametrize("name", FUNCTIONS)
def test_arguments_are_named_as_in_the_field(name):
    words = {"q", "a", "r", "discount", "v", "lambda", "dist", "tau", "probs", "pi", "mu", "c", "z", "target", "online"}
    words |= {"cut", "step", "trace", "table", "state", "action", "amount", "decay", "huber", "action_gap", "tx"}
    words |= {"n", "x", "eps", "key", "size", "count", "updates", "period", "temperature", "munchausen", "clip"}
    for argument in inspect.signature(getattr(rules, name)).parameters:
        assert any(argument == word or argument.startswith(f"{word}_") for word in words), f"{name}: {argument}"
