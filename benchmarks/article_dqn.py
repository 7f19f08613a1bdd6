"""Updates per second of ``article-dqn``: the engine, plain JAX, one wide ``vmap`` of our agent, and PyTorch.

    python -m benchmarks.article_dqn --torch-python PATH

``plain`` is ``jit(vmap(train))`` as one would write it (``benchmarks/plain_jax.py``); ``one_vmap`` is the package's own
agent without its engine and XLA settings. Each contender is a process of its own, so that both run under JAX's default
settings; they take turns, and the medians are compared. ``--torch-python`` is a Python that has torch and gymnasium;
without it that row is left out, and said so. Times exclude compilation; lanes: 128, all of them updating all the time.
"""

from __future__ import annotations

import argparse
import importlib.util
import json
import platform
import statistics
import subprocess
import sys
import time
from pathlib import Path

LANES = 128
UPDATES = 8 * 256  # whole segments, so that no lane waits for the end of one
PLAIN_UPDATES = 512
TORCH_STEPS = 3000


def engine(lanes: int) -> float:
    """The project's engine, as the command line runs it."""
    from jaxq import cpu

    cpu.tune()
    from jaxq import executables, programs
    from jaxq import lanes as engine
    from jaxq.plans import plan
    from jaxq.tally import Lane

    # Every lane makes the same number of updates and none ends early: no tail in the measurement.
    steps = 127 + UPDATES
    one = plan("article-dqn", max_env_steps=steps, max_episodes=10**6).settings[0]
    hypers = programs.hypers(one)
    built = executables.build(programs.program(one, "pcg4d"), hypers, "pcg4d")

    def run() -> float:
        queue = (Lane(0, seed, hypers) for seed in range(lanes))
        began = time.perf_counter()
        results = engine.run(built, queue, root_seed=0, impl="pcg4d", total=lanes)
        updates = sum(result.updates for result in results)
        return updates / (time.perf_counter() - began)

    run()
    return run()


def plain(lanes: int) -> float:
    """The tutorial's DQN in plain JAX, all lanes in one vmap."""
    import jax

    from benchmarks import plain_jax

    advance = jax.jit(jax.vmap(lambda state: plain_jax.segment(state, PLAIN_UPDATES)), donate_argnums=0)
    state = jax.jit(jax.vmap(plain_jax.init))(jax.random.split(jax.random.key(0), lanes))
    state, _ = jax.block_until_ready(advance(state))
    began = time.perf_counter()
    jax.block_until_ready(advance(state))
    return lanes * PLAIN_UPDATES / (time.perf_counter() - began)


def one_vmap(lanes: int) -> float:
    """The package's agent, all lanes in one vmap under JAX's default settings; keys are the unrolled threefry."""
    import jax
    import jax.numpy as jnp

    from jaxq import prng, programs
    from jaxq.plans import plan

    one = plan("article-dqn", max_episodes=10**6).settings[0]
    made, hypers = programs.program(one, "threefry").experiment, programs.hypers(one)
    init = jax.jit(jax.vmap(lambda seed: made.init(prng.key(seed), hypers)[0]))
    advance = jax.jit(jax.vmap(lambda state: made.advance(state, hypers)), donate_argnums=0)
    state, _ = jax.block_until_ready(advance(init(jnp.arange(lanes))))
    before = int(state.clock.updates.sum())
    began = time.perf_counter()
    state, _ = jax.block_until_ready(advance(state))
    return (int(state.clock.updates.sum()) - before) / (time.perf_counter() - began)


def tutorial() -> float:
    """The tutorial's loop in PyTorch, one training, as many threads as it takes."""
    path = Path(__file__).parent.parent / "tests" / "reference" / "tutorial_dqn.py"
    spec = importlib.util.spec_from_file_location("tutorial_dqn", path)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    sys.modules["tutorial_dqn"] = module
    spec.loader.exec_module(module)
    module.train(0, max_env_steps=300)
    began = time.perf_counter()
    _, _, updates = module.train(0, max_env_steps=TORCH_STEPS)
    return updates / (time.perf_counter() - began)


IN_JAX = {"engine": engine, "plain": plain, "one_vmap": one_vmap}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--lanes", type=int, default=LANES)
    parser.add_argument("--repeats", type=int, default=3)
    parser.add_argument("--torch-python", default=None, help="a Python with torch and gymnasium")
    parser.add_argument("--only", choices=[*IN_JAX, "tutorial"], help=argparse.SUPPRESS)
    args = parser.parse_args()
    if args.only:
        print(json.dumps(tutorial() if args.only == "tutorial" else IN_JAX[args.only](args.lanes)))
        return
    contenders = dict.fromkeys(IN_JAX, sys.executable)
    if args.torch_python:
        contenders["tutorial"] = args.torch_python
    else:
        print("the tutorial's PyTorch is left out: no --torch-python", file=sys.stderr)
    rates: dict[str, list[float]] = {name: [] for name in contenders}
    for repeat in range(args.repeats):
        for name, python in contenders.items():
            words = [python, __file__] if name == "tutorial" else [python, "-m", "benchmarks.article_dqn"]
            done = subprocess.run(
                [*words, "--only", name, "--lanes", str(args.lanes)], stdout=subprocess.PIPE, check=True, text=True
            )
            rates[name].append(float(done.stdout))
            print(f"repeat {repeat + 1}: {name} {rates[name][-1]:.0f} updates/s", file=sys.stderr)
    medians = {name: statistics.median(values) for name, values in rates.items()}
    result = {
        "lanes": args.lanes,
        "updates_per_s": rates,
        "median": medians,
        "engine_over": {name: medians["engine"] / medians[name] for name in medians if name != "engine"},
        "machine": platform.processor() or platform.machine(),
    }
    print(json.dumps(result))


if __name__ == "__main__":
    main()
