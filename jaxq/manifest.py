"""What a run directory says of itself: what was asked for, with what, and the SHA-256 of every file."""

from __future__ import annotations

import json
import os
import platform
from importlib import metadata
from pathlib import Path
from typing import Any

import jax

from jaxq import machine
from jaxq.plans import Plan

FORMAT = 2

Manifest = dict[str, Any]


class RunError(Exception):
    """A run directory that cannot be used; the message says why and what to do."""


def new(plan: Plan) -> Manifest:
    """The manifest of a run that has done nothing yet. ``files`` will hold the SHA-256 of each file by its path."""
    return {"format": FORMAT, "spec_hash": plan.hash(), "spec": plan.spec(), **_machine(), "widths": {}, "files": {}}


def read(path: Path) -> Manifest:
    """The manifest in a file. Raises RunError where there is none of this version."""
    try:
        found = json.loads(path.read_text())
    except (OSError, ValueError):
        raise RunError(f"{path}: cannot be read; --overwrite starts anew") from None
    kinds = {"format": int, "spec_hash": str, "spec": dict, "versions": dict, "widths": dict, "files": dict}
    if not isinstance(found, dict) or found.get("format") != FORMAT:
        raise RunError(f"{path}: is not a manifest of this version; choose another --out")
    for name, kind in kinds.items():
        if not isinstance(found.get(name), kind):
            raise RunError(f"{path}: {name} is damaged; --overwrite starts anew")
    return found


def agree(path: Path, found: Manifest, plan: Plan) -> None:
    """Raises RunError, with the difference, where a run was made otherwise: a lane's bits depend on all of these."""
    if found["spec_hash"] != plan.hash():
        raise RunError(f"{path}: was made for another sweep; choose another --out")
    for name, here in _machine().items():
        if found.get(name) != here:
            raise RunError(f"{path}: was made with {name} {found.get(name)}, this is {here}; choose another --out")


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
