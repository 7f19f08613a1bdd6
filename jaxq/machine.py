"""What this machine is, as far as it decides what XLA makes of a program. Imports no jax."""

from __future__ import annotations

import contextlib
import os
import platform
import re
import subprocess
import sys
from pathlib import Path

#: What of /proc/cpuinfo is the same whenever it is read; clock rates are not.
_LASTING = re.compile(
    r"(vendor_id|cpu family|model|model name|stepping|flags|features|cpu (implementer|architecture|variant|part))\s*:",
    re.IGNORECASE,
)


def cores() -> int:
    """The cores this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def core_counts() -> tuple[int, ...]:
    """The powers of two below all cores that this process may use, and all of them."""
    return (*(2**i for i in range(cores().bit_length()) if 2**i < cores()), cores())


def processor() -> str:
    """The processor's name."""
    for line in _cpuinfo():
        if line.startswith("model name"):
            return line.split(":", 1)[1].strip()
    return platform.processor() or platform.machine()


def instructions() -> str:
    """The processor with the instructions it has, as the system lists them; equal where equal code may run."""
    # Sorted and without repetition: there may be cores of two kinds.
    lines = sorted({line for line in _cpuinfo() if _LASTING.match(line)})
    return "\n".join([platform.machine(), *(lines or [platform.processor(), _sysctl()])])


def _cpuinfo() -> list[str]:
    try:
        return Path("/proc/cpuinfo").read_text().splitlines()
    except OSError:
        return []


def _sysctl() -> str:
    """What macOS has in the place of /proc/cpuinfo."""
    if sys.platform != "darwin":
        return ""
    try:
        asked = ["sysctl", "machdep.cpu", "hw.optional"]
        return subprocess.run(asked, capture_output=True, text=True, timeout=10, check=False).stdout
    except (OSError, subprocess.SubprocessError):
        return ""


def available_memory() -> int | None:
    """Bytes that this process may still take; None where the system does not say."""
    free = []
    with contextlib.suppress(OSError, ValueError, StopIteration):
        lines = Path("/proc/meminfo").read_text().splitlines()
        free.append(1024 * int(next(line for line in lines if line.startswith("MemAvailable:")).split()[1]))
    with contextlib.suppress(OSError, ValueError):  # a container's share; "max" is no number
        group = Path("/sys/fs/cgroup")
        free.append(int((group / "memory.max").read_text()) - int((group / "memory.current").read_text()))
    return min(free, default=None)
