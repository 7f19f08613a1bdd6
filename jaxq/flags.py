"""The command line's flags, made from the presets. Imports no jax, so that ``--help`` answers at once."""

from __future__ import annotations

import argparse
import contextlib
import difflib
import re
from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path
from typing import Any, NoReturn

from pydantic.fields import FieldInfo

from jaxq import __version__, cpu, sources, worlds
from jaxq.axes import METHODS, SAMPLES, Range
from jaxq.presets import Preset, listed
from jaxq.settings import NO_LIMIT
from jaxq.suggest import nearest
from jaxq.worlds import World

COMMANDS = {
    "sweep": "train a preset over settings and seeds, many lanes at once",
    "train": "train one lane, with its episodes and pictures",
    "report": "write the report of a run directory: tables and pictures",
    "evaluate": "play the saved policies of a run directory, in Gymnasium too",
    "record": "film greedy episodes of a saved policy, with its action values",
    "play": "watch greedy episodes of a saved policy in the terminal",
    "verify": "compare this installation with Gymnasium, NumPy, JAX and itself",
    "bench": "measure the throughput of this machine",
    "list": "list the presets and environments",
}


#: What tells where the function is that a run directory cannot hold.
OWN = "the function that made the run's environment, where that is of your own"
#: Seeds of a sweep that does not say how many.
SEEDS = 10


class UsageError(Exception):
    """A user's mistake, in one line."""


class Parser(argparse.ArgumentParser):
    """argparse with one-line errors and suggestions."""

    # argparse takes -1e-3, -inf and -nan for flags unless told otherwise.
    def __init__(self, *args: Any, **kwargs: Any):
        super().__init__(*args, **kwargs)
        self._negative_number_matcher = re.compile(r"^-(\d|\.\d|inf|nan)")

    def error(self, message: str) -> NoReturn:
        if given := re.fullmatch(r"argument (\S+): ignored explicit argument (.*)", message):
            message = f"{given[1]} takes no value: {given[2]}"
        raise UsageError(message.removeprefix("argument "))


class Once(argparse.Action):
    """Stores a value and refuses a second one, where argparse would let the last one win."""

    def __call__(self, parser: Any, namespace: Any, values: Any, option_string: str | None = None) -> None:
        given = vars(namespace).setdefault("given", {})  # in the order of the words, which is that of the axes
        if self.dest in given:
            raise UsageError(
                f"{option_string} stands twice{'; several values follow one flag' if self.nargs in ('+', '*') else ''}"
            )
        given[self.dest] = self.const if values == [] else values
        setattr(namespace, self.dest, given[self.dest])


def whole(text: str) -> int:
    """A whole number."""
    try:
        return int(text)
    except ValueError:
        raise argparse.ArgumentTypeError(f"{text!r} is not allowed: a whole number") from None


def directory(text: str) -> Path:
    """A path that is not empty."""
    if not text.strip():
        raise argparse.ArgumentTypeError("'' is not a directory")
    return Path(text)


_USAGE = {
    "sweep": "jaxq sweep PRESET|FILE.toml [options]",
    "train": "jaxq train PRESET [options], or jaxq train --from DIR --config I --seed S",
}


def overview() -> argparse.ArgumentParser:
    """What ``jaxq --help`` says."""
    lines = "\n".join(f"  {name:8}{help}" for name, help in COMMANDS.items())
    made = Parser(
        prog="jaxq",
        usage="jaxq COMMAND ...",
        description=f"Value-based reinforcement learning, thousands of small trainings at once.\n\ncommands:\n{lines}",
        epilog="jaxq COMMAND --help says more; for example: jaxq sweep article-q --seeds 100",
        formatter_class=argparse.RawDescriptionHelpFormatter,
        allow_abbrev=False,
    )
    made.add_argument("--version", action="version", version=f"jaxq {__version__}")
    return made


def preset_overview(command: str) -> argparse.ArgumentParser:
    """What ``jaxq COMMAND --help`` says."""
    return Parser(
        prog=f"jaxq {command}",
        usage=_USAGE[command],
        description=f"{COMMANDS[command].capitalize()}.\n\npresets:\n{listed()}",
        epilog=f"jaxq {command} PRESET --help lists every hyperparameter",
        formatter_class=argparse.RawDescriptionHelpFormatter,
        allow_abbrev=False,
    )


def parser(command: str, chosen: Preset, env: World) -> argparse.ArgumentParser:
    """The flags of one command for one preset in one environment: the run's, then one per setting."""
    several = command == "sweep"
    made = Parser(
        prog=f"jaxq {command} {chosen.name}",
        description=f"{chosen.summary.capitalize()}."
        + (
            " Several values after a flag make an axis; the sweep is the product of all axes. MIN:MAX or MIN:MAX:log"
            " after a flag is a range, from which --method sobol or random takes --samples settings."
            if several
            else ""
        ),
        allow_abbrev=False,
    )
    run = made.add_argument_group("run")
    if several:
        count = partial(run.add_argument, action=Once, type=whole, default=None, metavar="N")
        count("--seeds", help=f"seeds of each setting (default {SEEDS})")
        run.add_argument(
            "--method", action=Once, default=None, help=f"how settings are chosen: {', '.join(METHODS[:3])}"
        )
        count("--samples", help=f"settings that sobol or random takes (default {SAMPLES})")
        count("--halving", help="stop all but the best of every N settings at each of several rungs on the way")
        count("--rungs", help="at most so many rungs, the last ones (default as many as the settings allow)")
        count("--keep", help="keep the policies of the best N lanes alone (default all)")
        run.add_argument("--episodes", action="store_true", help="keep a row of every training episode as well")
        run.add_argument("--tensorboard", action="store_true", help="write TensorBoard's event files as well")
    run.add_argument(
        "--seed", action=Once, type=whole, default=None, help="root of all randomness (default 0)", metavar="N"
    )
    run.add_argument("--prng", action=Once, default=None, help=f"key family (default {chosen.prng})", metavar="NAME")
    directory_flags(run)
    run.add_argument("--dry-run", action="store_true", help="say what would run, and stop")
    output_flags(run)
    environment = made.add_argument_group("environment")
    text = f"environment, or a function of your own that makes one (default {env})"
    environment.add_argument("--env", action=Once, default=None, help=text, metavar="ID|MODULE:FUNCTION")
    settings = chosen.settings.model_copy(update={"env": env})
    numbers = made.add_argument_group("hyperparameters")
    shapes = made.add_argument_group("structure (each combination is compiled once)")
    values = settings.flat()
    for name, info in settings.fields().items():
        if name != "env":
            group = environment if name.startswith("env.") else shapes if settings.is_structure(name) else numbers
            _add_flag(group, name, info, values[name], several)
    return made


def directory_flags(run: Any) -> None:
    """Where a run is kept, and what becomes of one that is there."""
    run.add_argument(
        "--out",
        action=Once,
        type=directory,
        default=None,
        help="run directory (default runs/<preset>-<hash>)",
        metavar="DIR",
    )
    run.add_argument("--resume", action="store_true", help="finish the sweep that the run directory holds")
    run.add_argument("--overwrite", action="store_true", help="replace the run directory")
    run.add_argument(
        "--allow-mismatch",
        action="store_true",
        help="with --resume: go on with a run that was made by other versions, on another CPU, or with fewer seeds or"
        " settings, and note it",
    )


def output_flags(run: Any) -> None:
    """What is said, and with what a run is done."""
    run.add_argument("--json", action="store_true", help="print one JSON object: lanes, summary, timing")
    run.add_argument("--quiet", action="store_true", help="no progress and no talk")
    run.add_argument("--no-progress", action="store_true", help="no progress bar")
    run.add_argument("--verbose", action="store_true", help="a line per lane, or per episode of a train")
    run.add_argument(
        "--no-cache",
        action="store_true",
        help="compile anew and keep nothing of it; else compiled programs are kept in $JAXQ_CACHE_DIR or in the"
        " user's directory for caches",
    )
    run.add_argument("--workers", action=Once, type=whole, default=None, help="cores to use (default all)", metavar="N")


def parse(command: str, chosen: Preset, words: list[str], env: str | World | None = None) -> argparse.Namespace:
    """The options of a command. Raises UsageError, with the nearest known flag, for what it does not know.

    ``env`` is the environment that a file asks for; ``--env`` goes before it, and decides which flags there are. A name
    with a colon is a function of the user's own, which is imported.
    """
    scout = Parser(add_help=False, allow_abbrev=False)
    scout.add_argument("--env", default=None)
    try:
        named, _ = scout.parse_known_args(words)
        wanted = named.env or env or chosen.settings.env
        env = worlds.world(own(wanted) if isinstance(wanted, str) and ":" in wanted else wanted)
    except ValueError as error:
        raise UsageError(str(error)) from None
    options = read(parser(command, chosen, env), words, f"jaxq {command} {chosen.name}")
    if env.factory is not None:
        options.env = env
    return options


def own(name: str) -> Callable[..., Any]:
    """The user's own function that makes an environment, of a name as ``module:function``. Raises ValueError."""
    cpu.tune()  # before the module imports jax
    try:
        make_env = sources.imported(name)
    except ValueError as error:
        raise ValueError(f"env: {error}") from None
    if not callable(make_env):
        raise ValueError(f"env: {name} is not allowed: a function that makes a jaxq.types.Env")
    return make_env


def read(made: argparse.ArgumentParser, words: Sequence[str], what: str) -> argparse.Namespace:
    """What a parser makes of the words. Raises UsageError for what it does not know, with the nearest known flag."""
    options, unknown = made.parse_known_args(words)
    if not unknown:
        return options
    flag = next((word for word in unknown if word.startswith("-")), None)
    if flag is None:
        before = words[: len(words) - list(reversed(words)).index(unknown[0]) - 1]
        last = next((word for word in reversed(before) if word.startswith("--")), None)
        raise UsageError(f"{unknown[0]!r} is one value too many{f' for {last}' if last else ''}")
    flag = flag.split("=")[0]
    known = [flag for action in made._actions for flag in action.option_strings]
    if flag.startswith("--env."):
        known = [one for one in known if one.startswith("--env.")]
        raise UsageError(f"{flag} is unknown to {what}{nearest(flag, known)}")
    near = nearest(flag, known) if difflib.get_close_matches(flag, known) else "; --help lists the flags"
    raise UsageError(f"{flag} is unknown to {what}{near}")


def _add_flag(group: Any, name: str, info: FieldInfo, default: Any, several: bool) -> None:
    shown = (",".join(map(str, default)) or "none") if isinstance(default, tuple) else default
    shown = "none" if shown is None else "no limit" if shown == NO_LIMIT else shown
    text = f"{info.description} (default {shown})".replace("%", "%%")
    flag = f"--{name.replace('_', '-')}"
    switch = info.annotation is bool  # alone it is true
    how: dict[str, Any] = {"metavar": "true|false" if switch else "VALUE"}
    if several:
        how |= {"nargs": "*", "const": ["true"]} if switch else {"nargs": "+"}
    elif switch:
        how |= {"nargs": "?", "const": "true"}
    group.add_argument(flag, action=Once, default=None, help=text, dest=f"set_{name}", **how)


def given_values(chosen: Preset, options: argparse.Namespace) -> dict[str, Any]:
    """The settings that were given, each a Range, or a list of what the preset's model reads."""
    given: dict[str, Any] = {}
    for name, raw in getattr(options, "given", {}).items():
        if name.startswith("set_"):
            name = name.removeprefix("set_")
            if not isinstance(raw, list):  # of a train, which has one setting
                given[name] = raw
                continue
            words = raw
            ranges = [word for word in words if re.fullmatch(r"[^:]+:[^:]+(:[^:]*)?", word)]
            if ranges and len(words) > 1:
                raise UsageError(f"{name}: {ranges[0]} is not allowed beside other values")
            given[name] = _range(name, words[0]) if ranges else words
    return {"env": options.env, **given} if options.env is not None else given


def _range(name: str, word: str) -> Range:
    low, high, *scale = word.split(":")
    try:
        return Range(_number(low), _number(high), *scale)  # type: ignore[arg-type]
    except ValueError as error:
        raise UsageError(f"{name}: {word} is not allowed: {error}") from None


def _number(word: str) -> float:
    for kind in (int, float):
        with contextlib.suppress(ValueError):
            return kind(word)
    raise ValueError(f"{word!r} is no number")
