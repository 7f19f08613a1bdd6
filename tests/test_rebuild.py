"""A manifest that is made again of the parts takes what belongs to the sweep, and nothing else."""

import shutil

import faults
import pytest
from faults import Watched, assert_same, death

from jaxq import batches, parts, run_files

TABLES = faults.tables(gamma=[0.9, 0.99], seeds=4)


@pytest.fixture(autouse=True)
def _quick(monkeypatch):
    faults.quickly(monkeypatch)


@pytest.fixture
def whole(tmp_path):
    """A run that is complete."""
    Watched(tmp_path / "whole", TABLES)
    return tmp_path / "whole"


@pytest.fixture
def killed(tmp_path):
    """A run of which some lanes have rows."""
    with death(40), pytest.raises(faults.Killed):
        Watched(tmp_path / "killed", TABLES)
    return tmp_path / "killed"


@pytest.mark.parametrize(
    "other",
    [
        faults.tables(gamma=[0.9, 0.99], seeds=4, seed=1),
        faults.tables(gamma=[0.9, 0.99], seeds=4, halving=2),
        faults.tables(gamma=[0.5, 0.98], seeds=4),
        faults.networks(gamma=[0.9, 0.99], seeds=4),
    ],
    ids="root_seed halving gamma agent".split(),
)
def test_what_is_of_another_sweep_does_not_come_into_a_manifest_that_is_made_again(tmp_path, whole, killed, other):
    Watched(tmp_path / "other", other)
    path = shutil.copytree(killed, tmp_path / "run")
    foreign = brought(tmp_path / "other", path)
    (path / "manifest.json").unlink()
    again = Watched(path, TABLES, allow=True)
    assert [text.split()[1] for text in again.said[1:]] == sorted(foreign)
    assert all("put aside in quarantine" in text for text in again.said[1:])
    assert {run_files.batch(file) for file in (path / "quarantine").iterdir()} == foreign
    assert_same(path, whole)


def brought(other, path):
    """Copies the batches of another run whose numbers are free; their numbers."""
    numbers = run_files.committed(other) - run_files.committed(path)
    assert numbers
    for number, file in run_files.batches(other):
        if number in numbers:
            shutil.copy(file, path / file.parent.name)
    return numbers


def test_a_lane_that_two_batches_hold_is_there_once(tmp_path, whole, monkeypatch):
    monkeypatch.setattr(batches, "BATCH_LANES", 1)
    Watched(tmp_path / "other", TABLES)
    path = shutil.copytree(whole, tmp_path / "run")
    foreign = brought(tmp_path / "other", path)
    (path / "manifest.json").unlink()
    again = Watched(path, TABLES, allow=True)
    assert again.ran == []
    assert {run_files.batch(file) for file in (path / "quarantine").iterdir()} == foreign
    assert_same(path, whole)


@pytest.mark.parametrize(
    "other",
    [
        faults.tables(gamma=[0.9, 0.99], seeds=2),
        faults.tables(gamma=0.9, seeds=4),
        faults.tables(gamma=[0.9, 0.98], seeds=4),
        faults.tables(gamma=[0.99, 0.9], seeds=4),
        faults.tables(gamma=[0.9, 0.99, 0.5], seeds=5),
    ],
    ids="seeds settings gamma order more".split(),
)
def test_a_manifest_that_is_made_again_is_of_the_sweep_that_asks(tmp_path, monkeypatch, other):
    monkeypatch.setattr(batches, "BATCH_LANES", 1)  # so that some belong to both
    Watched(tmp_path / "run", TABLES)
    (tmp_path / "run" / "manifest.json").unlink()
    ran = Watched(tmp_path / "run", other, allow=True).ran
    Watched(tmp_path / "fresh", other)
    assert_same(tmp_path / "run", tmp_path / "fresh")
    both = [lane for lane in lanes(TABLES) if lane in lanes(other)]
    assert len(ran) == other.lanes - len(both)


def lanes(planned):
    """What tells a plan's lanes apart."""
    return [(i, one, seed) for i, one in enumerate(planned.settings) for seed in planned.seeds]


@pytest.mark.parametrize("damage", faults.DAMAGES)
@pytest.mark.parametrize(
    "name", ["parts/00000-lanes.parquet", "parts/00000-curves.parquet", "policies/00000.safetensors"]
)
def test_what_is_damaged_does_not_come_into_a_manifest_that_is_made_again(tmp_path, whole, name, damage):
    path = shutil.copytree(whole, tmp_path / "run")
    (path / "manifest.json").unlink()
    faults.DAMAGES[damage](path / name)
    assert len(Watched(path, TABLES, allow=True).ran) == 3
    assert_same(path, whole)


def test_a_flipped_bit_anywhere_in_a_commit_is_seen(tmp_path, whole):
    """The checksums of Parquet's pages leave out its footer, which is most of a small part."""
    path = shutil.copytree(whole, tmp_path / "run")
    part = path / run_files.lanes_part("00000")
    sound = part.read_bytes()
    assert parts.commit(path, "00000") is not None
    for place in range(0, len(sound), 37):
        data = bytearray(sound)
        data[place] ^= 1 << place % 8
        part.write_bytes(bytes(data))
        assert parts.commit(path, "00000") is None, place
