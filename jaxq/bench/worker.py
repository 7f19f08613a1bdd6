"""One contender's process: prepares cases and runs them for as long as it is told, over a pipe.

    python worker.py MODULE [ARGUMENT ...]

Nothing but the standard library is imported here, so that any Python can run this file for a contender that jaxq is
not installed for. MODULE is a dotted name or the path of a file, and offers

    ``prepare(case: str, *arguments: str) -> Callable[[], float]``: everything that is not to be timed; what it returns
    does one bout of work, waits for its end and returns the units of work done;
    ``PACKAGES``: the names of the packages whose versions belong beside the figures;
    ``device() -> str | None`` (optional): the accelerator, where this process does not itself run on it;
    ``tools() -> dict`` (optional): versions of what else the figures depend on;
    ``WARM_UP`` (optional): False when the first bout is not to be left out;
    ``notes(case) -> dict`` (optional): more to be told of the last bout.

Each line of stdin is a JSON request {"case", "seconds"}; each answer a line: {"rate", "bouts", "prepare_s", "notes",
"device"}, units per second over whole bouts that fill at least ``seconds``, or {"error"}. The first bout after
``prepare`` compiles and warms up; it counts as preparation. The first line of all tells {"versions"}, or {"error"} and
the end.
"""

from __future__ import annotations

import contextlib
import gc
import importlib
import importlib.util
import json
import os
import platform
import signal
import sys
import time
from collections.abc import Sequence
from importlib import metadata
from typing import Any


def main() -> None:
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C is for the one who asks, who then ends this process
    signal.signal(signal.SIGTERM, lambda *_: sys.exit())  # what a contender made on disk goes, and what it started
    answers = os.fdopen(os.dup(1), "w", buffering=1)
    os.dup2(2, 1)  # what a library prints is talk, not an answer

    def answer(**fields: Any) -> None:
        try:
            answers.write(json.dumps(fields) + "\n")
        except BrokenPipeError:  # nobody asks any more
            os.dup2(os.open(os.devnull, os.O_WRONLY), answers.fileno())
            sys.exit()

    try:
        del sys.path[0]  # this file's folder, whose names are not for others
        module = load(sys.argv[1])
        tools = getattr(module, "tools", dict)
        answer(versions={**versions(getattr(module, "PACKAGES", ())), **tools()})
    except Exception as error:
        answer(error=one_line(error))
        return
    prepared: dict[str, tuple[Any, float]] = {}
    for line in sys.stdin:
        request = json.loads(line)
        try:
            answer(**measure(module, prepared, request["case"], request["seconds"], sys.argv[2:]))
        except Exception as error:
            answer(error=one_line(error))


def measure(
    module: Any, prepared: dict[str, tuple[Any, float]], case: str, seconds: float, arguments: Sequence[str] = ()
) -> dict[str, Any]:
    """Units per second of one case, over whole bouts that fill at least ``seconds``."""
    if case not in prepared:
        began = time.perf_counter()
        bout = module.prepare(case, *arguments)
        if getattr(module, "WARM_UP", True):
            bout()
        prepared[case] = bout, time.perf_counter() - began
    bout, prepare_s = prepared[case]
    gc.collect()
    gc.disable()
    try:
        units, bouts, began = 0.0, 0, time.perf_counter()
        while bouts == 0 or time.perf_counter() - began < seconds:
            units += bout()
            bouts += 1
        elapsed = time.perf_counter() - began
    finally:
        gc.enable()
    told = module.notes(case) if hasattr(module, "notes") else {}
    device = getattr(module, "device", accelerator)()
    return {"rate": units / elapsed, "bouts": bouts, "prepare_s": prepare_s, "notes": told, "device": device}


def accelerator() -> str | None:
    """The accelerator that this contender's JAX runs on; None on a CPU, or where it has no JAX."""
    jax = sys.modules.get("jax")
    if jax is None or not hasattr(jax, "devices"):
        return None
    device = jax.devices()[0]
    return None if device.platform == "cpu" else str(device.device_kind)


def load(name: str) -> Any:
    """The module of a dotted name or of a file's path."""
    if not name.endswith(".py"):
        return importlib.import_module(name)
    spec = importlib.util.spec_from_file_location("contender", name)
    if spec is None or spec.loader is None:
        raise ImportError(f"{name} is not a module")
    module = importlib.util.module_from_spec(spec)
    sys.modules["contender"] = module
    spec.loader.exec_module(module)
    return module


def versions(packages: Any) -> dict[str, str]:
    """The version of this Python and of each package that is installed."""
    found = {"python": platform.python_version()}
    for package in packages:
        with contextlib.suppress(metadata.PackageNotFoundError):
            found[package] = metadata.version(package)
    return found


def one_line(error: Exception) -> str:
    """An exception as one line of at most 300 characters."""
    return f"{type(error).__name__}: {' '.join(str(error).split())}"[:300]


if __name__ == "__main__":
    main()
