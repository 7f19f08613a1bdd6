"""What trainings until they were solved tell: the table, the page and the picture."""

import pytest

from benchmarks import __main__ as benchmarks
from benchmarks import beside, curves, page
from jaxq.bench import report, solved
from jaxq.bench.contest import Contender


def row(contender, case, together, seconds, env_steps, won, differs=None):
    told = {"together": together, "seconds": seconds, "env_steps": env_steps, "solved": won}
    return {
        "contender": contender,
        "case": case,
        "error": None,
        "rates": [1.0],
        "median": 1.0,
        "spread": 0.0,
        "notes": {"trainings": told, "differs": differs},
    }


@pytest.fixture
def result():
    steps = [1000 * (i + 1) for i in range(10)]
    peers = row("a peer", "dqn", 1, [float(i + 1) for i in range(10)], steps, [True] * 8 + [False] * 2, "its own loss")
    ours = row("jaxq, seeds together", "dqn", 2, [3.0, 6.0], [1000, 2000, 3000, 1000], [True, True, False, True])
    failed = {"contender": "another", "case": "dqn", "error": "no such library", "median": None, "notes": {}}
    other = row("jaxq, seeds together", "article-q", 1, [0.5], [70], [True])
    return {
        "suite": "solve",
        "unit": "seeds",
        "axis": "setting",
        "began": "2026-01-02T03:04:05Z",
        "seconds": 600,
        "machine": {"cpu": "a processor", "cores": 2, "system": "Linux"},
        "repeats": 1,
        "ratios": [],
        "versions": {"a peer": {"python": "3.11.0"}},
        "rows": [ours, other, peers, failed],
    }


def test_seeds_that_ran_together_share_the_seconds_by_their_steps(result):
    found = solved.trainings(result["rows"][0])
    assert found.seconds == [1.0, 2.0, 4.5, 1.5]
    assert found.solved_at_s == [1.0, 2.0, None, 1.5]
    assert found.solved_at_step == [1000, 2000, None, 1000]
    assert solved.trainings({"notes": {}}) is None


def test_the_table_tells_every_seed_and_who_did_not_run(result):
    head, ours, peers, failed, other = solved.table(result)
    assert head[:4] == ["contender", "setting", "seeds", "solved"]
    assert ours[:5] == ["jaxq, seeds together", "dqn", "4", "75 % [30.1, 95.4]", "1,500"]
    assert peers[2:6] == ["10", "80 % [49, 94.3]", "5,500 [2,000, -]", "5.5 [2, -]"]
    assert peers[6].startswith("5.5 [")
    assert failed == ["another", "dqn", "", "not run", "", "", ""]
    assert other[1:] == ["article-q", "1", "100 % [20.7, 100]", "70", "0.5", "0.5"]
    assert report.remarks(result) == ["a peer: its own loss."]
    twin = {**result["rows"][2], "contender": "its twin"}
    assert report.remarks({"rows": [*result["rows"], twin]}) == ["a peer; its twin: its own loss."]
    assert report.notes(result) == []
    assert (
        solved.table({"axis": "lanes", "rows": [failed_row for failed_row in result["rows"] if failed_row["error"]]})
        == []
    )


def test_the_page_and_the_picture(result, tmp_path, monkeypatch):
    bars = [beside.Bar("solve", "jaxq, seeds together", other, case="dqn") for other in ("a peer", "another")]
    monkeypatch.setattr(beside, "BARS", bars)
    monkeypatch.setitem(beside.PEERS_OF, "solve", [Contender("a peer", "", ())])
    text = page.page({"solve": result})
    ratio = (3 / 9) / (8 / 55)  # solved trainings per second
    assert f"| jaxq, seeds together | a peer | dqn | {ratio:.3g} |" in text
    assert "| jaxq, seeds together | another | dqn | no figure |" in text
    assert "| a peer | dqn | 10 | 80 % [49, 94.3] |" in text
    assert "![solve](benchmarks/solve.png)" in text
    assert "seed after seed for at least 600 s" in text
    monkeypatch.setitem(beside.PEERS_OF, "solve", [])
    assert "seed after seed" not in page.page({"solve": result})
    assert "- a peer: its own loss." in text
    assert "- another: no such library" in text
    curves.picture(result, tmp_path / "solve.png")
    assert (tmp_path / "solve.png").stat().st_size > 5000


def test_a_peer_that_solved_nothing_is_told_from_one_that_did_not_run(result, monkeypatch):
    bars = [beside.Bar("solve", "jaxq, seeds together", other, case="dqn") for other in ("a peer", "another")]
    monkeypatch.setattr(beside, "BARS", bars)
    told = result["rows"][2]["notes"]["trainings"]
    told["solved"] = [False] * len(told["solved"])
    peer, another = benchmarks.judged(result)["ratios"]
    assert (peer["ratio"], benchmarks.times(peer)) == (None, "the other solved none")
    assert (another["ratio"], benchmarks.times(another)) == (None, "no figure")
    assert peer["turns"] is None  # rates count seeds, solved or not


def test_a_curve_ends_at_the_share_of_all_seeds(result):
    at, share = solved.curve([5, None, 3, None])
    assert (at, share) == ([3, 5], [0.25, 0.5])
    assert solved.curve([None]) == ([], [])
