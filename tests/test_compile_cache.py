"""The cache of compiled programs: it changes no bit, and nothing that happens to it breaks a run."""

import errno
import hashlib
import json
import os
import subprocess
import sys
from pathlib import Path

import jax
import jax.numpy as jnp
import jaxlib.version
import numpy as np
import pytest
import safetensors.numpy
from jax.experimental import serialize_executable

import jaxq
from jaxq import compile_cache, machine
from jaxq.cli import main
from jaxq.compile_cache import CompileCache, user_cache

SHORT = ["--max-episodes", "60", "--success-steps", "30", "--success-streak", "2"]
TINY = "--hidden 16 --batch-size 16 --learning-starts 32 --buffer-size 500 --max-env-steps 600".split()
NUMBERS = {"max_episodes": 40, "success_steps": 30, "success_streak": 2, "seeds": 2}


def traced(function=jnp.sin, arguments=1, **how):
    return jax.jit(function, keep_unused=True, **how).trace(*[jax.ShapeDtypeStruct((3,), jnp.float32)] * arguments)


def entries(root):
    return sorted(Path(root).rglob("*.executable"))


def everything(root):
    return [path for path in Path(root).rglob("*") if path.is_file()]


@pytest.fixture
def said():
    return []


@pytest.fixture
def cache(tmp_path, said):
    return CompileCache(tmp_path / "cache", say=said.append)


def sine(compiled):
    x = np.array([0.0, 1.0, 2.0], np.float32)
    return np.array_equal(compiled(x), jnp.sin(x))


# ---- the same bits ----


def command(where, out, *words, cache_dir, flags=()):
    """A sweep in a process of its own: its JSON, what it said, and its policies."""
    env = {**os.environ, "JAXQ_CACHE_DIR": str(cache_dir)}
    line = [sys.executable, "-m", "jaxq", *words, "--json", "--quiet", "--out", out, *flags]
    done = subprocess.run(line, cwd=where, env=env, capture_output=True, text=True, check=True)
    batches = [safetensors.numpy.load_file(path) for path in (where / out / "policies").iterdir()]
    policies = {name: array.tobytes() for batch in batches for name, array in batch.items()}
    talk = [line for line in done.stderr.splitlines() if not line.endswith(".png")]
    return json.loads(done.stdout), talk, policies


@pytest.mark.parametrize("words", [["q-learning", *SHORT], ["article-dqn", *TINY]], ids=["table", "network"])
def test_a_sweep_gives_the_same_bits_cold_warm_and_without_a_cache(words, tmp_path):
    words = ["sweep", *words, "--seeds", "3"]
    cold, _, cold_policies = command(tmp_path, "cold", *words, cache_dir=tmp_path / "cache")
    kept = {path: path.read_bytes() for path in entries(tmp_path / "cache")}
    warm, talk, warm_policies = command(tmp_path, "warm", *words, cache_dir=tmp_path / "cache")
    fresh, _, fresh_policies = command(tmp_path, "fresh", *words, cache_dir=tmp_path / "none", flags=["--no-cache"])
    assert [run["timing"]["cached"] for run in (cold, warm, fresh)] == [0, 1, 0]
    assert cold["lanes"] == warm["lanes"] == fresh["lanes"]
    assert cold_policies == warm_policies == fresh_policies
    assert talk == []  # XLA has nothing to say of what it loads
    assert kept
    assert {path: path.read_bytes() for path in entries(tmp_path / "cache")} == kept
    assert not (tmp_path / "none").exists()


def test_two_processes_at_once_share_a_cache(tmp_path):
    env = {**os.environ, "JAXQ_CACHE_DIR": str(tmp_path / "cache")}
    line = [sys.executable, "-m", "jaxq", "sweep", "q-learning", "--seeds", "2", *SHORT, "--json", "--out"]
    at_once = [
        subprocess.Popen([*line, name], cwd=tmp_path, env=env, stdout=subprocess.PIPE, stderr=subprocess.PIPE)
        for name in ("one", "two")
    ]
    rows = [json.loads(process.communicate()[0])["lanes"] for process in at_once]
    later, _, _ = command(tmp_path, "three", *line[3:-2], cache_dir=tmp_path / "cache")
    assert later["timing"]["cached"] == 1
    assert rows == [later["lanes"]] * 2
    assert set(everything(tmp_path / "cache")) == set(entries(tmp_path / "cache"))  # nothing half written


def test_a_loaded_program_still_consumes_what_was_donated(cache):
    program = traced(lambda x, y: (x + y, y), arguments=2, donate_argnums=0)
    cache.compile(program)
    loaded, hit = cache.compile(program)
    x, y = jnp.ones(3), jnp.ones(3)
    total, _ = loaded(x, y)
    assert hit
    assert x.is_deleted()
    assert not y.is_deleted()
    assert np.array_equal(total, [2, 2, 2])


def test_a_program_runs_where_programs_run_by_default(tmp_path):
    code = (
        "import jax, jax.numpy as jnp, pathlib\n"
        "from jaxq.compile_cache import CompileCache\n"
        "jax.config.update('jax_default_device', jax.devices()[1])\n"
        "cache = CompileCache(pathlib.Path('cache'))\n"
        "program = jax.jit(jnp.sin).trace(jax.ShapeDtypeStruct((3,), jnp.float32))\n"
        "made = [cache.compile(program) for _ in range(2)]\n"
        "print([(hit, compiled(jnp.zeros(3)).devices()) for compiled, hit in made])\n"
    )
    env = {**os.environ, "XLA_FLAGS": "--xla_force_host_platform_device_count=2"}
    line = [sys.executable, "-c", code]
    out = subprocess.run(line, cwd=tmp_path, env=env, capture_output=True, text=True, check=True).stdout
    assert out == "[(False, {CpuDevice(id=1)}), (True, {CpuDevice(id=1)})]\n"


# ---- what makes an entry ----


def test_each_structure_has_its_entries_and_a_number_makes_none(cache):
    def timing(**values):
        return jaxq.sweep("q-learning", cache=cache, **NUMBERS, **values).timing

    one = timing(double=False)
    after_one = set(entries(cache.root))
    both = timing(double=[False, True])
    after_both = set(entries(cache.root))
    again = timing(double=[False, True], gamma=[0.9, 0.99])
    assert after_one < after_both == set(entries(cache.root))
    max(after_one, key=lambda path: path.stat().st_size).unlink()
    partly = timing(double=[False, True])
    assert [(t.programs, t.cached) for t in (one, both, again, partly)] == [(1, 0), (2, 1), (2, 2), (2, 1)]


def test_the_library_keeps_nothing_unasked(tmp_path, monkeypatch):
    monkeypatch.setenv("JAXQ_CACHE_DIR", str(tmp_path / "cache"))
    uncached = jaxq.sweep("q-learning", **NUMBERS)
    assert not (tmp_path / "cache").exists()
    cached = jaxq.sweep("q-learning", cache=user_cache(), **NUMBERS)
    assert entries(tmp_path / "cache")
    for path in entries(tmp_path / "cache"):
        os.utime(path, (0, 0))
    again = jaxq.train("q-learning", cache=user_cache(), **{k: v for k, v in NUMBERS.items() if k != "seeds"})
    assert cached.lanes.equals(uncached.lanes)
    assert again.env_steps == cached.lanes["env_steps"][0].as_py()
    assert all(path.stat().st_mtime > 0 for path in entries(tmp_path / "cache"))  # all were used


def test_what_differs_in_program_arguments_or_results_is_another_entry(cache):
    shape = jax.ShapeDtypeStruct((3,), jnp.float32)
    jit = jax.jit(lambda x, y: x + y, keep_unused=True)
    programs = [
        traced(jnp.sin),
        traced(jnp.cos),
        traced(jnp.sin, donate_argnums=0),
        jit.trace(shape, shape),
        jit.trace(shape, y=shape),
        traced(lambda x: jnp.float32(1)),
        traced(lambda x: 1.0),
    ]
    texts = [program.lower().as_text() for program in programs]
    assert texts[3] == texts[4]
    assert texts[5] == texts[6]
    for program in programs:
        assert cache.compile(program)[1] is False
    loaded = [cache.compile(program) for program in programs]
    assert all(hit for _, hit in loaded)
    x = jnp.ones(3)
    assert np.array_equal(loaded[4][0](x, y=x), x + x)
    assert [loaded[i][0](x).weak_type for i in (5, 6)] == [False, True]


def test_programs_that_drop_different_arguments_are_not_taken_for_each_other(cache):
    shape = jax.ShapeDtypeStruct((3,), jnp.float32)
    programs = [jax.jit(function).trace(shape, shape) for function in (lambda x, y: x, lambda x, y: y)]
    assert programs[0].lower().as_text() == programs[1].lower().as_text()
    for program, wanted in zip(programs, (1.0, 2.0), strict=True):
        compiled, hit = cache.compile(program)
        assert not hit
        assert compiled(jnp.full(3, 1.0), jnp.full(3, 2.0))[0] == wanted


def test_a_program_that_calls_out_of_xla_is_not_kept(cache):
    seen = []
    program = traced(lambda x: jax.pure_callback(lambda v: (seen.append(1), v)[1], x, x))
    for count in (1, 2):
        compiled, hit = cache.compile(program)
        compiled(np.zeros(3, np.float32)).block_until_ready()
        assert not hit
        assert len(seen) == count
    library = jax.jit(jnp.linalg.inv, keep_unused=True).trace(jax.ShapeDtypeStruct((3, 3), jnp.float32))
    assert [cache.compile(library)[1] for _ in range(2)] == [False, False]
    assert not everything(cache.root)


def test_what_jax_itself_loaded_from_a_cache_is_not_kept(cache, tmp_path):
    # XLA writes such an executable without its code, and it fails when it is called.
    before = jax.config.jax_compilation_cache_dir
    jax.config.update("jax_compilation_cache_dir", str(tmp_path / "of_jax"))
    try:
        cache.compile(traced())
    finally:
        jax.config.update("jax_compilation_cache_dir", before)
    assert not everything(cache.root)
    cache.compile(traced())
    assert everything(cache.root)


NAME = (
    "import os, sys, jax, pathlib\n"
    "from jaxq.compile_cache import CompileCache\n"
    "{}\n"
    "print(CompileCache(pathlib.Path('unused')).directory.name)\n"
)


def directory_name(flags, between=""):
    env = {**os.environ, "XLA_FLAGS": flags}
    line = [sys.executable, "-c", NAME.format(between)]
    return subprocess.run(line, env=env, capture_output=True, text=True, check=True).stdout


def test_other_xla_flags_are_another_directory():
    fast = "--xla_cpu_enable_fast_math=true"
    late = f"jax.devices(); os.environ['XLA_FLAGS'] = '{fast}'"
    assert directory_name("") == directory_name("")
    assert directory_name("") != directory_name(fast)
    assert directory_name("", late) == directory_name("")  # XLA has read them by then
    assert directory_name("", "jax.config.update('jax_disable_most_optimizations', True)") != directory_name("")


@pytest.mark.parametrize(
    ("where", "what", "other"),
    [
        (jax, "__version__", "0.0.1"),
        (jaxlib.version, "__version__", "0.0.1"),
        (compile_cache, "__version__", "0.0.1"),
        (compile_cache.platform, "python_version", lambda: "3.0.1"),
        (machine, "instructions", lambda: "fewer"),
        (machine, "cores", lambda: 1000),
    ],
)
def test_another_version_or_machine_is_another_directory(where, what, other, tmp_path, monkeypatch):
    here = CompileCache(tmp_path).directory
    assert CompileCache(tmp_path).directory == here
    monkeypatch.setattr(where, what, other)
    assert CompileCache(tmp_path).directory != here
    assert CompileCache(tmp_path).directory.parent == here.parent


def test_instructions_are_the_same_whenever_they_are_read(monkeypatch):
    def instructions(mhz, flags):
        text = f"processor\t: 0\nmodel name\t: Some\ncpu MHz\t\t: {mhz}\nflags\t\t: {flags}\n\n"
        monkeypatch.setattr(machine, "_cpuinfo", (text + text.replace(": 0", ": 1")).splitlines)
        return machine.instructions()

    assert instructions(2000, "sse avx") == instructions(3000, "sse avx")
    assert instructions(2000, "sse avx") != instructions(2000, "sse")
    monkeypatch.setattr(machine, "_cpuinfo", list)
    assert machine.instructions()  # a system without /proc/cpuinfo
    assert machine.processor()


# ---- what may happen to it ----


def signed(path, content):
    """An entry that passes the check."""
    digest = hashlib.sha256()
    for part in (path.name.encode(), content):
        digest.update(len(part).to_bytes(8, "big") + part)
    return digest.digest() + content


DAMAGE = {
    "first byte": lambda data, path: bytes([data[0] ^ 1]) + data[1:],
    "a byte within": lambda data, path: data[:1000] + bytes([data[1000] ^ 1]) + data[1001:],
    "last byte": lambda data, path: data[:-1] + bytes([data[-1] ^ 1]),
    "empty": lambda data, path: b"",
    "short": lambda data, path: data[:10],
    "half": lambda data, path: data[: len(data) // 2],
    "longer": lambda data, path: data + b"\0",
    "no pickle": lambda data, path: signed(path, b"not this"),
    "another pickle": lambda data, path: signed(path, b"\x80\x04N."),  # None
}


@pytest.mark.parametrize("damage", DAMAGE)
def test_a_damaged_entry_is_removed_and_made_anew(damage, cache, said):
    cache.compile(traced())
    (path,) = entries(cache.root)
    path.write_bytes(DAMAGE[damage](path.read_bytes(), path))
    damaged = path.read_bytes()
    compiled, hit = cache.compile(traced())
    assert not hit
    assert sine(compiled)
    assert len(said) == 1
    assert str(path) in said[0]
    assert entries(cache.root) == [path]
    assert path.read_bytes() != damaged
    compiled, hit = cache.compile(traced())
    assert hit
    assert sine(compiled)
    assert len(said) == 1


def test_an_entry_under_the_name_of_another_is_not_used(cache, said):
    cache.compile(traced(jnp.sin))
    (path,) = entries(cache.root)
    cache.compile(traced(jnp.cos))
    (other,) = set(entries(cache.root)) - {path}
    path.write_bytes(other.read_bytes())
    compiled, hit = cache.compile(traced(jnp.sin))
    assert not hit
    assert sine(compiled)
    assert said == [f"compiling anew: {path} is damaged"]


def test_an_entry_is_checked_before_it_is_loaded(cache, monkeypatch):
    cache.compile(traced())
    (path,) = entries(cache.root)
    path.write_bytes(path.read_bytes()[:-1])
    loads = []
    monkeypatch.setattr(serialize_executable, "deserialize_and_load", lambda *a, **k: loads.append(a))
    cache.compile(traced())
    assert loads == []


def test_a_damaged_entry_is_one_line_when_asked_for_and_none_otherwise(tmp_path, capsys, monkeypatch):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("JAXQ_CACHE_DIR", "cache")
    words = ["sweep", "q-learning", "--seeds", "1", *SHORT, "--overwrite"]
    assert main(words) == 0
    for flag, lines in (("--verbose", 1), ("--no-progress", 0), ("--quiet", 0)):
        largest = max(entries("cache"), key=lambda path: path.stat().st_size)
        largest.write_bytes(b"")
        capsys.readouterr()
        assert main([*words, flag]) == 0
        talk = capsys.readouterr().err
        about = [line for line in talk.splitlines() if "anew" in line or "damaged" in line or "Traceback" in line]
        assert about == [f"compiling anew: {largest} is damaged"] * lines
        assert largest.stat().st_size > 0


def unwritable_file(root):
    root.write_text("in the way")


def unwritable_directory(root):
    root.mkdir(mode=0o500)
    if os.access(root, os.W_OK):
        pytest.skip("root may write anywhere")


@pytest.mark.parametrize("make", [unwritable_file, unwritable_directory])
def test_a_place_that_cannot_be_written_breaks_nothing(make, cache, said):
    make(cache.root)
    for function in (jnp.sin, jnp.cos):
        for _ in range(2):
            compiled, hit = cache.compile(traced(function))
            assert not hit
            assert compiled(np.zeros(3, np.float32)).shape == (3,)
    assert len(said) == 1


def test_entries_in_a_directory_that_may_only_be_read_are_used(cache, said, monkeypatch):
    def refuse(*_):
        raise PermissionError(errno.EACCES, "Permission denied")

    cache.compile(traced())
    monkeypatch.setattr(os, "utime", refuse)
    compiled, hit = cache.compile(traced())
    assert hit
    assert sine(compiled)
    (path,) = entries(cache.root)
    path.write_bytes(b"")
    for name in ("unlink", "replace"):
        monkeypatch.setattr(os, name, refuse)
    compiled, hit = cache.compile(traced())
    assert not hit
    assert sine(compiled)


@pytest.mark.parametrize("step", ["fsync", "replace"])
def test_a_write_that_fails_leaves_nothing_behind(step, cache, said, monkeypatch):
    def full(*_):
        raise OSError(errno.ENOSPC, "No space left on device")

    cache.compile(traced())
    (path,) = entries(cache.root)
    path.write_bytes(b"")
    monkeypatch.setattr(os, step, full)
    compiled, hit = cache.compile(traced())
    assert not hit
    assert sine(compiled)
    assert everything(cache.root) == []  # neither the damaged one nor half of another
    assert said[1:] == [f"compiled programs are not kept in {cache.directory}: No space left on device"]


def test_the_entries_used_longest_ago_are_evicted_and_nothing_else(tmp_path):
    theirs = tmp_path / "notes.executable"
    theirs.write_bytes(bytes(10**6))
    os.utime(theirs, (0, 0))
    old = tmp_path / "jaxq-0.0.0-of-another-version" / "old.executable"
    old.parent.mkdir()
    old.write_bytes(bytes(1000))
    os.utime(old, (1, 1))
    cache = CompileCache(tmp_path)
    functions = [jnp.sin, jnp.cos, jnp.tan]
    made = {}
    for age, function in enumerate(functions[:2]):
        before = set(entries(cache.directory))
        cache.compile(traced(function))
        (made[function],) = set(entries(cache.directory)) - before
        os.utime(made[function], (100 + age, 100 + age))
    assert old.exists()
    assert cache.compile(traced(jnp.sin))[1]  # used now, so the cosine is the older one
    size = made[jnp.sin].stat().st_size
    cache.limit_bytes = int(2.5 * size)
    cache.compile(traced(jnp.tan))
    left = set(entries(cache.directory))
    assert made[jnp.cos] not in left
    assert made[jnp.sin] in left
    assert len(left) == 2
    assert not old.exists()
    assert theirs.exists()


# ---- where it is ----


def place(monkeypatch, system="linux", **variables):
    for name in ("JAXQ_CACHE_DIR", "XDG_CACHE_HOME"):
        monkeypatch.delenv(name, raising=False)
    for name, value in {"HOME": "/home/me", **variables}.items():
        monkeypatch.setenv(name, value)
    monkeypatch.setattr(sys, "platform", system)
    found = user_cache()
    return found and str(found.root)


def test_it_is_where_caches_are(monkeypatch):
    assert place(monkeypatch) == "/home/me/.cache/jaxq"
    assert place(monkeypatch, "darwin") == "/home/me/Library/Caches/jaxq"
    assert place(monkeypatch, XDG_CACHE_HOME="/caches") == "/caches/jaxq"
    assert place(monkeypatch, XDG_CACHE_HOME="caches") == "/home/me/.cache/jaxq"
    assert place(monkeypatch, XDG_CACHE_HOME="/caches", JAXQ_CACHE_DIR="/mine") == "/mine"
    assert place(monkeypatch, JAXQ_CACHE_DIR="") is None


def test_a_user_without_a_home_has_none(monkeypatch):
    def lost():
        raise RuntimeError("Could not determine home directory.")

    monkeypatch.setattr(Path, "home", lost)
    assert place(monkeypatch) is None


def test_there_is_none_where_jax_cannot_have_one(monkeypatch, tmp_path, said):
    monkeypatch.setenv("JAXQ_CACHE_DIR", str(tmp_path))
    monkeypatch.setattr(jaxlib.version, "__version__", "0.10.1")
    assert user_cache(said.append) is None
    monkeypatch.setattr(jaxlib.version, "__version__", "0.10.2")
    assert user_cache(said.append) is not None
    monkeypatch.setattr(jax, "default_backend", lambda: "gpu")
    assert user_cache(said.append) is None
    assert len(said) == 2
