"""The progress display on stderr: lanes done, solved, env steps per second, time left."""

from __future__ import annotations

import time
from typing import Any

from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn, TimeRemainingColumn

from jaxq.plans import Plan
from jaxq.shared import Progress as Done


class Display:
    """A bar over all lanes, where stderr is a terminal; elsewhere a line per program and one at the end."""

    def __init__(self, plan: Plan, *, show: bool, talk: bool):
        self.plan, self.talk = plan, talk
        self.console = Console(stderr=True)
        self.began: float | None = None
        self.last: Done | None = None
        self.earlier = 0  # lanes that the run directory held already
        self.bar = Progress(
            TextColumn("{task.description}"),
            BarColumn(),
            TextColumn("{task.fields[done]}/{task.fields[lanes]} lanes, {task.fields[solved]} solved"),
            TextColumn("{task.fields[speed]}"),
            TimeElapsedColumn(),
            TimeRemainingColumn(),
            console=self.console,
            disable=not (show and talk and self.console.is_terminal),
            transient=True,
        )
        self.task: Any = None

    def __enter__(self) -> Display:
        self.bar.start()
        lanes = self.plan.lanes
        self.task = self.bar.add_task(self.plan.name, total=lanes, done=0, lanes=lanes, solved=0, speed="")
        return self

    def __exit__(self, *error: object) -> None:
        self.bar.stop()
        if self.last is not None and self.began is not None:
            last, seconds = self.last, time.monotonic() - self.began
            earlier = f", {self.earlier} of them earlier" if self.earlier else ""
            self.say(
                f"{last.done} of {self.plan.lanes} lanes, {last.solved} solved, {last.diverged} diverged{earlier};"
                f" {last.env_steps} env steps{' now' if earlier else ''} in {seconds:.1f} s"
                + (f", {_rate(last.env_steps, seconds)}" if seconds >= 0.05 else "")
            )

    def say(self, text: str) -> None:
        """A line of talk above the bar."""
        if self.talk:
            self.bar.console.print(text, highlight=False, markup=False, soft_wrap=True)

    def compiling(self, number: int, programs: int) -> None:
        """Program ``number`` of ``programs`` is about to be compiled."""
        if self.bar.disable and programs > 1:
            self.say(f"{self.plan.name}: program {number} of {programs}")
        self.bar.update(self.task, description=f"{self.plan.name}: compiling {number}/{programs}")

    def rung(self, decided: dict[str, Any]) -> None:
        """Halving has compared the settings."""
        kept, stopped = len(decided["kept"]), len(decided["stopped"])
        self.say(f"{self.plan.name}: rung {decided['rung']}: {kept} of {kept + stopped} settings go on")

    def progress(self, done: Done) -> None:
        """Shows where the engine stands."""
        now = time.monotonic()
        if self.began is None:
            self.began, self.earlier = now, done.done
        self.last = done
        self.bar.update(
            self.task,
            description=self.plan.name,
            completed=done.share,
            done=done.done,
            solved=done.solved,
            speed=_rate(done.env_steps, now - self.began),
        )


def _rate(count: int, seconds: float) -> str:
    rate = count / max(seconds, 0.05)
    for unit, size in (("M", 1e6), ("k", 1e3)):
        if rate >= size:
            return f"{rate / size:.1f} {unit} env steps/s"
    return f"{rate:.0f} env steps/s"
