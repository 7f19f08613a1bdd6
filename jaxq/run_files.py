"""The files that a run writes, by name, and how they are written; nothing else in its directory is ever touched."""

from __future__ import annotations

import contextlib
import hashlib
import os
import re
from collections.abc import Iterator
from pathlib import Path

MANIFEST, LOCK, SWEEP, REPORT = "manifest.json", "lock", "sweep.toml", "report.md"
PARTS, POLICIES, CHECKPOINTS, QUARANTINE, PICTURES, TENSORBOARD = (
    "parts",
    "policies",
    "checkpoints",
    "quarantine",
    "pictures",
    "tensorboard",
)
FOLDERS = (PARTS, POLICIES, CHECKPOINTS)
#: Pictures beside the manifest; a report's are in a folder of their own.
DRAWN = ("learning_curves.png", "q_values.png", "episodes.png")
#: What ``jaxq record`` makes.
RECORDINGS = ("record.gif", "record.mp4")
_BATCH = re.compile(r"(\d{5,})(-(lanes|curves|episodes)\.parquet|\.safetensors)$")
_CHECKPOINT = re.compile(r"(\d+)-(\d+)\.safetensors$")
_PICTURE = re.compile(r"[\w.-]+\.(png|svg)$")
_EVENTS = re.compile(r"events\.out\.tfevents\.")


class WriteError(Exception):
    """The disk does not take what is written; the message says which file and why."""


def temporary(file: Path) -> Path:
    """The name under which a file is written before it takes its own."""
    return file.with_name(f".{file.name}.tmp")


def sha256(data: bytes) -> str:
    """SHA-256 as hexadecimal digits."""
    return hashlib.sha256(data).hexdigest()


def replace(target: Path, data: bytes) -> None:
    """Writes a file whole or not at all: under a temporary name, synced, renamed. Raises WriteError."""
    part = temporary(target)
    try:
        with open(part, "wb") as file:
            file.write(data)
            file.flush()
            os.fsync(file.fileno())
        part.replace(target)
    except OSError as error:
        with contextlib.suppress(OSError):
            part.unlink()
        raise WriteError(f"{target}: {error.strerror}") from None


@contextlib.contextmanager
def replacing(target: Path) -> Iterator[Path]:
    """The name under which a file is to be written within, piece by piece; at the end it is synced and takes its own.

    What was there stays, and the piece goes, where anything is raised. Raises WriteError for an OSError.
    """
    part = temporary(target)
    try:
        yield part
        with open(part, "rb+") as file:
            os.fsync(file.fileno())
        part.replace(target)
    except BaseException as error:
        with contextlib.suppress(OSError):
            part.unlink()
        if isinstance(error, OSError):
            raise WriteError(f"{target}: {error.strerror or error}") from None
        raise


def batch(file: Path) -> str | None:
    """The number of the batch that a file belongs to, as it is written; None for any other file."""
    match = _BATCH.match(file.name)
    return match[1] if match else None


def batches(path: Path) -> Iterator[tuple[str, Path]]:
    """The files of all batches with their batch's number, in its order."""
    found = [
        (number, file)
        for folder in (PARTS, POLICIES)
        for file in (path / folder).glob("*")
        if (number := batch(file)) and file.is_file()
    ]
    return iter(sorted(found, key=lambda entry: (int(entry[0]), entry[1])))


def committed(path: Path) -> set[str]:
    """The numbers of the batches whose ``lanes`` part, the commit, is there."""
    return {number for number, file in batches(path) if file.name.endswith("-lanes.parquet")}


def lanes_part(number: str) -> str:
    """The name of a batch's ``lanes`` part in its run's directory."""
    return f"{PARTS}/{number}-lanes.parquet"


def checkpoint(config: int, seed: int) -> str:
    """The name of a lane's checkpoint in its folder."""
    return f"{config}-{seed}.safetensors"


def lane_of(file: Path) -> tuple[int, int] | None:
    """The setting and seed of a checkpoint; None for any other file."""
    match = _CHECKPOINT.match(file.name)
    return (int(match[1]), int(match[2])) if match else None


def own_files(path: Path) -> list[Path]:
    """What a run has written."""
    named = [path / name for name in (MANIFEST, SWEEP, REPORT, *DRAWN, *RECORDINGS)]
    return [
        *(file for _, file in batches(path)),
        *(file for file in (path / CHECKPOINTS).glob("*") if lane_of(file) and file.is_file()),
        *(file for file in (path / PICTURES).glob("*") if _PICTURE.match(file.name) and file.is_file()),
        *(file for file in (path / TENSORBOARD).glob("*/events.*") if _EVENTS.match(file.name) and file.is_file()),
        *(file for file in (path / QUARANTINE).glob("*") if file.is_file()),
        *(file for file in named if file.is_file()),
    ]


def temporaries(path: Path) -> list[Path]:
    """What a kill in the middle of a write leaves."""
    named = [temporary(path / name) for name in (MANIFEST, SWEEP, REPORT, *DRAWN, *RECORDINGS)]

    def owned(file: Path) -> bool:
        final = Path(file.name[1:].removesuffix(".tmp"))
        return bool(batch(final) or lane_of(final) or (file.parent.name == PICTURES and _PICTURE.match(final.name)))

    return [file for file in named if file.is_file()] + [
        file for folder in (*FOLDERS, PICTURES) for file in (path / folder).glob(".*.tmp") if owned(file)
    ]


def foreign(path: Path) -> set[Path]:
    """The files under a directory that no run writes."""
    own = {*own_files(path), *temporaries(path), path / LOCK}
    return {file for file in path.rglob("*") if not file.is_dir()} - own
