"""Settings: validated, frozen records of hyperparameters, each a *number* that is traced or a *structure* that shapes
the program. Imports no jax.
"""

from __future__ import annotations

from types import UnionType
from typing import Any, Union, get_args, get_origin

from pydantic import BaseModel, ConfigDict, Field, ValidationError, model_validator
from pydantic.fields import FieldInfo

#: More than any run makes. The int32 counters go past a limit by less than a round, which is a buffer at most (2^24).
NO_LIMIT = 2_000_000_000


def number(default: Any, help: str, **allowed: Any) -> Any:
    """A field that is traced."""
    return Field(default, description=help, json_schema_extra={"structure": False}, **allowed)


def structure(default: Any, help: str, **allowed: Any) -> Any:
    """A field that shapes the program."""
    return Field(default, description=help, json_schema_extra={"structure": True}, **allowed)


class Settings(BaseModel):
    """One setting of every hyperparameter; validated, frozen, finite.

    A field may be Settings of its own, as the environment's are: its fields have dotted names, ``env.length``.
    """

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)

    def fields(self) -> dict[str, FieldInfo]:
        """Every field by its name; of nested settings by their dotted ones, after the field that holds them."""
        found = {}
        for name, info in type(self).model_fields.items():
            found[name] = info
            if isinstance(held := getattr(self, name), Settings):
                found |= {f"{name}.{inner}": below for inner, below in held.fields().items()}
        return found

    def flat(self) -> dict[str, Any]:
        """Every value by the names of ``fields``; nested settings stand there as their own name."""
        found = {}
        for name in type(self).model_fields:
            value = found[name] = getattr(self, name)
            if isinstance(value, Settings):
                found[name] = str(value)
                found |= {f"{name}.{inner}": below for inner, below in value.flat().items()}
        return found

    def is_structure(self, name: str) -> bool:
        """Whether the field shapes the program."""
        extra = self.fields()[name].json_schema_extra
        return isinstance(extra, dict) and bool(extra["structure"])

    def structural(self) -> tuple[tuple[str, Any], ...]:
        """The fields that shape the program, a key for grouping settings by program."""
        shapes = [(name, value) for name, value in self.flat().items() if self.is_structure(name)]
        return (("", self.identity()), *shapes)

    def identity(self) -> Any:
        """What tells settings of one kind from those of another."""
        nested = [getattr(self, name) for name in type(self).model_fields]
        return (type(self), *(held.identity() for held in nested if isinstance(held, Settings)))

    @model_validator(mode="before")
    @classmethod
    def _words(cls, given: Any) -> Any:
        """Words of a command line or a file: ``none`` where a field may be None, ``64,64`` for a tuple."""
        if not isinstance(given, dict):
            return given
        read = dict(given)
        for name, value in given.items():
            if isinstance(value, bool) and name in cls.model_fields and is_number(cls.model_fields[name]):
                raise ValueError(f"{name}: {value} is not allowed: a number")
            if isinstance(value, str) and name in cls.model_fields:
                kind = cls.model_fields[name].annotation
                if get_origin(kind) is tuple:
                    read[name] = () if value == "none" else tuple(value.split(","))
                elif value == "none" and type(None) in get_args(kind):
                    read[name] = None
        return read

    @model_validator(mode="after")
    def _float32(self) -> Settings:
        """Numbers are float32 or int32 in the program: too large is infinite there or another one, too small is 0."""
        for name in type(self).model_fields:
            value = getattr(self, name)
            if isinstance(value, float) and value != 0 and not 1e-37 < abs(value) < 1e38:
                zero = "" if any(hasattr(rule, "gt") for rule in type(self).model_fields[name].metadata) else "0, or "
                raise ValueError(f"{name}: {value} is not allowed: {zero}a size from 1e-37 to 1e38")
            if isinstance(value, int) and not -(2**31) <= value < 2**31:
                raise ValueError(f"{name}: {value} is not allowed: a whole number of 32 bits")
        return self


def is_number(info: FieldInfo) -> bool:
    """Whether the field holds a number, or a number or none."""
    kind = info.annotation
    kinds = set(get_args(kind)) if get_origin(kind) in (Union, UnionType) else {kind}
    return kinds != {type(None)} and kinds <= {int, float, type(None)}


def shown(value: Any) -> str:
    """A value as people and the columns of a table have it: layer sizes as ``128,128``."""
    return ",".join(map(str, value)) or "none" if isinstance(value, tuple) else str(value)


def changed(base: Settings, overrides: dict[str, Any], prefix: str = "") -> Any:
    """The settings with some fields replaced. Raises ValueError with the field, its value and what is allowed."""
    try:
        return type(base).model_validate({**dict(base), **overrides})
    except ValidationError as error:
        raise ValueError(prefix + one_line(error)) from None


#: pydantic's words for these would not say what is allowed.
_ALLOWED = {
    "missing": "too few values",
    "too_long": "too many values",
    "bool_parsing": "true or false",
    "int_parsing": "a whole number",
    "int_from_float": "a whole number",
    "float_parsing": "a number",
    "float_type": "a number",
    "int_type": "a whole number",
    "tuple_type": "whole numbers, as in 64,64 or [64, 64]",
}


def one_line(error: ValidationError) -> str:
    """What pydantic found first, in the words of this package."""
    first = error.errors(include_url=False)[0]
    if not first["loc"]:
        return first["msg"].removeprefix("Value error, ")
    where = str(first["loc"][0])  # of a tuple pydantic names the part as well, or the first that is not there
    value = first["input"]
    shown = ",".join(map(str, value)) if isinstance(value, tuple) else value if str(value).strip() else repr(value)
    if isinstance(value, (tuple, list)) and first["type"] in ("float_type", "int_type"):
        return f"{where}: {shown} is not allowed: one number; several are an axis, in a list or as values = [...]"
    message = _ALLOWED.get(first["type"]) or f"{first['msg'][0].lower()}{first['msg'][1:]}"
    return f"{where}: {shown} is not allowed: {message}"
