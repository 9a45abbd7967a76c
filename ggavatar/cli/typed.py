"""What was typed, checked against the flags of a command: one line with the nearest name, not a parser's report."""

from __future__ import annotations

import re
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from typing import Protocol, runtime_checkable

from ggavatar.cli.flags import Flag, flags_of
from ggavatar.errors import InputError, nearest

NUMBERS = {int: "a whole number", float: "a number"}


@runtime_checkable  # the tests' run-time type checker needs it
class Page(Protocol):
    """What is asked of a command's page, `ggavatar.cli.page.CommandPage`."""

    @property
    def program(self) -> str:
        """Name of the command."""
        ...

    @property
    def usage(self) -> str:
        """How it is called."""
        ...

    @property
    def options(self) -> type:
        """The dataclass that its flags fill."""
        ...

    @property
    def checks(self) -> Mapping[str, Callable[[str], None]]:
        """Checks of values, by field."""
        ...


def check_typed(page: Page, given: Sequence[str]) -> None:
    """Check flags, the number of their values, and their values, before the parser does.

    Raises:
        InputError: Something cannot be meant so; the message says what the command expects.
    """
    flags = flags_of(page.options)
    by_name = {name: flag for flag in flags for name in (*flag.spellings, *flag.negations)}
    found: set[str] = set()
    positional = [flag for flag in flags if flag.is_positional]
    places: list[str] = []
    for name, values in _parts(given, by_name):
        if not name:
            places += values
            continue
        flag = by_name.get(name)
        if flag is None:
            raise InputError(f"unknown flag {name}{_near(name, by_name)}; see {page.program} --help")
        found.add(flag.field)
        taken = 0 if flag.kind is bool else len(values) if flag.several else 1
        if taken > len(values):
            raise InputError(f"{name}: expected {flag.metavar} after it, found nothing; see {page.program} --help")
        for value in values[:taken]:
            _check_value(page, flag, name, value)
        places += values[taken:]
    _check_places(page, positional, places)
    for flag in flags:
        if flag.required and not flag.is_positional and flag.field not in found:
            missing = f"{flag.spellings[0]} {flag.metavar}"
            raise InputError(f"expected {missing} ({_brief(flag)}), found none; the command is: {page.usage}")


def _parts(given: Sequence[str], by_name: dict[str, Flag]) -> Iterator[tuple[str, list[str]]]:
    """Flags with what follows them; the first part has no flag. What follows `--` are places."""
    name, values = "", list[str]()
    for number, argument in enumerate(given):
        if argument == "--":
            yield name, values
            yield "", list(given[number + 1 :])
            return
        if not _is_flag(argument, by_name):
            values.append(argument)
            continue
        yield name, values
        spelled, equals, value = argument.partition("=")
        if not argument.startswith("--") and argument[:2] in by_name:  # -oFOLDER, as -o FOLDER
            spelled, equals, value = argument[:2], argument[2:], argument[2:].removeprefix("=")
        name, values = _plain(spelled), [value] if equals else []
    yield name, values


def _is_flag(argument: str, by_name: dict[str, Flag]) -> bool:
    """Whether an argument is meant as a flag: `-3` and `-` are values."""
    is_number = argument[1:2].isdigit() or argument[1:2] == "."
    return argument.startswith("-") and len(argument) > 1 and not is_number


def _plain(name: str) -> str:
    """A flag as it is listed: the parser takes `_` for `-`."""
    return "--" + name[2:].replace("_", "-") if name.startswith("--") else name


def _near(name: str, known: dict[str, Flag]) -> str:
    return nearest(name, [one for one in known if one.startswith("--")])


def one_of(flag: str, known: Collection[str]) -> Callable[[str], None]:
    """A check that a value is one of some names."""

    def check(value: str) -> None:
        if value not in known:
            raise InputError(f"{flag} {value}: expected one of {', '.join(known)}{nearest(value, known)}")

    return check


def _check_value(page: Page, flag: Flag, name: str, value: str) -> None:
    if flag.choices:
        one_of(name, flag.choices)(value)
    if flag.field in page.checks:
        page.checks[flag.field](value)
    if flag.kind in NUMBERS:
        try:
            flag.kind(value)
        except ValueError as error:
            raise InputError(f"{name} {value}: expected {NUMBERS[flag.kind]}, found {value!r}") from error


def _check_places(page: Page, positional: Sequence[Flag], places: Sequence[str]) -> None:
    """Check the arguments that are no flags: how many there are, and those that have a check."""
    needed = [flag for flag in positional if flag.required]
    if len(places) < len(needed):
        flag = needed[len(places)]
        raise InputError(f"expected {flag.metavar} ({_brief(flag)}), found none; the command is: {page.usage}")
    if any(flag.several for flag in positional):
        return
    if len(places) > len(positional):
        surplus = " ".join(places[len(positional) :])
        raise InputError(f"{surplus}: expected no further argument; the command is: {page.usage}")
    for flag, value in zip(positional, places, strict=False):
        if flag.field in page.checks:
            page.checks[flag.field](value)


def _brief(flag: Flag) -> str:
    """The beginning of a flag's text, for a message."""
    text = re.split(r"[.;:](?: |$)", flag.text)[0]
    return text[:1].lower() + text[1:]
