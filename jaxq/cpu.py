"""XLA's settings for many small loops on a CPU, to be made before JAX starts."""

from __future__ import annotations

import os
import sys

#: XLA compiles a loop whose buffers are smaller than this into one function, with no dispatch between its operations.
#: Its own limit is 1 KiB; a group of table learners is some 70 KiB. Loops with networks in them are far above it.
SMALL_LOOP_BYTES = 2**17

FLAGS = (
    # One group of lanes is one core's work: neither a product nor an elementwise operation shared out among threads
    # should wait for the other groups. (XLA 0.10 shares out batched products a^T b all the same.)
    "--xla_cpu_multi_thread_eigen=false",
    "--xla_disable_hlo_passes=cpu-parallel-task-assigner",
    # XLA asks for half-width vectors by default; where a processor has no wider ones this says nothing.
    "--xla_cpu_prefer_vector_width=512",
    # The tiled emitter writes a lone elementwise operation through the stack, which is slower than a loop.
    "--xla_backend_extra_options="
    f"xla_cpu_small_while_loop_byte_threshold={SMALL_LOOP_BYTES},xla_cpu_disable_tiled_emitter=true",
)


def tune() -> bool:
    """Adds ``FLAGS`` to XLA_FLAGS unless the user has set them; False, and no change, when JAX has been imported.

    The command line calls this. In a program of your own, call it before the first import of jax.
    """
    if "jax" in sys.modules:
        return False
    given = os.environ.get("XLA_FLAGS", "")
    missing = [flag for flag in FLAGS if flag.split("=")[0] not in given]
    os.environ["XLA_FLAGS"] = " ".join([given, *missing]).strip()
    return True
