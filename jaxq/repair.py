"""What a run directory needs before it goes on: half-written batches dropped, damaged ones put aside."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from jaxq import parts, run_files
from jaxq.manifest import Manifest
from jaxq.plans import Plan, shown

Say = Callable[[str], None]


def settle(path: Path, held: Manifest, say: Say) -> None:
    """Drops what a kill left of a batch before its commit, adopts a batch that the manifest does not know yet, and puts
    aside every batch of which a file is not as it was written: its lanes run again. ``held['files']`` is brought up to
    date; what was done to damage is said.
    """
    known = held["files"]
    listed = {number for name in known if (number := run_files.batch(Path(name)))}
    committed = run_files.committed(path)
    damaged: dict[str, str] = {}
    for name, digest in known.items():
        number, file = run_files.batch(Path(name)), path / name
        if number and not (file.is_file() and run_files.sha256(file.read_bytes()) == digest):
            damaged.setdefault(number, name)
    for number, file in list(run_files.batches(path)):
        name = f"{file.parent.name}/{file.name}"
        if number not in committed and number not in listed:
            file.unlink()  # never happened
        elif number not in damaged and name not in known:  # a kill came between the commit and the manifest
            if parts.is_sound(file):
                known[name] = run_files.sha256(file.read_bytes())
            else:
                damaged[number] = name
    for number, name in sorted(damaged.items()):
        quarantine(path, number)
        for gone in [name for name in known if run_files.batch(Path(name)) == number]:
            del known[gone]
        say(f"{path / name}: is damaged; its batch is put aside in {run_files.QUARANTINE}, its lanes run again")


def rebuild(path: Path, plan: Plan, held: Manifest, say: Say) -> None:
    """Fills a new manifest from the parts of a run whose own manifest is lost: batches that can be read through and
    whose every row is of a setting and seed of the plan. Others are put aside.
    """
    for number in sorted(run_files.committed(path)):
        files = [file for n, file in run_files.batches(path) if n == number]
        if all(parts.is_sound(file) for file in files) and _belongs(path / f"parts/{number}-lanes.parquet", plan):
            for file in files:
                held["files"][f"{file.parent.name}/{file.name}"] = run_files.sha256(file.read_bytes())
        else:
            quarantine(path, number)
            say(f"batch {number} of {path}: is damaged or of another sweep; put aside in {run_files.QUARANTINE}")


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


def _belongs(part: Path, plan: Plan) -> bool:
    """Whether every lane of a part is one of the plan's, with its hyperparameters."""
    table: pa.Table = pq.read_table(part)
    if not {"config", "seed"} <= set(table.column_names):
        return False
    seeds, configs = set(plan.seeds), np.unique(table["config"].to_numpy())
    if len(configs) and (configs.min() < 0 or configs.max() >= len(plan.settings)):
        return False
    for row in table.to_pylist():
        wanted = plan.settings[row["config"]].flat()
        if row["seed"] not in seeds or any(_word(row.get(name)) != _word(value) for name, value in wanted.items()):
            return False
    return True


def _word(value: object) -> str:
    return json.dumps(shown(value) if isinstance(value, tuple) else value)
