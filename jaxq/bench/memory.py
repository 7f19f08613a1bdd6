"""The peak of this process's resident memory between two moments; Linux tells and resets it, elsewhere it is None."""

from __future__ import annotations

from pathlib import Path

PROCESS = Path("/proc/self")


def reset_peak() -> bool:
    """Makes the memory of this moment the peak; whether that was possible."""
    try:
        (PROCESS / "clear_refs").write_text("5")
    except OSError:
        return False
    return True


def peak_mib() -> float | None:
    """The largest resident memory since the last reset, in MiB."""
    try:
        lines = (PROCESS / "status").read_text().splitlines()
    except OSError:
        return None
    kib = next((line.split()[1] for line in lines if line.startswith("VmHWM:")), None)
    return None if kib is None else round(int(kib) / 1024, 1)
