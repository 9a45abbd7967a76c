"""The page of a command: what `--help` prints, and the parsing of what was typed."""

from __future__ import annotations

import shutil
import sys
import textwrap
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import tyro

from ggavatar.cli.flags import HELP, Flag, flags_of
from ggavatar.cli.typed import check_typed
from ggavatar.cli.version import handle_version_flag
from ggavatar.text.terminal import write_out

NARROWEST, WIDEST = 60, 110
"""Of a help page, characters."""
INDENT = 26
"""Where the texts begin, characters."""


def _nothing() -> dict[str, str]:
    return {}


def _no_lines() -> tuple[str, ...]:
    return ()


@dataclass(frozen=True)
class CommandPage:
    """What a command says about itself.

    Attributes:
        program: Its name.
        options: The dataclass that its flags fill.
        summary: One sentence or two.
        examples: Lines to type, each with what it is for.
        groups: Names of fields by title, in the order of the page; the positional ones come first by themselves.
        defaults: Gives what fields stand for that are None, by name, for the device at hand.
        listing: Gives lines below the summary, such as the names of methods.
        checks: Raise an `InputError` for a value that cannot be, by field, before anything is loaded.
    """

    program: str
    options: type
    summary: str
    examples: tuple[tuple[str, str], ...]
    groups: Mapping[str, tuple[str, ...]]
    defaults: Callable[[], Mapping[str, str]] = field(default=_nothing)
    listing: Callable[[], Sequence[str]] = field(default=_no_lines)
    checks: Mapping[str, Callable[[str], None]] = field(default_factory=dict)

    @property
    def usage(self) -> str:
        """How it is called."""
        flags = flags_of(self.options)
        places = [flag.metavar if flag.required else f"[{flag.metavar}]" for flag in flags if flag.is_positional]
        needed = [f"{flag.spellings[0]} {flag.metavar}" for flag in flags if flag.required and not flag.is_positional]
        return " ".join((self.program, *places, *needed, "[options]"))

    def grouped(self) -> dict[str, list[Flag]]:
        """Its flags by title of their group."""
        flags = flags_of(self.options)
        by_name = {flag.field: flag for flag in flags}
        found = {"arguments": [flag for flag in flags if flag.is_positional]}
        found |= {title: [by_name[name] for name in names] for title, names in self.groups.items()}
        return {title: members for title, members in found.items() if members}

    def lines(self, width: int) -> list[str]:
        """The help page, in lines of at most `width` characters where words allow it."""
        defaults = self.defaults()
        page = [f"usage: {self.usage}", "", *textwrap.wrap(self.summary, width)]
        if listing := self.listing():
            page += ["", *(line for one in listing for line in _hanging(one, width))]
        page += ["", "examples:"]
        for line, purpose in self.examples:
            page += [f"  {line}", *textwrap.wrap(purpose, width, initial_indent=" " * 6, subsequent_indent=" " * 6)]
        for title, members in self.grouped().items():
            page += ["", f"{title}:"]
            for flag in members:
                page += _entry(flag.shown, explained(flag, defaults), width)
        page += ["", "about the command:", *_entry("-h, --help", "Print this page.", width)]
        return page + _entry("--version", "Print the version.", width)


def parse(page: CommandPage, arguments: Sequence[str] | None = None, strip: Sequence[str] = ()) -> Any:
    """The options of a command from what was typed.

    Args:
        page: The command.
        arguments: Its arguments; those of the command line by default.
        strip: Arguments that only our own programs pass, which no message names.

    Raises:
        InputError: A flag is unknown, lacks its value or has one that it cannot have, or something required is missing.
        SystemExit: A help page or the version was asked for and is printed.
    """
    given = [one for one in (sys.argv[1:] if arguments is None else arguments) if one not in strip]
    handle_version_flag(page.program, given)
    before_dashes = given[: given.index("--")] if "--" in given else given
    if HELP in before_dashes or "-h" in before_dashes:
        write_out(*page.lines(min(max(shutil.get_terminal_size().columns - 2, NARROWEST), WIDEST)))
        raise SystemExit(0)
    check_typed(page, given)
    config = (tyro.conf.AvoidSubcommands, tyro.conf.DisallowNone)
    return tyro.cli(page.options, prog=page.program, args=given, config=config)


def explained(flag: Flag, defaults: Mapping[str, str]) -> str:
    """The text of a flag with its default, for the device at hand.

    Args:
        flag: The flag.
        defaults: As of `CommandPage.defaults`.
    """
    if flag.required:
        return f"{flag.text} (required)"
    if flag.default is True:
        return f"{flag.text} (on by default)"
    if flag.repeats:
        return flag.text
    value = defaults.get(flag.field)
    if value is None and flag.default not in (None, False, ()):
        value = " ".join(map(str, flag.default)) if isinstance(flag.default, tuple) else f"{flag.default}"
    return flag.text if value is None else f"{flag.text} (default: {value})"


def _hanging(line: str, width: int) -> list[str]:
    """A line of a listing, broken under where its second column begins."""
    indent = len(line) - len(line.lstrip())
    column = line.find("  ", indent)
    below = len(line) - len(line[column:].lstrip()) if column > 0 else indent + 2
    return textwrap.wrap(line, width, subsequent_indent=" " * below, break_on_hyphens=False)


def _entry(name: str, text: str, width: int) -> list[str]:
    """A name with its text beside or below it."""
    gap = " " * INDENT
    wrapped = textwrap.wrap(text, width - INDENT, break_on_hyphens=False) or [""]
    if len(name) + 4 > INDENT:
        return [f"  {name}", *(gap + line for line in wrapped)]
    return [f"  {name:<{INDENT - 2}}{wrapped[0]}", *(gap + line for line in wrapped[1:])]
