"""The pages of the rules and of the environments, and the examples: what they say, compute and print is so."""

import ast
import importlib.util
import inspect
import re
import subprocess
import sys
import warnings
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxq import rules

DOCS = Path(__file__).parent.parent / "docs"
PAGE = (DOCS / "rules.md").read_text()
EXAMPLES = sorted(path.stem for path in (DOCS / "examples").glob("*.py"))
NUMBER = re.compile(r"-?\d[\d.,]*")


def example(name):
    spec = importlib.util.spec_from_file_location(name, DOCS / "examples" / f"{name}.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


@pytest.mark.parametrize("name", EXAMPLES)
def test_an_example_runs_without_warnings_and_prints_what_the_page_shows(name):
    path = f"docs/examples/{name}.py"
    done = subprocess.run(
        [sys.executable, "-W", "error", path], cwd=DOCS.parent, capture_output=True, text=True, timeout=120
    )
    assert (done.returncode, done.stderr) == (0, "")
    (shown,) = re.findall(rf"```text\n\$ python {path}\n(.+?)```", PAGE, re.DOTALL)
    assert NUMBER.sub("#", done.stdout) == NUMBER.sub("#", shown)
    numbers = [[float(number.replace(",", "")) for number in NUMBER.findall(text)] for text in (done.stdout, shown)]
    np.testing.assert_allclose(*numbers, rtol=0.5, atol=0.1)  # another machine rounds otherwise, and learns otherwise


def test_the_numpy_loop_learns_what_the_written_out_rule_learns(capsys):
    module = example("numpy_loop")
    q, seen = module.main()

    def again(end):
        table = np.zeros(q.shape)
        for one in seen:
            target = one.r_t + (0.0 if end(one) else module.GAMMA * table[one.s_t].max())
            table[one.s_tm1, one.a_tm1] += module.STEP_SIZE * (target - table[one.s_tm1, one.a_tm1])
        return table

    np.testing.assert_allclose(q, again(lambda one: one.terminated), rtol=1e-5, atol=1e-5)
    start = seen[0].s_tm1
    exact = -sum(module.GAMMA**k for k in range(13))
    assert abs(q[start].max() - exact) < 0.01
    # Were a time limit an end, the same steps would teach something else.
    assert abs(again(lambda one: one.terminated or one.truncated)[start].max() - exact) > 0.1
    assert "steps to the goal: 13\n" in capsys.readouterr().out


def test_the_flax_step_learns_with_the_gradient_of_the_online_network(capsys):
    module = example("flax_step")
    params, target_params, opt_state, batch, losses = module.main()
    assert np.mean(losses[-400:]) < np.mean(losses[:400]) / 3
    rows = np.arange(len(batch.a_tm1))
    best = np.argmax(module.network.apply(params, batch.obs_t), axis=1)
    target_tm1 = batch.r_t + batch.discount_t * module.network.apply(target_params, batch.obs_t)[rows, best]

    def written_out(params):
        return 0.5 * jnp.mean((module.network.apply(params, batch.obs_tm1)[rows, batch.a_tm1] - target_tm1) ** 2)

    grads, target_grads = jax.grad(module.loss_of, argnums=(0, 1))(params, target_params, batch)
    close = {"rtol": 1e-4, "atol": 1e-5}
    jax.tree.map(
        lambda ours, other: np.testing.assert_allclose(ours, other, **close), grads, jax.grad(written_out)(params)
    )
    assert all(not np.any(leaf) for leaf in jax.tree.leaves(target_grads))
    after, target_after, _, _ = module.train_step(params, target_params, opt_state, batch)
    for new, old, target in zip(*map(jax.tree.leaves, (after, target_params, target_after)), strict=True):
        assert np.any(new != old)
        np.testing.assert_allclose(target, module.TAU * new + (1 - module.TAU) * old, rtol=1e-5, atol=1e-6)


def test_the_scan_learns_what_a_loop_learns_and_longer_traces_learn_faster(capsys):
    module = example("scan")
    errors = np.asarray(module.main())
    assert errors.shape == (module.SEEDS, len(module.LAMBDAS), module.STEPS)
    seed = 3
    key = jax.random.split(jax.random.key(0), module.SEEDS)[seed]
    right = np.asarray(jax.random.bernoulli(key, shape=(module.STEPS,)))
    for lane, lambda_ in enumerate(module.LAMBDAS):
        v, trace, s, expected = np.zeros(21), np.zeros(21), 10, []
        for go_right in right:
            s_t = s + (1 if go_right else -1)
            reward = {0: -1.0, 20: 1.0}.get(s_t, 0.0)
            delta = reward + v[s_t] - v[s]  # the ends are never left, so their values stay 0
            trace[s] += 1
            v += module.STEP_SIZE * delta * trace
            trace *= lambda_
            s = s_t
            if s in (0, 20):
                s, trace = 10, np.zeros(21)
            expected.append(np.sqrt(np.mean((v[1:20] - np.linspace(-0.9, 0.9, 19)) ** 2)))
        np.testing.assert_allclose(errors[seed, lane], expected, rtol=1e-3, atol=1e-5)
    last = dict(zip(module.LAMBDAS, errors[:, :, -1].mean(axis=0), strict=True))
    untrained = np.sqrt(np.mean(np.linspace(-0.9, 0.9, 19) ** 2))
    assert untrained > last[0.0] > last[0.4] > last[0.8] > last[0.9]
    assert last[1.0] > last[0.9]


@pytest.mark.parametrize(
    ("page", "blocks_at_least", "values_at_least"), [("rules", 8, 20), ("environments", 4, 6), ("neighbours", 2, 4)]
)
def test_every_block_of_a_page_runs_and_gives_what_its_comments_say(page, blocks_at_least, values_at_least):
    text = (DOCS / f"{page}.md").read_text()
    blocks, names, checked = re.findall(r"```python\n(.+?)```", text, re.DOTALL), {}, 0
    for block in blocks:
        lines = block.splitlines()
        with warnings.catch_warnings():
            warnings.simplefilter("error")
            for statement in ast.parse(block).body:
                source = ast.get_source_segment(block, statement)
                if not isinstance(statement, ast.Expr):
                    exec(source, names)
                    continue
                given = eval(source, names)
                comment = re.search(r"  # (\[.*\]|-?[\d.]+)(,|$)", lines[statement.end_lineno - 1])
                assert comment, f"{source}: no comment says what it gives"
                np.testing.assert_allclose(given, ast.literal_eval(comment[1]), rtol=1e-5, atol=1e-6, err_msg=source)
                checked += 1
    assert len(blocks) >= blocks_at_least
    assert checked >= values_at_least


def test_every_public_name_has_a_row_under_its_module_with_its_arguments():
    sections = re.split(r"\n### `(\w+)`.*\n", PAGE)[1:]
    rows = {}
    for module, text in zip(sections[::2], sections[1::2], strict=True):
        for name, arguments in re.findall(r"^\| `(\w+)(?:\((.*?)\))?` \|", text, re.MULTILINE):
            rows[name] = (module, arguments)
    assert sorted(rows) == sorted(rules.__all__)
    for name, (module, arguments) in rows.items():
        public = getattr(rules, name)
        home = sys.modules[f"jaxq.rules.{module}"]
        assert getattr(home, name) is public
        if not name.isupper():
            assert public.__module__ == home.__name__
            parameters = inspect.signature(public).parameters.values()
            assert [part.split("=")[0] for part in arguments.split(", ") if part != "*"] == [p.name for p in parameters]
            for p in parameters:
                text = f"{p.name}={'IDENTITY_PAIR' if p.default is rules.IDENTITY_PAIR else p.default}"
                assert p.default is p.empty or text in arguments.split(", "), (name, p.name)
