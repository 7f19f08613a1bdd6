"""Compiled programs on disk, so that XLA compiles a structure once per machine and not once per run.

An entry is the executable of one lowered program. It is named after what XLA is given, the program's text; its
directory after all else that decides what XLA makes of that: versions, XLA's and JAX's settings, the processor. So a
program is traced and lowered every time, which costs half a second, and nothing that tracing reads (sources, settings,
a user's own functions) has to be guessed at.

The cache may be lost or damaged at any time: an entry is checked before it is used, whatever is wrong with it is
removed, and whatever cannot be read or written costs a compilation and nothing else. Loading an entry runs what it
holds, so whoever can write to the cache can run code as its user: it is the user's own.
"""

from __future__ import annotations

import contextlib
import hashlib
import os
import platform
import re
import sys
import tempfile
from collections.abc import Callable
from pathlib import Path

import jax
import jaxlib.version
from jax.experimental import serialize_executable

from jaxq import __version__, machine

#: Above this, the entries that were used longest ago are removed.
LIMIT_BYTES = 500 * 10**6

#: Overrides the place; empty turns the cache off.
VARIABLE = "JAXQ_CACHE_DIR"

#: Before it, every entry that was loaded made XLA complain on stderr of its own tuning hints (openxla/xla 44565).
OLDEST_JAXLIB = (0, 10, 2)

_SUFFIX = ".executable"
_DIGEST = hashlib.sha256().digest_size

Say = Callable[[str], None]


class CompileCache:
    """The cache in ``root``, which need not exist. ``say`` is told, a line each, of entries that could not be used."""

    def __init__(self, root: Path, *, limit_bytes: int = LIMIT_BYTES, say: Say | None = None):
        self.root, self.limit_bytes = root, limit_bytes
        self.directory = root / _surroundings()
        self._say: Say = say or (lambda _: None)
        self._writable = True

    def compile(self, traced: jax.stages.Traced) -> tuple[jax.stages.Compiled, bool]:
        """The executable of a traced program, and whether it came from the cache.

        Raises what ``traced.lower().compile()`` raises. A program that drops unused arguments (``jax.jit`` does so
        without ``keep_unused``) or calls out of XLA is compiled and not kept.
        """
        lowered = traced.lower()
        text = lowered.as_text()
        if not _is_whole(text, lowered):
            return lowered.compile(), False
        # The text has neither names of arguments nor weak types.
        entry = _sha256(text, repr(lowered.args_info), repr(traced.jaxpr.out_avals)).hex()
        path = self.directory / f"{entry}{_SUFFIX}"
        found = self._load(path, lowered)
        if found is not None:
            return found, True
        compiled = lowered.compile()
        self._keep(path, compiled)
        return compiled, False

    def _load(self, path: Path, lowered: jax.stages.Lowered) -> jax.stages.Compiled | None:
        try:
            data = path.read_bytes()
        except (FileNotFoundError, NotADirectoryError):
            return None
        except OSError as error:
            self._discard(path, f"cannot be read ({error.strerror})")
            return None
        digest, content = data[:_DIGEST], data[_DIGEST:]
        if digest != _sha256(path.name, content):
            self._discard(path, "is damaged")
            return None
        (device,) = jax.device_put(0).devices()  # where programs run by default
        try:
            loaded = serialize_executable.deserialize_and_load(
                content, lowered.in_tree, lowered.out_tree, execution_devices=[device]
            )
        except Exception as error:  # of JAX, of pickle, of whatever it holds
            self._discard(path, f"cannot be loaded ({type(error).__name__})")
            return None
        with contextlib.suppress(OSError):
            os.utime(path)  # it was used now
        return loaded

    def _discard(self, path: Path, why: str) -> None:
        self._say(f"compiling anew: {path} {why}")
        with contextlib.suppress(OSError):
            path.unlink()

    def _keep(self, path: Path, compiled: jax.stages.Compiled) -> None:
        # What JAX may have loaded from a cache of its own, XLA writes without its code.
        if not self._writable or jax.config.values.get("jax_compilation_cache_dir"):
            return
        try:
            content = serialize_executable.serialize(compiled)[0]
        except Exception as error:  # some programs cannot be
            self._say(f"not kept: {path} ({type(error).__name__})")
            return
        try:
            self.directory.mkdir(mode=0o700, parents=True, exist_ok=True)
            _write(path, _sha256(path.name, content) + content)
        except OSError as error:  # and the next one would meet the same
            self._writable = False
            self._say(f"compiled programs are not kept in {self.directory}: {error.strerror}")
        else:
            with contextlib.suppress(OSError):
                self._evict()

    def _evict(self) -> None:
        """Removes the entries, of all versions, that were used longest ago."""
        # Nothing but what this class wrote: the user may have pointed it at a directory with other files.
        entries = []
        for file in self.root.glob(f"jaxq-*/*{_SUFFIX}*"):
            with contextlib.suppress(OSError):  # another process has removed it
                status = file.stat()
                entries.append((status.st_mtime_ns, status.st_size, file))
        total = sum(size for _, size, _ in entries)
        for _, size, file in sorted(entries):
            if total <= self.limit_bytes:
                break
            with contextlib.suppress(OSError):
                file.unlink()
            total -= size


def user_cache(say: Say | None = None) -> CompileCache | None:
    """The user's cache, or None where it is turned off or JAX cannot have one.

    It is the directory ``JAXQ_CACHE_DIR``, or ``jaxq`` in the directory that the system has for caches.
    """
    root = _place()
    if root is None:
        return None
    try:
        if jax.default_backend() == "cpu" and _numbers(jaxlib.version.__version__) >= OLDEST_JAXLIB:
            return CompileCache(root, say=say)
    except (AttributeError, ImportError):  # a JAX of another time
        pass
    if say:
        say(f"no cache: not with jaxlib {jaxlib.version.__version__} on a {jax.default_backend()}")
    return None


def _place() -> Path | None:
    if (given := os.environ.get(VARIABLE)) is not None:
        return Path(given) if given else None
    given = os.environ.get("XDG_CACHE_HOME", "")
    if os.path.isabs(given):  # the specification has others ignored
        return Path(given) / "jaxq"
    try:
        return Path.home() / ("Library/Caches" if sys.platform == "darwin" else ".cache") / "jaxq"
    except RuntimeError:  # no home
        return None


def _surroundings() -> str:
    """All but the program itself that decides what XLA makes of it, as the name of a directory."""
    from jaxlib import xla_client  # not JAX's public face, so that another JAX may lack it

    software = f"jaxq-{__version__}-jax-{jax.__version__}-jaxlib-{jaxlib.version.__version__}"
    python = f"{platform.python_implementation().lower()}-{platform.python_version()}"
    others = (
        # Not XLA_FLAGS: XLA reads it once, and what it read then counts, not what it holds now.
        xla_client.CompileOptions().SerializeAsString(),
        repr(sorted(jax.config.values.items())),
        platform.platform(),
        machine.instructions(),
        str(machine.cores()),
    )
    return f"{software}-{python}-{_sha256(*others).hex()[:16]}"


def _is_whole(text: str, lowered: jax.stages.Lowered) -> bool:
    """Whether the text says all of what a call does."""
    # An executable holds which arguments it drops, the text does not: f(x, y) = x and f(x, y) = y look the same. And
    # what is called outside of XLA is named by its address.
    main = re.search(r"func\.func public @main\((.*)", text)
    arguments = len(re.findall(r"%arg\d+: ", main[1])) if main else -1
    return arguments == len(jax.tree.leaves(lowered.args_info)) and "custom_call" not in text


def _write(path: Path, data: bytes) -> None:
    """Under a name of its own first: a reader sees all of it or nothing, and two writers do not meet."""
    handle, name = tempfile.mkstemp(dir=path.parent, prefix=path.name, suffix=".tmp")
    try:
        with open(handle, "wb") as file:
            file.write(data)
            file.flush()
            os.fsync(file.fileno())
        os.replace(name, path)
    except BaseException:
        with contextlib.suppress(OSError):
            os.unlink(name)
        raise


def _sha256(*parts: str | bytes) -> bytes:
    """One digest of several parts, each with its length, so that no two lists run together alike."""
    digest = hashlib.sha256()
    for part in parts:
        data = part.encode() if isinstance(part, str) else part
        digest.update(len(data).to_bytes(8, "big"))
        digest.update(data)
    return digest.digest()


def _numbers(version: str) -> tuple[int, ...]:
    return tuple(int(number) for number in re.findall(r"\d+", version)[:3])
