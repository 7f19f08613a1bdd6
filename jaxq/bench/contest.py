"""Contenders on the same work in the same run: each in a process of its own, taking turns.

A machine's speed changes from minute to minute, so figures are compared only within a run: in each repeat every
contender runs every case once, one after the other, and a ratio is taken of medians over the repeats.
"""

from __future__ import annotations

import json
import os
import platform
import statistics
import subprocess
import sys
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from jaxq import machine

WORKER = Path(__file__).with_name("worker.py")


@dataclass(frozen=True)
class Contender:
    """Who runs: a name for the tables, a module (see ``worker``) with its arguments, the cases that it can do, and the
    Python that it runs in.

    ``environment`` is added to the process's variables; a variable set to None is removed. ``seconds`` is the least
    time of its turns where that is not the contest's: 0 for a fixed amount of work.
    """

    name: str
    module: str
    cases: Sequence[str]
    arguments: Sequence[str] = ()
    python: str = sys.executable
    environment: Mapping[str, str | None] = field(default_factory=dict)
    seconds: float | None = None


@dataclass
class Row:
    """A contender's rates in one case, a value per repeat, or the error that kept it from running."""

    contender: str
    case: str
    rates: list[float] = field(default_factory=list)
    prepare_s: float | None = None
    device: str | None = None  # the accelerator, None for a CPU
    error: str | None = None
    notes: dict[str, Any] = field(default_factory=dict)

    @property
    def median(self) -> float | None:
        """The median over the repeats; None without a figure."""
        return statistics.median(self.rates) if self.rates and not self.error else None

    def as_json(self) -> dict[str, Any]:
        """The row for a result file; ``spread`` is (largest - smallest) / median."""
        median = self.median
        spread = (max(self.rates) - min(self.rates)) / median if median else None
        return {**vars(self), "median": median, "spread": spread}


def contest(
    contenders: Sequence[Contender],
    *,
    repeats: int,
    seconds: float,
    on_turn: Callable[[int, int, str, float], None] | None = None,
) -> dict[str, Any]:
    """Runs all cases of all contenders ``repeats`` times in turns; what it returns is ready for JSON.

    A contender that cannot start or fails in a case gets rows with an ``error`` and is not asked again for that case.
    ``on_turn(done, total, what, least_seconds)`` is called before each turn. Raises ValueError for a count below 1.
    """
    if repeats < 1:
        raise ValueError(f"repeats: {repeats} must be at least 1")
    if not seconds >= 0:
        raise ValueError(f"seconds: {seconds} must not be negative")
    rows = {(c.name, case): Row(c.name, case) for c in contenders for case in c.cases}
    versions: dict[str, dict[str, str]] = {}
    began = time.time()
    with ExitStack() as stack:
        running = {c.name: stack.enter_context(_process(c)) for c in contenders}
        for contender in contenders:
            hello = running[contender.name]()
            versions[contender.name] = hello.get("versions", {})
            if "error" in hello:
                for case in contender.cases:
                    rows[contender.name, case].error = hello["error"]
        order = list(dict.fromkeys(case for c in contenders for case in c.cases))
        turns = [(case, c) for _ in range(repeats) for case in order for c in contenders if case in c.cases]
        for done, (case, contender) in enumerate(turns):
            row = rows[contender.name, case]
            if row.error:
                continue
            least = seconds if contender.seconds is None else contender.seconds
            if on_turn:
                on_turn(done, len(turns), f"{contender.name}, {case}", least)
            answer = running[contender.name]({"case": case, "seconds": least})
            if "error" in answer:
                row.error = answer["error"]
            else:
                row.rates.append(answer["rate"])
                row.prepare_s, row.notes, row.device = answer["prepare_s"], answer["notes"], answer["device"]
    return {
        "machine": {"cpu": machine.processor(), "cores": machine.cores(), "system": platform.system()},
        "began": time.strftime("%Y-%m-%dT%H:%M:%SZ", time.gmtime(began)),
        "took_s": round(time.time() - began, 1),
        "repeats": repeats,
        "seconds": seconds,
        "versions": versions,
        "rows": [row.as_json() for row in rows.values()],
    }


@contextmanager
def _process(contender: Contender) -> Iterator[Callable[..., dict[str, Any]]]:
    """The contender's process as a function from a request to its answer; without a request it waits for a line."""
    environment = dict(os.environ)
    for name, value in contender.environment.items():
        if value is None:
            environment.pop(name, None)
        else:
            environment[name] = value
    words = [contender.python, str(WORKER), contender.module, *contender.arguments]
    try:
        process = subprocess.Popen(words, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True, env=environment)
    except OSError as error:
        message = f"{contender.python} does not run: {error.strerror}"
        yield lambda request=None: {"error": message}
        return
    assert process.stdin is not None
    assert process.stdout is not None
    stdin, stdout = process.stdin, process.stdout

    def ask(request: Mapping[str, Any] | None = None) -> dict[str, Any]:
        try:
            if request is not None:
                stdin.write(json.dumps(request) + "\n")
                stdin.flush()
            line = stdout.readline()
        except BrokenPipeError:
            line = ""
        return json.loads(line) if line else {"error": f"the process ended with status {process.wait()}"}

    try:
        yield ask
        with suppress(BrokenPipeError):
            stdin.close()  # which ends it
        with suppress(subprocess.TimeoutExpired):
            process.wait(timeout=10)
    finally:
        process.terminate()
        with suppress(subprocess.TimeoutExpired):
            process.wait(timeout=5)  # compiled code does not listen
        process.kill()
        process.wait()
        with suppress(BrokenPipeError):  # what a dead process has not read
            stdin.close()
        stdout.close()
