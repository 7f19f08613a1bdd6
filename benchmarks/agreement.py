"""Whether a sweep of a tutorial preset agrees with runs of the tutorial's own code, in tests/reference/.

    jaxq sweep article-dqn --seeds 64 --json > rows.json
    python -m benchmarks.agreement article-dqn rows.json

Fisher's exact test compares the shares of seeds that succeed, Kolmogorov and Smirnov's the episodes and environment
steps to success of those that do.
"""

from __future__ import annotations

import argparse
import json
import statistics
from pathlib import Path

import numpy as np
from scipy import stats

REFERENCE = Path(__file__).parent.parent / "tests" / "reference"
FILES = {"article-q": "tutorial_tabular.json", "article-dqn": "tutorial_dqn.json"}


def compare(preset: str, lanes: list[dict]) -> dict:
    """The two samples side by side, with the p-values of the three tests."""
    theirs = json.loads((REFERENCE / FILES[preset]).read_text())
    won = np.array(theirs["solved"])
    ours = [lane for lane in lanes if lane["status"] == "solved"]
    table = [[len(ours), len(lanes) - len(ours)], [int(won.sum()), int((~won).sum())]]
    result = {"solved": table[0][0], "of": len(lanes), "their_solved": table[1][0], "their_of": len(won)}
    result["share_p"] = float(stats.fisher_exact(table).pvalue)
    for name, column in (("episodes", "solved_at_episode"), ("env_steps", "solved_at_step")):
        a, b = [lane[column] for lane in ours], np.array(theirs[name])[won]
        result[f"median_{name}"] = statistics.median(a)
        result[f"their_median_{name}"] = statistics.median(b.tolist())
        result[f"{name}_p"] = float(stats.ks_2samp(a, b).pvalue)
    return result


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("preset", choices=sorted(FILES))
    parser.add_argument("rows", type=Path, help="what jaxq sweep PRESET --json printed")
    args = parser.parse_args()
    print(json.dumps(compare(args.preset, json.loads(args.rows.read_text())["lanes"]), indent=1))


if __name__ == "__main__":
    main()
