"""What a run directory says of itself: what was asked for, with what, and the SHA-256 of every file."""

from __future__ import annotations

import json
import os
import platform
import uuid
from importlib import metadata
from pathlib import Path
from typing import Any

import jax

from jaxq import machine
from jaxq.plans import Plan, spec_hash

FORMAT = 3

Manifest = dict[str, Any]


class RunError(Exception):
    """A run directory that cannot be used; the message says why and what to do."""


class BrokenManifest(RunError):
    """A manifest that cannot be read, or lacks what it must have."""


def new(plan: Plan) -> Manifest:
    """The manifest of a run that has done nothing yet.

    ``files`` will hold the SHA-256 of each file by its path, ``agreed`` what the lanes depend on beside the spec,
    ``rungs`` what halving decided, ``mismatches`` what was otherwise when the run was resumed.
    """
    empty: Manifest = {"agreed": {}, "rungs": [], "mismatches": [], "files": {}}
    about = {"format": FORMAT, "id": uuid.uuid4().hex, "spec_hash": plan.hash(), "spec": plan.spec()}
    return about | _machine() | empty


def read(path: Path) -> Manifest:
    """The manifest in a file. Raises RunError for one of another version, BrokenManifest for a damaged one."""
    try:
        found = json.loads(path.read_text())
    except (OSError, ValueError):
        raise BrokenManifest(f"{path}: cannot be read; {_MEND}") from None
    kinds = {"format": int, "id": str, "spec_hash": str, "spec": dict, "versions": dict, "agreed": dict}
    kinds |= {"files": dict, "rungs": list, "mismatches": list}
    if not isinstance(found, dict) or not isinstance(found.get("format"), int):
        raise BrokenManifest(f"{path}: is no manifest; {_MEND}")
    if found["format"] != FORMAT:
        raise RunError(f"{path}: is not a manifest of this version; choose another --out")
    for name, kind in kinds.items():
        if not isinstance(found.get(name), kind):
            raise BrokenManifest(f"{path}: {name} is damaged; {_MEND}")
    if spec_hash(found["spec"]) != found["spec_hash"]:
        raise BrokenManifest(f"{path}: spec is damaged; {_MEND}")
    if not all(_is_rung(decided) for decided in found["rungs"]):
        raise BrokenManifest(f"{path}: rungs is damaged; {_MEND}")
    return found


def _is_rung(decided: Any) -> bool:
    """Whether it is what halving decided."""
    if not isinstance(decided, dict) or not isinstance(decided.get("rung"), int):
        return False
    lists = [decided.get(name) for name in ("kept", "stopped")]
    return all(isinstance(configs, list) and all(isinstance(one, int) for one in configs) for configs in lists)


_MEND = "--resume --allow-mismatch makes another of the parts that are sound, --overwrite starts anew"


def agree(path: Path, found: Manifest, plan: Plan, allow: bool) -> None:
    """Sees that a run was made as this one would be, since a lane's bits depend on all of it.

    What differs is in the message of the RunError that is raised. With ``allow`` it is noted in the manifest instead,
    unless rows that are there would no longer belong to the settings and seeds of the plan.
    """
    wanted = plan.spec()
    differences = [("spec", *pair) for pair in _spec_differences(found["spec"], wanted)]
    for name, here in _machine().items():
        there = found.get(name)
        if isinstance(here, dict) and isinstance(there, dict):
            differences += [
                (name, part, there.get(part), here.get(part))
                for part in dict.fromkeys((*there, *here))
                if there.get(part) != here.get(part)
            ]
        elif there != here:
            differences.append((name, name, there, here))
    if not differences:
        return
    said = "; ".join(f"{what} was {_short(was)}, is {_short(now)}" for _, what, was, now in differences)
    if any(kind == "spec" for kind, *_ in differences) and not _extends(found["spec"], wanted):
        raise RunError(f"{path}: was made for another sweep: {said}; choose another --out")
    if not allow:
        raise RunError(otherwise(path, said))
    note(found, [(what, was, now) for _, what, was, now in differences])
    found.update(_machine() | {"spec": wanted, "spec_hash": plan.hash()})


def otherwise(path: Path, said: str) -> str:
    """What is told of a run that was made otherwise."""
    return f"{path}: was made otherwise: {said}; choose another --out, or go on with --allow-mismatch"


def note(held: Manifest, differences: list[tuple[str, Any, Any]]) -> None:
    """Notes what is otherwise from here on, and after how many files."""
    held["mismatches"] += [
        {"what": what, "was": was, "is": now, "after_files": len(held["files"])} for what, was, now in differences
    ]


def _spec_differences(there: Manifest, here: Manifest) -> list[tuple[str, Any, Any]]:
    """What differs between two specs, by the names that a user gave."""
    found = [
        (name, there.get(name), here.get(name))
        for name in ("preset", "seeds", "root_seed", "prng", "halving", "rungs", "source")
        if there.get(name) != here.get(name)
    ]
    old, new = _by_name(there), _by_name(here)
    for name in dict.fromkeys((*old, *new)):
        if old.get(name) != new.get(name):
            found.append((name, old.get(name), new.get(name)))
    if not found and there != here:
        found.append(("settings", len(there.get("settings", [])), "in another order"))
    return found


def _by_name(spec: Manifest) -> dict[str, Any]:
    """Each hyperparameter with its value, or its different values in the order in which they come."""
    named = dict(spec.get("common", {}))
    for i, name in enumerate(spec.get("varied", [])):
        named[name] = list({json.dumps(row[i]): row[i] for row in spec["settings"]}.values())
    return named


def _extends(there: Manifest, here: Manifest) -> bool:
    """Whether every lane of one sweep is a lane of the other, under the same setting and seed."""
    if kin(there) != kin(here) or here.get("halving") is not None:
        return False
    old, new = rows(there), rows(here)
    seeds_there, seeds_here = seeds_of(there), seeds_of(here)
    return old == new[: len(old)] and seeds_there <= seeds_here


def kin(spec: Manifest) -> dict[str, Any]:
    """What a lane depends on beside its setting and its seed."""
    return {name: spec.get(name) for name in ("preset", "root_seed", "prng", "source", "halving", "rungs")}


def rows(spec: Manifest) -> list[dict[str, Any]]:
    """Every setting of a spec, every hyperparameter by name."""
    return [spec["common"] | dict(zip(spec["varied"], row, strict=True)) for row in spec["settings"]]


def seeds_of(spec: Manifest) -> set[int]:
    """The seed indices of a spec."""
    return set(range(spec["seeds"])) if isinstance(spec["seeds"], int) else set(spec["seeds"])


def _short(value: Any) -> str:
    text = str(value)
    return text if len(text) <= 80 else f"{text[:77]}..."


#: JAX's own settings that enter a lane's bits.
_SETTINGS = ("jax_enable_x64", "jax_default_matmul_precision", "jax_threefry_partitionable")


def _machine() -> Manifest:
    packages = ("jaxq", "jax", "jaxlib", "flax", "optax", "numpy")
    return {
        "versions": {name: metadata.version(name) for name in packages} | {"python": platform.python_version()},
        "cpu": machine.processor(),
        "device": jax.devices()[0].device_kind,
        "xla_flags": os.environ.get("XLA_FLAGS", ""),
        "jax_settings": {name: jax.config.values[name] for name in _SETTINGS},
    }
