"""The flags of a command as data, from its dataclass of options: for its help page, its messages and the documentation.

The dataclass is the one that tyro parses. Nothing here is imported but what it needs for its annotations.
"""

from __future__ import annotations

import ast
import dataclasses
import inspect
import textwrap
import types
import typing
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import tyro

METAVARS = {Path: "PATH", int: "N", float: "X", str: "TEXT"}
HELP, VERSION = "--help", "--version"


@dataclass(frozen=True)
class Flag:
    """A flag or a positional argument.

    Attributes:
        field: Name of its field.
        spellings: How it is given, short ones first; none for a positional argument.
        metavar: What stands for its value; empty for a switch.
        kind: Type of one value: `bool` for a switch, else `str`, `int`, `float` or `Path`.
        choices: The only values, if it has such.
        several: Whether it takes any number of values.
        repeats: Whether it may be given again, each time with one value.
        required: Whether it must be given.
        default: Its value otherwise.
        text: What it does.
    """

    field: str
    spellings: tuple[str, ...]
    metavar: str
    kind: type
    choices: tuple[str, ...]
    several: bool
    repeats: bool
    required: bool
    default: Any
    text: str

    @property
    def is_positional(self) -> bool:
        """Whether its place says what it is."""
        return not self.spellings

    @property
    def negations(self) -> tuple[str, ...]:
        """How a switch is turned off."""
        if self.kind is not bool:
            return ()
        long = (name[2:].rpartition(".") for name in self.spellings if name.startswith("--"))
        return tuple(f"--{prefix}{dot}no-{name}" for prefix, dot, name in long)

    @property
    def shown(self) -> str:
        """How it stands in a help page, such as `-o RUN, --output RUN`."""
        if self.is_positional:
            return self.metavar + (" …" if self.several and not self.metavar.endswith("…") else "")
        names = (*self.spellings, *self.negations) if self.default is True else self.spellings
        value = f" {self.metavar}{' …' if self.several and not self.metavar.endswith('…') else ''}"
        return ", ".join(names) + value.rstrip()


def flags_of(options: type) -> tuple[Flag, ...]:
    """All flags of a dataclass of options, those of nested dataclasses at their place."""
    return tuple(_walk(options))


def spellings_of(options: type) -> frozenset[str]:
    """Every flag that a command accepts, as it is typed."""
    own = {name for flag in flags_of(options) for name in (*flag.spellings, *flag.negations)}
    return frozenset(own | {"-h", HELP, VERSION})


def _walk(options: type, prefix: str = "") -> Iterator[Flag]:
    hints = typing.get_type_hints(options, include_extras=True)
    texts = _texts(options)
    for field in dataclasses.fields(options):
        hint, metadata = _unwrapped(hints[field.name])
        if dataclasses.is_dataclass(hint):
            below = "" if tyro.conf.OmitArgPrefixes in metadata else f"{field.name.replace('_', '-')}."
            yield from _walk(typing.cast(type, hint), prefix + below)
        else:
            yield _flag(field, prefix, (hint, metadata), texts.get(field.name, ""))


def _unwrapped(hint: Any) -> tuple[Any, list[Any]]:
    """A type without its annotations, and those."""
    metadata: list[Any] = []
    while typing.get_origin(hint) is typing.Annotated:
        hint, *more = typing.get_args(hint)
        metadata += more
    return hint, metadata


def _flag(field: dataclasses.Field[Any], prefix: str, typed: tuple[Any, Sequence[Any]], text: str) -> Flag:
    hint, metadata = typed
    arguments = [one for one in metadata if hasattr(one, "aliases")]
    named = next((one.name for one in arguments if one.name), field.name).replace("_", "-")
    metavar = next((one.metavar for one in arguments if one.metavar), None)
    aliases = [alias for one in arguments for alias in one.aliases or ()]
    kind, choices, several = _value(hint)
    default = field.default
    if field.default_factory is not dataclasses.MISSING:
        default = field.default_factory()
    spellings = () if tyro.conf.Positional in metadata else (*sorted(aliases, key=len), f"--{prefix}{named}")
    if kind is bool:
        metavar = ""
    elif metavar is None:
        metavar = "{" + ",".join(choices) + "}" if choices else METAVARS[kind] if spellings else named.upper()
    repeats = tyro.conf.UseAppendAction in metadata
    is_required = default is dataclasses.MISSING
    return Flag(
        field.name, spellings, metavar, kind, choices, several and not repeats, repeats, is_required, default, text
    )


def _value(hint: Any) -> tuple[type, tuple[str, ...], bool]:
    """Type of one value, its choices, and whether there may be several."""
    hint, _ = _unwrapped(hint)
    origin, arguments = typing.get_origin(hint), typing.get_args(hint)
    if origin in (typing.Union, types.UnionType):
        return _value(next(one for one in arguments if one is not type(None)))
    if origin is tuple:
        kind, choices, _ = _value(arguments[0])
        return kind, choices, True
    if origin is typing.Literal:
        return type(arguments[0]), tuple(map(str, arguments)), False
    return hint, (), False


def _texts(options: type) -> dict[str, str]:
    """What stands below each field in the source, as tyro reads it."""
    found: dict[str, str] = {}
    for base in reversed(options.__mro__):
        if not dataclasses.is_dataclass(base):
            continue
        body = ast.parse(textwrap.dedent(inspect.getsource(base))).body[0]
        assert isinstance(body, ast.ClassDef)
        for field, below in zip(body.body, body.body[1:], strict=False):
            if (
                isinstance(field, ast.AnnAssign)
                and isinstance(field.target, ast.Name)
                and isinstance(below, ast.Expr)
                and isinstance(below.value, ast.Constant)
            ):
                found[field.target.id] = " ".join(str(below.value.value).replace("`", "").split())
    return found
