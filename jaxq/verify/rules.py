"""Every rule against the same rule in float64 NumPy, on random arguments."""

from __future__ import annotations

import contextlib
import functools
from collections.abc import Callable, Iterator
from importlib import metadata
from typing import Any

import jax
import numpy as np

from jaxq import rules
from jaxq.verify import rule_cases
from jaxq.verify.checks import Found, Job

#: Largest error that is allowed, |ours - theirs| / max(1, |theirs|). A rule of float32 adds up at most some 20 terms of
#: size up to 10, each rounded to 6e-8 of its size; float64 has 1e-16 in the place of 6e-8. Both are some ten times what
#: is found, and far below what a wrong sign, index or weight makes.
ALLOWED = {"float32": 2e-5, "float64": 1e-12}
#: Random arguments of a rule, of those that a run asks for.
SHARE = 0.02
SEED = 0


Case = tuple[str, int, bool]
#: What each rule is looked at with: its name, which of the lengths, and whether arguments with a default are given.
CASES: tuple[Case, ...] = (
    *((name, i, True) for i in range(len(rule_cases.LENGTHS)) for name in rule_cases.NAMES),
    *((name, 0, False) for name in rule_cases.NAMES if rule_cases.defaults(name)),
)


def _cases(dtype: str) -> list[Case]:
    """The other lengths are for float32 alone: what they may upset is not a matter of precision."""
    return [case for case in CASES if dtype == "float32" or case[1] == 0]


def jobs(cases: int) -> Iterator[Job]:
    """A check per rule and precision, and those of the public names that are no rules."""
    against = f"numpy {metadata.version('numpy')}, float64"
    count = max(4, round(cases * SHARE))
    yield Job("rules", "every public name", against, _all_are_here)
    for dtype in ALLOWED:
        # All rules are one program, for the first of the checks to compile.
        batches = functools.cache(functools.partial(_batches, dtype, count))
        results = functools.cache(functools.partial(_results, dtype, batches))
        for name in rule_cases.NAMES:
            yield Job(
                "rules",
                f"{name} {dtype}",
                against,
                lambda name=name, dtype=dtype, batches=batches, results=results: _compared(  # type: ignore[misc]
                    name, dtype, batches(), results()
                ),
                cost=10 if name == rule_cases.NAMES[0] else 0.01,
            )
    slopes = functools.cache(_slopes)
    for name in rule_cases.NAMES:
        if rule_cases.error_of(name):
            yield Job("rules", f"{name} gradient", "0 where it stops", lambda name=name: _stopped(name, slopes()), 0.05)  # type: ignore[misc]
    yield Job("rules", "quantile_midpoints", against, _midpoints)
    yield Job("rules", "random_subset", against, lambda: _subsets(count))


def error(ours: Any, theirs: Any) -> np.ndarray:
    """|ours - theirs| / max(1, |theirs|), elementwise; not a number where only one of them is a number."""
    ours, theirs = np.asarray(ours, float), np.asarray(theirs, float)
    with np.errstate(invalid="ignore"):
        found = np.abs(ours - theirs) / np.maximum(1, np.abs(theirs))
    return np.where((ours == theirs) | (np.isnan(ours) & np.isnan(theirs)), 0, found)


def _batches(dtype: str, count: int) -> dict[Case, list[dict[str, np.ndarray]]]:
    """Random arguments, half of them with ties; fewer of other lengths than the first."""
    found = {}
    for case in _cases(dtype):
        name, which, given = case
        rng, lengths = np.random.default_rng([SEED, *case[1:], rule_cases.NAMES.index(name)]), rule_cases.LENGTHS[which]
        size = max(4, count // 4) if which or not given else count
        singles = [rule_cases.arguments(name, rng, dtype, lengths, ties=i % 2 == 1) for i in range(size)]
        left_out = set() if given else rule_cases.defaults(name)
        found[case] = [{key: value for key, value in one.items() if key not in left_out} for one in singles]
    return found


def _results(dtype: str, batches: Callable[[], dict[Case, list[dict[str, np.ndarray]]]]) -> dict[Case, Any]:
    """What all rules make of their batches in one compiled program, or the exception of one that could not run."""
    failed: dict[Case, Any] = {}
    stacked = {case: {key: np.stack([one[key] for one in rows]) for key in rows[0]} for case, rows in batches().items()}

    def everything(given: dict[Case, Any]) -> dict[str, Any]:
        made = {}
        for case, batch in given.items():
            rule = rule_cases.rule(case[0], given=case[2])
            try:
                made[case] = jax.vmap(lambda one, rule=rule: rule(**one))(batch)
            except Exception as error:
                failed[case] = error
        return {repr(case): result for case, result in made.items()}

    with jax.enable_x64(True) if dtype == "float64" else contextlib.nullcontext():
        named = jax.jit(lambda batch: everything({case: batch[repr(case)] for case in stacked}))(
            {repr(case): batch for case, batch in stacked.items()}
        )
    return {case: failed[case] if case in failed else named[repr(case)] for case in stacked}


def _compared(name: str, dtype: str, batches: dict[Case, list[Any]], results: dict[Case, Any]) -> Found:
    """A rule's batches through NumPy, one by one."""
    count, largest, detail = 0, 0.0, ""
    for case in (case for case in _cases(dtype) if case[0] == name):
        singles, ours = batches[case], results[case]
        if isinstance(ours, Exception):
            raise ours
        reference = rule_cases.reference(name, given=case[2])
        expected = np.stack([reference(**rule_cases.in_float64(single)) for single in singles])
        if ours.shape != expected.shape or ours.dtype != dtype:
            told = f"ours {ours.dtype}{list(ours.shape)}, theirs {expected.shape}"
            return Found(count, np.inf, ALLOWED[dtype], told)
        errors = error(ours, expected)
        count, worst = count + len(singles), float(np.max(errors))
        detail = detail or _first(singles, ours, expected, ~(errors <= ALLOWED[dtype]))
        largest = worst if not worst <= largest else largest
    return Found(count, largest, ALLOWED[dtype], detail)


def _slopes() -> dict[str, Any]:
    """The derivatives of each rule that makes an error, by every argument that is a real number, in one program."""
    given = {}
    for name in rule_cases.NAMES:
        if rule_cases.error_of(name):
            rng = np.random.default_rng([SEED, rule_cases.NAMES.index(name)])
            given[name] = rule_cases.arguments(name, rng, "float32", rule_cases.LENGTHS[0])

    def slopes(of: dict[str, Any], rest: dict[str, Any]) -> dict[str, Any]:
        def total(name: str, real: Any) -> Any:
            return jax.numpy.sum(rule_cases.rule(name)(**real, **rest[name]))

        return {name: jax.grad(functools.partial(total, name))(of[name]) for name in of}

    of = {name: rule_cases.floats(one) for name, one in given.items()}
    rest = {name: {key: one[key] for key in one if key not in of[name]} for name, one in given.items()}
    found: dict[str, Any] = jax.jit(slopes)(of, rest)
    return found


def _stopped(name: str, slopes: dict[str, Any]) -> Found:
    """The largest derivative by an argument that a target is made of; infinite where there is none by the others."""
    found = {argument: float(np.max(np.abs(slope))) for argument, slope in slopes[name].items()}
    own = found.pop(rule_cases.error_of(name))
    if not own > 0:
        return Found(1, np.inf, 0, f"none by {rule_cases.error_of(name)}")
    worst = max(found, key=lambda argument: found[argument])
    return Found(len(found), found[worst], 0, f"by {worst}" if found[worst] else "")


def _first(singles: list[dict[str, np.ndarray]], ours: Any, theirs: np.ndarray, off: np.ndarray) -> str:
    """The arguments of the first case that is off, and both results."""
    if not off.any():
        return ""
    i = int(np.argwhere(off)[0][0])
    given = ", ".join(f"{key} {value.tolist()}" for key, value in singles[i].items())
    return f"{given}: ours {np.asarray(ours[i]).tolist()}, theirs {theirs[i].tolist()}"


def _all_are_here() -> Found:
    """Counts public names that nothing here looks at, and names here that are not public."""
    wrong = {*rule_cases.NAMES, *rule_cases.OTHERS} ^ set(rules.__all__)
    return Found(len(rules.__all__), len(wrong), 0, ", ".join(sorted(wrong)))


def _midpoints() -> Found:
    counts = (1, 2, 5, 32, 200)
    off = [np.max(error(rules.quantile_midpoints(n), [(2 * i + 1) / (2 * n) for i in range(n)])) for n in counts]
    return Found(len(counts), max(off), ALLOWED["float32"])


def _subsets(count: int) -> Found:
    """Counts subsets that are not of their size, hold a row twice or a row that is not there."""
    rows, size = np.arange(10, dtype=np.float32).reshape(5, 2), 3
    keys = jax.random.split(jax.random.key(SEED), count)
    drawn = np.asarray(jax.vmap(lambda key: rules.random_subset(key, rows, size))(keys))
    known = {tuple(row) for row in rows.tolist()}
    wrong = [one.tolist() for one in drawn if len({tuple(row) for row in one.tolist()} & known) != size]
    return Found(count, len(wrong), 0, str(wrong[0]) if wrong else "")
