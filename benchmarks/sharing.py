"""Microseconds per update on a core: alone, beside a second worker, beside a second process.

    python -m benchmarks.sharing [article-dqn | article-q]

``alone``: one process that holds one core and runs one group. ``processes``: two of them, a core each, at once.
``workers``: one process with two workers, segment after segment as the engine runs them, without its books.
``products``, of article-dqn: the four products of 128 x 128 x 128 numbers of an update, and nothing else, on one core.
Medians over segments; repeats take turns. Linux only.
"""

from __future__ import annotations

import argparse
import json
import os
import statistics
import subprocess
import sys
import threading
import time

WARM_UP = 3
SEGMENTS = {"article-dqn": 30, "article-q": 1000}
#: Settings that never end.
ENDLESS = {
    "article-dqn": {"max_env_steps": 10**8, "max_episodes": 10**6},
    "article-q": {"success_streak": 10**6, "max_episodes": 10**6},
}


def segments(preset: str, workers: int) -> list[float]:
    """Microseconds per update of each segment, of ``workers`` groups side by side in this process."""
    from jaxq import cpu

    cpu.tune()
    import jax
    import numpy as np

    from jaxq import executables, prng, programs
    from jaxq.plans import plan

    one = plan(preset, **ENDLESS[preset]).settings[0]
    hypers = programs.hypers(one)
    built = executables.build(programs.program(one, "pcg4d"), hypers, "pcg4d")
    width = built.program.width
    group = jax.tree.map(lambda leaf: np.stack([leaf] * width), hypers)
    root = np.asarray(jax.random.key_data(prng.key(0, "pcg4d")))
    times: list[float] = []

    def work(first: int) -> None:
        state = jax.tree.map(lambda leaf: np.zeros(leaf.shape, leaf.dtype), built.empty)
        seeds = np.arange(first, first + width, dtype=np.uint32)
        state, _ = built.start(root, state, np.ones(width, bool), seeds, group)
        for segment in range(WARM_UP + SEGMENTS[preset]):
            began = time.perf_counter()
            state, log = jax.block_until_ready(built.advance(state, group))
            if segment >= WARM_UP:
                times.append((time.perf_counter() - began) / log.loss.size * 1e6)

    threads = [threading.Thread(target=work, args=(index * width,)) for index in range(workers)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    return times


def products() -> list[float]:
    """Microseconds for four products of 128 x 128 x 128 numbers of one lane, in groups of 4 lanes."""
    from jaxq import cpu

    cpu.tune()
    import jax
    import jax.numpy as jnp

    lanes, loops = 4, 256
    weights = [jax.random.normal(jax.random.key(i), (lanes, 128, 128)) / 12 for i in range(4)]

    def body(x: jax.Array, _: None) -> tuple[jax.Array, None]:
        for weight in weights:
            x = jnp.maximum(x @ weight, -1)  # so that no product is merged with the next
        return x / (1e-6 + jnp.abs(x[:, :1, :1])), None

    run = jax.jit(lambda x: jax.lax.scan(body, x, length=loops)[0])
    x = jax.block_until_ready(run(weights[0]))
    times = []
    for _ in range(SEGMENTS["article-dqn"]):
        began = time.perf_counter()
        jax.block_until_ready(run(x))
        times.append((time.perf_counter() - began) / (loops * lanes) * 1e6)
    return times


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("preset", nargs="?", default="article-dqn", choices=list(ENDLESS))
    parser.add_argument("--repeats", type=int, default=3)
    parser.add_argument("--only", choices=["group", "workers", "products"], help=argparse.SUPPRESS)
    parser.add_argument("--core", type=int, help=argparse.SUPPRESS)
    args = parser.parse_args()
    if args.only:
        if args.core is not None:
            os.sched_setaffinity(0, {args.core})  # before JAX starts: its thread pool is as large as this set
        times = products() if args.only == "products" else segments(args.preset, 2 if args.only == "workers" else 1)
        print(statistics.median(times))
        return
    cores = sorted(os.sched_getaffinity(0))
    if len(cores) < 2:
        parser.error("two cores are needed, one is there")
    first, second = cores[:2]
    contenders = {
        "products": [["products", first]],
        "alone": [["group", first]],
        "processes": [["group", first], ["group", second]],
        "workers": [["workers", None]],
    }
    if args.preset != "article-dqn":
        del contenders["products"]
    result: dict[str, list[float]] = {name: [] for name in contenders}
    for _ in range(args.repeats):
        for name, runs in contenders.items():
            started = []
            for only, core in runs:
                words = [sys.executable, "-m", "benchmarks.sharing", args.preset, "--only", str(only)]
                words += [] if core is None else ["--core", str(core)]
                started.append(subprocess.Popen(words, stdout=subprocess.PIPE, text=True))
            result[name].append(statistics.mean(float(run.communicate()[0]) for run in started))
            print(f"{name}: {result[name][-1]:.4g} us", file=sys.stderr)
    print(json.dumps({"us_per_update": result, "median": {name: statistics.median(v) for name, v in result.items()}}))


if __name__ == "__main__":
    main()
