"""Aggregates over seeds and their intervals by rliable, the reference implementation of Agarwal et al., 2021.

Run it (five minutes) in an environment of its own to remake ``rliable.json``, which the tests compare jaxq.stats with:

    pip install rliable 'pandas<3'  # rliable 1.2 does not import with pandas 3
    python tests/reference/rliable.py > tests/reference/rliable.json

rliable's scores are [runs, tasks]; one task is one setting. Its median is of the tasks' means, so that the median over
seeds is had from one run of as many tasks as there are seeds, with the tasks resampled. Beside the 95 % interval
stand those whose tails are four standard errors wider and narrower, where the standard error is that of the share of
RESAMPLES resamples in a tail of 2.5 %: an interval from so few resamples has its ends between theirs.
"""

# ruff: noqa: NPY002 (rliable draws from NumPy's global generator)
import importlib.metadata
import json
import math
import platform
import sys

# this file has the library's name, and its folder comes first where modules are looked for
sys.path.pop(0)

import numpy as np
from rliable import library, metrics

RESAMPLES, REPETITIONS = 2000, 50_000
TAIL = 0.025
ERROR = math.sqrt(TAIL * (1 - TAIL) * (1 / RESAMPLES + 1 / REPETITIONS))
TAILS = {"interval": TAIL, "outer": TAIL - 4 * ERROR, "inner": TAIL + 4 * ERROR}

CASES = {
    "normal": lambda rng: (rng.normal(1, 1, 16), rng.normal(0, 2, 16)),
    "ties": lambda rng: (10.0 * rng.integers(30, 51, 10), 10.0 * rng.integers(20, 51, 13)),
    "skewed": lambda rng: (rng.lognormal(5, 1, 30), rng.lognormal(4.5, 1, 24)),
    "few": lambda rng: (rng.uniform(0, 500, 5), rng.uniform(0, 500, 5)),
}


def estimate(scores, aggregate, **options):
    """rliable's value and its interval for each of the tails, on the same resamples."""
    answer = {}
    for name, tail in TAILS.items():
        np.random.seed(0)
        values, intervals = library.get_interval_estimates(
            {"setting": scores},
            lambda *sample: np.array([aggregate(*sample)]),
            reps=REPETITIONS,
            confidence_interval_size=1 - 2 * tail,
            **options,
        )
        answer |= {"value": float(values["setting"][0]), name: intervals["setting"][:, 0].tolist()}
    return answer


def main():
    cases = {}
    for seed, (name, draw) in enumerate(CASES.items()):
        a, b = draw(np.random.default_rng(seed))
        cases[name] = {
            "seed": seed,
            "a": a.tolist(),
            "b": b.tolist(),
            "mean": estimate(a[:, None], metrics.aggregate_mean),
            "interquartile_mean": estimate(a[:, None], metrics.aggregate_iqm),
            "median": estimate(a[None], metrics.aggregate_median, task_bootstrap=True),
            "probability_of_improvement": estimate([a[:, None], b[:, None]], metrics.probability_of_improvement),
        }
    versions = {name: importlib.metadata.version(name) for name in ("rliable", "arch", "numpy", "scipy")}
    answer = {
        "made_by": "python tests/reference/rliable.py",
        "versions": {"python": platform.python_version(), **versions},
        "resamples": RESAMPLES,
        "tails": TAILS,
        "cases": cases,
    }
    json.dump(answer, sys.stdout)
    print()


if __name__ == "__main__":
    main()
