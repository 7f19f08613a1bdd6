"""C compiled on the spot, on all cores: the limits for environment steps and table updates.

ctypes lets go of the interpreter lock, so a thread per core runs its share of the environments or lanes.
"""

from __future__ import annotations

import ctypes
import functools
import itertools
import platform
import shutil
import subprocess
import tempfile
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np

from jaxq import machine
from jaxq.bench.tabular import UPDATES

PACKAGES = ("numpy",)
# What -ffast-math stands for, part by part: that flag itself links code that switches subnormal numbers off in the
# whole process which loads the library.
FAST = "-fno-math-errno -fno-trapping-math -fno-signed-zeros -fassociative-math -freciprocal-math -ffinite-math-only"
WIDE = ("-mprefer-vector-width=512",) if platform.machine() in ("x86_64", "AMD64") else ()
FLAGS = ("-O3", "-march=native", *WIDE, *FAST.split(), "-shared", "-fPIC")
BOUT = 2**22
BLOCK = 64
LANE_BYTES = 36 * 4 + 4 * 4 + 2 * 4 + 8


def prepare(case: str, what: str) -> Callable[[], float]:
    """``case`` environments or lanes; ``what`` is "env" or "table". Units: steps or updates.

    Raises RuntimeError without a C compiler.
    """
    count = int(case)
    workers = min(machine.cores(), count)
    shares = [len(range(i, count, workers)) for i in range(workers)]
    calls = [_env(share) if what == "env" else _table(share, i) for i, share in enumerate(shares)]
    pool = ThreadPoolExecutor(workers)

    def bout() -> float:
        return sum(pool.map(lambda call: call(), calls))

    return bout


def compiler() -> str:
    """The path of a C compiler; raises RuntimeError where there is none."""
    found = next((path for name in ("gcc", "cc") if (path := shutil.which(name))), None)
    if found is None:
        raise RuntimeError("no C compiler: install gcc")
    return found


def tools() -> dict[str, str]:
    """The compiler with its version, and its flags."""
    said = subprocess.run([compiler(), "--version"], capture_output=True, text=True, check=True).stdout
    return {"compiler": said.splitlines()[0], "with": " ".join(FLAGS)}


@functools.cache
def compile_c(name: str) -> ctypes.CDLL:
    """The shared library of ``name``.c beside this file; raises RuntimeError with what the compiler says against it."""
    with tempfile.TemporaryDirectory() as folder:
        built = Path(folder) / f"{name}.so"
        source = Path(__file__).with_name(f"{name}.c")
        words = [compiler(), *FLAGS, "-o", str(built), str(source), "-lm"]
        done = subprocess.run(words, capture_output=True, text=True)
        if done.returncode:
            raise RuntimeError(f"{words[0]}: {done.stderr.strip() or done.returncode}")
        return ctypes.CDLL(str(built))


def _env(count: int) -> Callable[[], float]:
    padded = -(-count // BLOCK) * BLOCK
    steps = max(128, BOUT // padded)
    rng = np.random.default_rng(0)
    arrays = [rng.uniform(-0.05, 0.05, padded).astype(np.float32) for _ in range(4)]
    arrays += [np.zeros(padded, np.int32), rng.integers(1, 2**32, padded, dtype=np.uint32)]
    function = compile_c("env").env_steps
    function.restype = ctypes.c_int64
    pointers = [array.ctypes.data_as(ctypes.c_void_p) for array in arrays]

    def call() -> float:
        _plausible(padded * steps, function(ctypes.c_int64(padded), ctypes.c_int64(steps), *pointers), 15, 40)
        return float(count * steps)  # a block steps whole, whatever part of it was asked for

    return call


def _table(count: int, worker: int) -> Callable[[], float]:
    library = compile_c("table")
    lanes = np.zeros((count, LANE_BYTES), np.uint8)
    pointer = lanes.ctypes.data_as(ctypes.c_void_p)
    library.table_updates.restype = ctypes.c_int64
    seeds = itertools.count(worker << 32, count)
    trainings = max(1, BOUT // (count * UPDATES))  # of each lane, so that a bout is not over at once

    def call() -> float:
        episodes = 0
        for _ in range(trainings):
            library.table_init(ctypes.c_int64(count), pointer, ctypes.c_uint64(next(seeds)))
            episodes += library.table_updates(ctypes.c_int64(count), ctypes.c_int64(UPDATES), pointer)
        made = count * UPDATES * trainings
        _plausible(made, episodes, 8, 501)
        return float(made)

    return call


def _plausible(steps: int, episodes: int, least: float, most: float) -> None:
    length = steps / max(1, episodes)
    if not least < length < most:
        raise RuntimeError(f"episodes of {length:.1f} steps: the C code is wrong")
