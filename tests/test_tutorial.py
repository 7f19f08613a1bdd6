"""The tutorial's presets against runs of the tutorial's own code; tests/reference/*.json says how they were made."""

import json

import gymnasium
import numpy as np
import pytest
from conftest import REFERENCE
from scipy import stats

import jaxq
from jaxq import programs
from jaxq.envs import tutorial_edges
from jaxq.presets import preset, settle

pytestmark = pytest.mark.usefixtures("programs_are_compiled_once")

#: Two samples of the same distribution are called different once in a thousand.
ALPHA = 1e-3


@pytest.fixture(scope="module")
def swept():
    return jaxq.sweep("article-q", seeds=1000)


@pytest.mark.parametrize("counts", [(1, 1, 6, 3), (3, 4, 7, 8)])  # one bucket has no edges: a bound is not seen there
def test_article_q_has_the_bounds_of_gymnasiums_observation_space_and_of_the_tutorial(tutorial, counts):
    with gymnasium.make("CartPole-v1") as env:
        low, high = zip(*tutorial.state_bounds(env), strict=True)
    _, edges = programs.hypers(settle(preset("article-q"), num_buckets=counts)).env
    for ours, theirs in zip(edges, tutorial_edges(low, high, counts), strict=True):
        np.testing.assert_array_equal(ours, theirs)


def test_article_q_succeeds_as_often_as_the_tutorials_code(swept):
    theirs = json.loads((REFERENCE / "tutorial_tabular.json").read_text())
    assert len(theirs["solved"]) >= 300
    ours = [row["status"] == "solved" for row in swept.lanes.to_pylist()]
    table = [[sum(ours), len(ours) - sum(ours)], [sum(theirs["solved"]), len(theirs["solved"]) - sum(theirs["solved"])]]
    assert stats.fisher_exact(table).pvalue > ALPHA


@pytest.mark.parametrize(("theirs", "ours"), [("episodes", "solved_at_episode"), ("env_steps", "solved_at_step")])
def test_article_q_takes_as_long_as_the_tutorials_code(swept, theirs, ours):
    reference = json.loads((REFERENCE / "tutorial_tabular.json").read_text())
    expected = np.array(reference[theirs])[np.array(reference["solved"])]
    found = [row[ours] for row in swept.lanes.to_pylist() if row["status"] == "solved"]
    assert stats.ks_2samp(expected, found).pvalue > ALPHA
    # The comparison can tell: samples that are a twentieth apart are seen.
    assert stats.ks_2samp(expected * 1.05, found).pvalue < ALPHA


def test_termination_alone_sets_q_learning_apart(swept):
    right = jaxq.sweep("q-learning", seeds=200)
    found = [row["solved_at_episode"] for row in right.lanes.to_pylist() if row["status"] == "solved"]
    ours = [row["solved_at_episode"] for row in swept.lanes.to_pylist() if row["status"] == "solved"]
    assert stats.ks_2samp(found, ours).pvalue < ALPHA
