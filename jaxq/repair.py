"""What a run directory needs before it goes on: half-written batches dropped, damaged ones put aside."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from jaxq import parts, run_files
from jaxq.manifest import Manifest, kin
from jaxq.plans import Plan
from jaxq.settings import shown

Say = Callable[[str], None]


def settle(path: Path, held: Manifest, say: Say) -> None:
    """Drops what a kill left of a batch before its commit, adopts a batch that the manifest does not know yet, and puts
    aside every batch of which a file is not as it was written: its lanes run again. ``held['files']`` is brought up to
    date; what was done to damage is said.
    """
    known = held["files"]
    listed = {number for name in known if (number := run_files.batch(Path(name)))}
    damaged: dict[str, str] = {}
    for name, digest in known.items():
        number, file = run_files.batch(Path(name)), path / name
        if number and not (file.is_file() and run_files.sha256(file.read_bytes()) == digest):
            damaged.setdefault(number, name)
    for number in sorted(run_files.committed(path) - listed):  # a kill came between the commit and the manifest
        if parts.commit(path, number) is None:
            damaged[number] = run_files.lanes_part(number)
        else:
            _adopt(path, number, held)
            listed.add(number)
    for number, file in list(run_files.batches(path)):
        if number not in listed and number not in damaged:
            file.unlink()  # never happened
        elif f"{file.parent.name}/{file.name}" not in known:
            damaged.setdefault(number, f"{file.parent.name}/{file.name}")
    for number, name in sorted(damaged.items()):
        quarantine(path, number)
        for gone in [name for name in known if run_files.batch(Path(name)) == number]:
            del known[gone]
        say(f"{path / name}: is damaged; its batch is put aside in {run_files.QUARANTINE}, its lanes run again")


def rebuild(path: Path, plan: Plan, held: Manifest, say: Say) -> None:
    """Fills a new manifest from the parts of a run whose own manifest is lost: batches that are as they were written,
    of the same sweep, and whose every lane is one of the plan's and in no other batch. Others are put aside.
    """
    sweep, taken = kin(plan.spec()), set[tuple[int, int]]()
    for number in sorted(run_files.committed(path)):
        about = parts.commit(path, number)
        lanes = _lanes(path / run_files.lanes_part(number), plan) if about and about["sweep"] == sweep else None
        if about and lanes and not lanes & taken:
            _adopt(path, number, held)
            held["rungs"] = max(held["rungs"], about["rungs"], key=len)  # all that was decided when it was written
            taken |= lanes
        else:
            quarantine(path, number)
            say(f"batch {number} of {path}: is damaged or of another sweep; put aside in {run_files.QUARANTINE}")


def _adopt(path: Path, number: str, held: Manifest) -> None:
    """Enters the files of a batch."""
    for found, file in run_files.batches(path):
        if found == number:
            held["files"][f"{file.parent.name}/{file.name}"] = run_files.sha256(file.read_bytes())


def quarantine(path: Path, number: str) -> None:
    """Moves the files of a batch aside."""
    for found, file in list(run_files.batches(path)):
        if found == number:
            put_aside(path, file)


def put_aside(path: Path, file: Path) -> None:
    """Moves a file to the quarantine, under a name that is not taken there."""
    folder = path / run_files.QUARANTINE
    folder.mkdir(exist_ok=True)
    target, i = folder / file.name, 0
    while target.exists():
        i += 1
        target = folder / f"{file.name}.{i}"
    file.replace(target)


def _lanes(part: Path, plan: Plan) -> set[tuple[int, int]] | None:
    """The settings and seeds of a part; None where one is not the plan's, with its hyperparameters."""
    table: pa.Table = pq.read_table(part)
    seeds, configs = set(plan.seeds), np.unique(table["config"].to_numpy())
    if len(configs) and (configs.min() < 0 or configs.max() >= len(plan.settings)):
        return None
    for row in table.to_pylist():
        wanted = plan.settings[row["config"]].flat()
        if row["seed"] not in seeds or any(_word(row.get(name)) != _word(value) for name, value in wanted.items()):
            return None
    return set(zip(table["config"].to_pylist(), table["seed"].to_pylist(), strict=True))


def _word(value: object) -> str:
    return json.dumps(shown(value) if isinstance(value, tuple) else value)
