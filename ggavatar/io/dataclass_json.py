"""Frozen dataclasses of plain values to JSON and back, and changes to them from the command line.

Unknown names are refused.
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

T = TypeVar("T")


def to_plain(config: Any) -> dict[str, Any]:
    """A dataclass as JSON-ready values; tuples become lists."""
    return json.loads(json.dumps(dataclasses.asdict(config)))


def from_plain(kind: type[T], values: Mapping[str, Any], where: str) -> T:
    """A dataclass from JSON values, every name and type checked.

    Args:
        kind: The dataclass.
        values: Fields by name; absent ones keep their default.
        where: What is being read, for messages.

    Raises:
        InputError: A name the dataclass does not have, or a value of another type.
    """
    hints = typing.get_type_hints(kind)
    names = [field.name for field in dataclasses.fields(kind)]  # type: ignore[arg-type]
    checked = {}
    for name, value in values.items():
        if name not in names:
            raise InputError(f"{where}: unknown setting {name!r}{nearest(name, names)}; known are {', '.join(names)}")
        checked[name] = _coerced(value, hints[name], f"{where}: {name}")
    return kind(**checked)


def override(config: T, assignments: Iterable[str], where: str) -> T:
    """A copy of a dataclass with `name=value` texts applied; values are JSON, anything else is taken as text."""
    changes = {}
    for assignment in assignments:
        name, equals, text = assignment.partition("=")
        if not equals:
            raise InputError(f"{where}: expected name=value, found {assignment!r}")
        changes[name.strip()] = _sensible(_parsed(text), f"{where}: {assignment}")
    return from_plain(type(config), {**to_plain(config), **changes}, where)


def _parsed(text: str) -> Any:
    try:
        return json.loads(text)
    except ValueError:
        return {"True": True, "False": False, "None": None}.get(text, text)


def _sensible(value: Any, where: str) -> Any:
    """The value, unless it is a number that no setting can be: negative or not finite."""
    if type(value) in (int, float) and not 0 <= value < math.inf:
        raise InputError(f"{where}: expected a finite number of at least 0")
    return value


def _coerced(value: Any, hint: Any, where: str) -> Any:
    """`value` as the annotated type; whole numbers pass for floats, lists for tuples."""
    origin, arguments = typing.get_origin(hint), typing.get_args(hint)
    if origin is Literal:
        if value in arguments:
            return value
        raise InputError(f"{where}: expected one of {', '.join(map(str, arguments))}, found {value!r}")
    if origin in (types.UnionType, typing.Union):
        return (
            None
            if value is None and type(None) in arguments
            else _coerced(value, next(a for a in arguments if a is not type(None)), where)
        )
    if origin is tuple and isinstance(value, (list, tuple)):
        inner = [arguments[0]] * len(value) if len(arguments) == 2 and arguments[1] is ... else list(arguments)
        if len(inner) == len(value):
            return tuple(_coerced(item, kind, where) for item, kind in zip(value, inner, strict=True))
    if dataclasses.is_dataclass(hint) and isinstance(value, Mapping):
        return from_plain(typing.cast(type, hint), value, where)
    if origin is dict and isinstance(value, dict):
        return value
    if hint is float and type(value) in (int, float):
        return float(value)
    if type(value) is hint:
        return value
    raise InputError(f"{where}: expected {getattr(hint, '__name__', hint)}, found {value!r}")
