"""Frozen dataclasses of plain values to JSON and back, with `name=value` overrides from the command line.

Written by hand because cattrs and pydantic would add a dependency and 0.1 s to start-up, and neither suggests the
nearest known name, refuses `true` for a number yet accepts 2 for a float, and converts lists to tuples without
converters of our own.
"""

from __future__ import annotations

import dataclasses
import json
import math
import types
import typing
from collections.abc import Iterable, Mapping
from typing import Any, Literal, TypeVar

from ggavatar.errors import InputError, nearest
from ggavatar.io.json_files import parse_value

T = TypeVar("T")


def to_plain(config: Any) -> dict[str, Any]:
    """Convert a dataclass to JSON-ready values; tuples become lists."""
    return json.loads(json.dumps(dataclasses.asdict(config)))


def from_plain(kind: type[T], values: Mapping[str, Any], where: str) -> T:
    """Build a dataclass from JSON values, checking every name and type.

    Args:
        kind: The dataclass.
        values: Fields by name; absent ones keep their default.
        where: What is being read, for messages.

    Raises:
        InputError: The dataclass has no field of that name, or a value has the wrong type.
    """
    hints = typing.get_type_hints(kind)
    names = [field.name for field in dataclasses.fields(kind)]  # type: ignore[arg-type]
    checked = {}
    for name, value in values.items():
        if name not in names:
            raise InputError(f"{where}: unknown setting {name!r}{nearest(name, names)}; known are {', '.join(names)}")
        checked[name] = _convert(value, hints[name], f"{where}: {name}")
    return kind(**checked)


def override(config: T, assignments: Iterable[str], where: str) -> T:
    """Copy a dataclass with `name=value` texts applied; a value that is not JSON is taken as text."""
    changes = {}
    for assignment in assignments:
        name, equals, text = assignment.partition("=")
        if not equals:
            raise InputError(f"{where}: expected name=value, found {assignment!r}")
        changes[name.strip()] = _finite_and_nonnegative(_parse_value(text), f"{where}: {assignment}")
    return from_plain(type(config), {**to_plain(config), **changes}, where)


def _parse_value(text: str) -> Any:
    try:
        return parse_value(text)
    except ValueError:
        return {"True": True, "False": False, "None": None, "NaN": math.nan, "Infinity": math.inf}.get(text, text)


def _finite_and_nonnegative(value: Any, where: str) -> Any:
    """Return the value, refusing a number that no setting can have: negative or not finite."""
    if type(value) in (int, float) and not 0 <= value < math.inf:
        raise InputError(f"{where}: expected a finite number of at least 0")
    return value


def _convert(value: Any, hint: Any, where: str) -> Any:
    """Convert `value` to the annotated type; integers are accepted for floats and lists for tuples."""
    origin, arguments = typing.get_origin(hint), typing.get_args(hint)
    if origin is Literal:
        if value in arguments:
            return value
        raise InputError(f"{where}: expected one of {', '.join(map(str, arguments))}, found {value!r}")
    if origin in (types.UnionType, typing.Union):
        return (
            None
            if value is None and type(None) in arguments
            else _convert(value, next(a for a in arguments if a is not type(None)), where)
        )
    if origin is tuple and isinstance(value, (list, tuple)):
        inner = [arguments[0]] * len(value) if len(arguments) == 2 and arguments[1] is ... else list(arguments)
        if len(inner) == len(value):
            return tuple(_convert(item, kind, where) for item, kind in zip(value, inner, strict=True))
    if dataclasses.is_dataclass(hint) and isinstance(value, Mapping):
        return from_plain(typing.cast(type, hint), value, where)
    if origin is dict and isinstance(value, dict):
        return value
    if hint is float and type(value) in (int, float):
        return float(value)  # JSON's integers have at most 64 bits
    if type(value) is hint:
        return value
    raise InputError(f"{where}: expected {getattr(hint, '__name__', hint)}, found {value!r}")
