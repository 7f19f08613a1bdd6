"""Eligibility traces make the tables of textbook loops, and those of the forward views that they stand for."""

from __future__ import annotations

import numpy as np
import pytest
from numpy_agents import (
    ALPHA,
    DECAY,
    STEPS,
    VALUES,
    ByVisits,
    Constant,
    Lambda,
    NStep,
    TrueOnline,
    episodes,
    random_table,
    record,
    returns,
    run,
    tables,
)

TARGETS = ["greedy", "sarsa", "expected"]
RECORD, ALONE, START = record(1), record(2, 3 * STEPS, 1), random_table(1)
KINDS = [("accumulating", False), ("replacing", False), ("dutch", False), ("accumulating", True), ("replacing", True)]


def same(ours, theirs):
    np.testing.assert_allclose(ours, theirs, rtol=0, atol=1e-10)


def learner(target, kind, offline=False, **how):
    if kind == "dutch":
        return lambda q, alpha: TrueOnline(q, alpha, watkins=target == "greedy", **how)
    return lambda q, alpha: Lambda(q, alpha, kind, watkins=target == "greedy", offline=offline, **how)


@pytest.mark.parametrize("target", TARGETS)
@pytest.mark.parametrize(("kind", "offline"), KINDS)
def test_every_table_on_the_way_is_the_textbooks(target, kind, offline):
    ours = tables(RECORD, START, target=target, traces=kind, offline=offline)
    theirs = run(RECORD, START, learner(target, kind, offline), target)
    same(ours, theirs)
    assert np.max(np.abs(theirs[-1] - START)) > 0.3


@pytest.mark.parametrize(
    ("target", "kind", "offline"),
    [("greedy", "replacing", False), ("sarsa", "dutch", False), ("expected", "accumulating", True)],
)
def test_the_tables_are_the_same_however_experience_is_cut_into_updates(target, kind, offline):
    ours = tables(RECORD, START, chunk=12, target=target, traces=kind, offline=offline)
    same(ours, run(RECORD, START, learner(target, kind, offline), target)[11::12])


@pytest.mark.parametrize("target", TARGETS)
@pytest.mark.parametrize("kind", ["accumulating", "replacing", "dutch"])
def test_with_lambda_0_traces_are_one_step(target, kind):
    ours = tables(RECORD, START, hypers={"trace_decay": 0.0}, target=target, traces=kind, offline=False)
    same(ours, run(RECORD, START, NStep, target))


def test_every_kind_of_trace_and_lambda_makes_another_table():
    made = [
        run(RECORD, START, learner("sarsa", *kind, decay=decay), "sarsa")[-1] for kind in KINDS for decay in (0.5, 1.0)
    ]
    for i, one in enumerate(made):
        assert all(np.max(np.abs(one - other)) > 1e-3 for other in made[:i])


def test_watkins_traces_end_at_actions_that_are_not_greedy_and_ties_are_greedy():
    """A row of equals is greedy in all its actions, so that traces reach over it as SARSA's do."""
    it = ALONE._replace(r=np.where(ALONE.s_next == 0, 0.0, ALONE.r))
    even = np.zeros_like(START)
    first = run(it, even, learner("greedy", "accumulating"), "greedy")
    same(tables(it, even, target="greedy", traces="accumulating", offline=False), first)
    uncut = run(it, even, lambda q, alpha: Lambda(q, alpha, "accumulating", watkins=False), "greedy")
    assert np.max(np.abs(first[-1] - uncut[-1])) > 0.01


def test_a_tie_is_greedy():
    """Two steps, the second one from a row of equals: the first one's cell takes its share of the second's error."""
    it = record(3, 2, 1, ends=0.0)
    it.s[:, 0], it.a[:, 0], it.s_next[:, 0], it.r[:, 0] = (0, 1), (0, 2), (1, 2), (0.0, 1.0)
    tied, best = np.zeros_like(START), np.zeros_like(START)
    best[1, 0] = 1e-9
    for kind in ("accumulating", "replacing", "dutch"):
        ours = [tables(it, q, target="greedy", traces=kind, offline=False)[-1][0, 0] for q in (tied, best)]
        np.testing.assert_allclose(ours, [0.9 * DECAY * ALPHA, 0.0], atol=1e-8)


# Forward views of one episode, in explicit loops


def lambda_return(steps, v, goes_on, decay=DECAY):
    """(1 - lambda) sum_n lambda^(n-1) G^(n) + lambda^(K-1) G^(K); K is the first n after which ``goes_on`` is false."""
    total, weight = 0.0, 1.0
    for n in range(1, len(steps) + 1):
        last = n == len(steps) or not goes_on[n]
        total += weight * (1 if last else 1 - decay) * returns(steps[:n], v[n - 1])
        weight *= decay
        if last:
            return total
    raise AssertionError


def offline_lambda(episode, q, target, decay=DECAY):
    """The table after an episode of offline lambda-returns, all of the table at its start.

    Expected SARSA's lambda-return has control variates: G = r + gamma (v + lambda (G' - q')), Sutton and Barto, 12.8.
    """
    v, after = [VALUES[target](q, one) for one in episode], q.copy()
    goes_on = [target != "greedy" or q[one.s, one.a] == max(q[one.s]) for one in episode]
    for k, one in enumerate(episode):
        if target == "expected":
            later = 0.0
            for after_one, value in zip(reversed(episode[k:]), reversed(v[k:]), strict=True):
                later = after_one.r + after_one.discount * (value + decay * later) - q[after_one.s, after_one.a]
            after[one.s, one.a] += ALPHA * later
        else:
            after[one.s, one.a] += ALPHA * (lambda_return(episode[k:], v[k:], goes_on[k:], decay) - q[one.s, one.a])
    return after


def online_lambda(episode, q, target, decay=DECAY, alphas=Constant):
    """The table after an episode of the online lambda-return algorithm: Van Seijen et al., 2016, section 3.

    At each horizon the updates of the whole episode so far are done again from the episode's first table, with
    lambda-returns that are truncated there. A value is that of the table when its transition came.
    """
    table, v, goes_on = q, [], []
    for horizon, one in enumerate(episode, start=1):
        v.append(VALUES[target](table, one))
        goes_on.append(target != "greedy" or table[one.s, one.a] == max(table[one.s]))
        table, alpha = q.copy(), alphas()
        for k in range(horizon):
            cell = episode[k].s, episode[k].a
            alpha.visit(cell)
            g = lambda_return(episode[k:horizon], v[k:horizon], goes_on[k:horizon], decay)
            table[cell] += alpha(cell) * (g - table[cell])
    return table


# Traces are these


def at_cuts(it, tables_of):
    return tables_of[np.flatnonzero((it.terminated | it.truncated)[:, 0])]


def after_episodes(it, forward, target, decay):
    q, after = START.copy(), []
    for episode in episodes(it, sarsa=target == "sarsa"):
        q = forward(episode, q, target, decay)
        after.append(q)
    return after


@pytest.mark.parametrize("decay", [DECAY, 1.0])
@pytest.mark.parametrize("target", TARGETS)
def test_offline_traces_are_the_forward_view_of_lambda_returns(target, decay):
    ours = tables(ALONE, START, hypers={"trace_decay": decay}, target=target, traces="accumulating", offline=True)
    same(at_cuts(ALONE, ours), after_episodes(ALONE, offline_lambda, target, decay))
    between = ~(ALONE.terminated | ALONE.truncated)[1:, 0]
    np.testing.assert_array_equal(ours[1:][between], ours[:-1][between])


@pytest.mark.parametrize("decay", [DECAY, 1.0])
@pytest.mark.parametrize("target", TARGETS)
def test_dutch_traces_are_the_online_forward_view(target, decay):
    """Van Seijen et al., 2016, theorem 1: at the end of episodes here, and below at every time of one."""
    ours = tables(ALONE, START, hypers={"trace_decay": decay}, target=target, traces="dutch", offline=False)
    same(at_cuts(ALONE, ours), after_episodes(ALONE, online_lambda, target, decay))
    accumulating = tables(
        ALONE, START, hypers={"trace_decay": decay}, target=target, traces="accumulating", offline=False
    )
    assert np.max(np.abs(accumulating - ours)) > 0.01


@pytest.mark.parametrize("target", TARGETS)
def test_dutch_traces_are_the_online_forward_view_at_every_time(target):
    it = record(5, 3 * STEPS, 1, ends=0.0, cut_at=3 * STEPS - 1)
    ours = tables(it, START, target=target, traces="dutch", offline=False)
    (episode,) = episodes(it, sarsa=target == "sarsa")
    waits = int(target == "sarsa")  # what SARSA has learnt of a transition is seen one step later
    for horizon in (1, 2, 5, 20, 40):
        same(ours[horizon - 1 + waits], online_lambda(episode[:horizon], START, target))


def test_dutch_traces_by_visits_are_the_online_forward_view_with_the_step_size_of_each_visit():
    it = record(5, 3 * STEPS, 1, ends=0.0, cut_at=3 * STEPS - 1)
    parts = {"target": "expected", "traces": "dutch", "offline": False, "step_size": "visits"}
    ours = tables(it, START, hypers={"alpha_min": 0.1, "alpha_max": 0.8, "visit_power": 0.7}, **parts)
    (episode,) = episodes(it, sarsa=False)
    for horizon in (1, 2, 5, 20, 40):
        same(ours[horizon - 1], online_lambda(episode[:horizon], START, "expected", alphas=ByVisits))


# Monte Carlo


def monte_carlo(it, q, gamma, *, first_visits, alpha=None):
    """After each episode the returns of its visits, or of its first visits of each cell, from the end backwards."""
    q, counts, after = q.copy(), np.zeros_like(q), []
    for episode in episodes(it, sarsa=True, gamma=gamma):
        g, taken = VALUES["sarsa"](q, episode[-1]), []
        for k, one in reversed(list(enumerate(episode))):
            g = one.r + one.discount * g
            if not first_visits or all((one.s, one.a) != (other.s, other.a) for other in episode[:k]):
                taken.append(((one.s, one.a), g))
        old = q.copy()
        for cell, g in taken:
            counts[cell] += 1
            q[cell] += ALPHA * (g - old[cell]) if alpha is None else (g - q[cell]) / counts[cell]
        after.append(q.copy())
    return after


def test_offline_sarsa_with_lambda_1_is_every_visit_monte_carlo():
    ours = tables(ALONE, START, hypers={"trace_decay": 1.0}, target="sarsa", traces="accumulating", offline=True)
    same(at_cuts(ALONE, ours), monte_carlo(ALONE, START, 0.9, first_visits=False))


def test_with_replacing_traces_and_gamma_1_it_is_first_visit_monte_carlo():
    undiscounted = {"trace_decay": 1.0, "gamma": 1.0}
    ours = tables(ALONE, START, hypers=undiscounted, target="sarsa", traces="replacing", offline=True)
    theirs = monte_carlo(ALONE, START, 1.0, first_visits=True)
    same(at_cuts(ALONE, ours), theirs)
    assert np.max(np.abs(theirs[-1] - monte_carlo(ALONE, START, 1.0, first_visits=False)[-1])) > 0.01


def test_by_visits_it_is_the_mean_of_all_returns_so_far():
    """Whatever the table starts with: here 100, which no return is near."""
    mean = {"trace_decay": 1.0, "alpha_max": 1.0, "alpha_min": 0.0, "visit_power": 1.0}
    dead = ALONE._replace(terminated=ALONE.terminated | ALONE.truncated)
    parts = {"target": "sarsa", "traces": "accumulating", "offline": True, "step_size": "visits"}
    ours = at_cuts(dead, tables(dead, np.full_like(START, 100.0), hypers=mean, **parts))
    seen = {}
    for i, episode in enumerate(episodes(dead, sarsa=True)):
        for k, one in enumerate(episode):
            seen.setdefault((one.s, one.a), []).append(returns(episode[k:], 0.0))
        expected = np.full_like(START, 100.0)
        for cell, all_of_it in seen.items():
            expected[cell] = np.mean(all_of_it)
        same(ours[i], expected)
    assert len(seen) == START.size
    cut_short = tables(ALONE, START, hypers=mean, **parts)  # a truncation's return is completed by the table
    same(at_cuts(ALONE, cut_short), monte_carlo(ALONE, START, 0.9, first_visits=False, alpha="mean"))


# With other parts


@pytest.mark.parametrize(("target", "kind"), [("greedy", "replacing"), ("expected", "dutch")])
def test_traces_end_at_a_termination_through_which_the_agent_bootstraps(target, kind):
    ours = tables(RECORD, START, target=target, traces=kind, offline=False, bootstrap_terminal=True)
    same(ours, run(RECORD, START, learner(target, kind), target, bootstrap_terminal=True))
    assert not np.allclose(ours[-1], run(RECORD, START, learner(target, kind), target)[-1], atol=0.01)


@pytest.mark.parametrize(
    ("target", "kind", "offline"),
    [("greedy", "accumulating", False), ("expected", "replacing", False), ("sarsa", "accumulating", True)]
    + [(target, "dutch", False) for target in TARGETS],
)
def test_step_sizes_by_visits_are_those_of_each_cell(target, kind, offline):
    by = {"alpha_min": 0.1, "alpha_max": 0.8, "visit_power": 0.7}
    ours = tables(RECORD, START, hypers=by, target=target, traces=kind, offline=offline, step_size="visits")
    same(ours, run(RECORD, START, learner(target, kind, offline), target, ByVisits(0.1, 0.8, 0.7)))


@pytest.mark.parametrize(("kind", "offline"), KINDS)
def test_nothing_of_what_was_before_a_cut_is_in_what_is_learnt_after_it(kind, offline):
    whole, half = record(4, STEPS, cut_at=STEPS // 2 - 1), STEPS // 2
    later = type(whole)(*(np.roll(leaf, -half, axis=0) for leaf in whole))
    for target in TARGETS:
        over = tables(whole, START, target=target, traces=kind, offline=offline)
        afresh = tables(later, over[half - 1], target=target, traces=kind, offline=offline)
        np.testing.assert_array_equal(afresh[:half], over[half:])
