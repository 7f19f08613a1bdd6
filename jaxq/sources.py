"""What a function of the user's own is, so that a run that is resumed can tell whether it is still the same."""

from __future__ import annotations

import contextlib
import functools
import hashlib
import importlib
import inspect
import sys
import sysconfig
import traceback
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np

from jaxq.suggest import nearest

_HERE = Path(__file__).parent


def digest(function: Callable[..., Any]) -> str | None:
    """SHA-256 of a function's source text and of what is bound to it: what it closes over, its defaults, what a partial
    fixes. None where there is no source to read, as for what is built in. Of objects that are neither plain values,
    arrays nor functions it is the type alone that counts.
    """
    try:
        inspect.getsource(written(function))
    except (OSError, TypeError):
        return None
    found = hashlib.sha256()
    for part in _parts(function, set()):
        found.update(part + b"\0")
    return found.hexdigest()


def imported(name: str) -> Any:
    """What a name as ``package.module:function`` stands for, looked for in the working directory as well.

    Raises ValueError where there is no such thing, and for a module that cannot be imported.
    """
    module, _, inside = name.partition(":")
    if not all(part.isidentifier() for part in (*module.split("."), *inside.split("."))):
        raise ValueError(f"{name!r} is not allowed: MODULE:FUNCTION")
    if (here := str(Path.cwd())) not in sys.path:
        sys.path.insert(0, here)  # for good: what the module imports later may stand beside it
    try:
        with contextlib.redirect_stdout(sys.stderr):  # what a module prints is talk
            found = importlib.import_module(module)
    except (Exception, SystemExit) as error:  # whatever the module does
        raise ValueError(f"{module} cannot be imported: {raised(error)}") from None
    try:
        return functools.reduce(getattr, inside.split("."), found)
    except Exception:  # a module may have a __getattr__ of its own
        known = [name for name in dir(found) if not name.startswith("_")]
        raise ValueError(f"{inside!r} is unknown in {module}{nearest(inside, known)}") from None


def raised(error: BaseException) -> str:
    """A line of what code of the user's own raised: the kind, the first line of the message, and where."""
    frames = [frame for frame in traceback.extract_tb(error.__traceback__) if _theirs(frame.filename)]
    where = f" ({Path(frames[-1].filename).name}, line {frames[-1].lineno})" if frames else ""
    first, *_ = str(error).strip().splitlines() or [""]
    return " ".join(f"{type(error).__name__}: {first}{where}".split())


def ours(error: BaseException) -> bool:
    """Whether it is an error of this package's own words: a ValueError that was raised here."""
    *_, last = traceback.extract_tb(error.__traceback__)
    return type(error) is ValueError and Path(last.filename).is_relative_to(_HERE)


def _theirs(filename: str) -> bool:
    """Whether a file is neither this package's nor one that is installed, the standard library's included."""
    place = Path(filename)
    installed = [Path(path) for path in sysconfig.get_paths().values()]
    return not filename.startswith("<") and not any(place.is_relative_to(path) for path in (_HERE, *installed))


def written(function: Any) -> Any:
    """The function or the class that stands in the source, where this is a part or an instance of it."""
    while isinstance(function, functools.partial):
        function = function.func
    function = inspect.unwrap(function)
    return function if inspect.isroutine(function) or inspect.isclass(function) else type(function)


def _parts(value: Any, seen: set[int]) -> Iterator[bytes]:
    """What a value consists of, as far as it can be told; ``seen`` are those that are being told."""
    if isinstance(value, (bool, int, float, complex, str, bytes, type(None))):
        yield f"{type(value).__name__} {value!r}".encode()
        return
    if id(value) in seen:  # a function may close over itself
        return
    seen = seen | {id(value)}
    value = inspect.unwrap(value)  # jax.jit of a function is that function
    yield type(value).__qualname__.encode()
    if isinstance(value, functools.partial):
        inside: Any = (value.func, value.args, value.keywords)
    elif isinstance(value, dict):
        inside = value.items()
    elif isinstance(value, (list, tuple)):
        inside = value
    elif callable(value):
        yield from _called(value, seen)
        return
    else:
        yield from _array(value)
        return
    yield str(len(inside)).encode()
    for one in inside:
        yield from _parts(one, seen)


def _called(function: Any, seen: set[int]) -> Iterator[bytes]:
    try:
        yield inspect.getsource(written(function)).encode()
    except (OSError, TypeError):
        yield getattr(function, "__qualname__", "").encode()
    bound = [getattr(function, name, None) for name in ("__self__", "__defaults__", "__kwdefaults__")]
    if not (inspect.isroutine(function) or inspect.isclass(function)):
        bound.append(getattr(function, "__dict__", None))
    yield from _parts(bound[1:] if inspect.ismodule(bound[0]) else bound, seen)
    for cell in getattr(function, "__closure__", None) or ():
        try:
            yield from _parts(cell.cell_contents, seen)
        except ValueError:  # a name that is bound later, or never
            yield b"empty"


def _array(value: Any) -> Iterator[bytes]:
    if hasattr(value, "__array__") and hasattr(value, "dtype"):
        try:
            array = np.asarray(value)
        except Exception:  # a traced value, a typed key: its type has been told
            return
        if array.dtype != object:
            yield f"{array.dtype} {array.shape}".encode()
            yield array.tobytes()
