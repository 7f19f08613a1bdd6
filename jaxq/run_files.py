"""The files that a run writes, by name; nothing else in its directory is ever touched."""

from __future__ import annotations

import re
from collections.abc import Iterator
from pathlib import Path

MANIFEST, LOCK = "manifest.json", "lock"
PICTURES = ("learning_curves.png", "q_values.png", "episodes.png")
FOLDERS = ("parts", "policies")
_BATCH = re.compile(r"(\d{5,})(-(lanes|curves|episodes)\.parquet|\.safetensors)$")


def temporary(file: Path) -> Path:
    """The name under which a file is written before it takes its own."""
    return file.with_name(f".{file.name}.tmp")


def batch(file: Path) -> str | None:
    """The number of the batch that a file belongs to, as it is written; None for any other file."""
    match = _BATCH.match(file.name)
    return match[1] if match else None


def batches(path: Path) -> Iterator[tuple[str, Path]]:
    """The files of all batches with their batch's number, in its order."""
    found = [
        (number, file)
        for folder in FOLDERS
        for file in (path / folder).glob("*")
        if (number := batch(file)) and file.is_file()
    ]
    return iter(sorted(found, key=lambda entry: (int(entry[0]), entry[1])))


def own_files(path: Path) -> list[Path]:
    """What a run has written."""
    named = [path / name for name in (MANIFEST, *PICTURES)]
    return [*(file for _, file in batches(path)), *(file for file in named if file.is_file())]


def temporaries(path: Path) -> list[Path]:
    """What a kill in the middle of a write leaves."""
    named = [temporary(path / name) for name in (MANIFEST, *PICTURES)]
    return [file for file in named if file.is_file()] + [
        file
        for folder in FOLDERS
        for file in (path / folder).glob(".*.tmp")
        if batch(Path(file.name[1:].removesuffix(".tmp")))
    ]


def foreign(path: Path) -> set[Path]:
    """The files under a directory that no run writes."""
    own = {*own_files(path), *temporaries(path), path / LOCK}
    return {file for file in path.rglob("*") if not file.is_dir()} - own
