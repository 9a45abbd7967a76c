"""What a command prints for `--help`, and its parts: what it does, and sections of options or of lines to read."""

from __future__ import annotations

import contextlib
import importlib
import io
import os
import re
import sys
import tomllib
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from unittest import mock

ROOT = Path(__file__).parents[1]
TITLE = re.compile(r"^(\S.*):$")
ITEM = re.compile(r"^  (\S.*?)(?:  +(\S.*))?$")
"""A line of a section that is not indented further: an option, with its meaning where that is short."""
ARGUMENTS = "arguments"
"""Title of the section of positional arguments; options are known by their dashes."""


@dataclass(frozen=True)
class Option:
    """An option or argument: how it is written, and what it means."""

    flags: str
    meaning: str


@dataclass(frozen=True)
class Section:
    """A section of a help page.

    Attributes:
        title: What stands above it.
        lines: It as printed, without the indentation.
        options: What the lines say, where they are options or arguments.
    """

    title: str
    lines: tuple[str, ...]
    options: tuple[Option, ...] = ()


@dataclass(frozen=True)
class HelpPage:
    """A help page: its usage line, what the command does, and the sections."""

    usage: str
    text: str
    sections: tuple[Section, ...]


def entry_points() -> dict[str, str]:
    """Names of the commands and where they start, as in pyproject.toml."""
    return dict(tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]["scripts"])


def printed_help(command: str, columns: int = 84) -> str:
    """What `COMMAND --help` prints on a terminal of this width, without colors."""
    module, _, function = entry_points()[command].partition(":")
    shown = io.TextIOWrapper(io.BytesIO(), encoding="utf-8")
    with (
        mock.patch.dict(os.environ, {"COLUMNS": str(columns), "NO_COLOR": "1"}),
        mock.patch.object(sys, "argv", [command, "--help"]),
        contextlib.redirect_stdout(shown),
        contextlib.suppress(SystemExit),
    ):
        getattr(importlib.import_module(module), function)()
    shown.seek(0)
    return shown.read()


def read_help(printed: str) -> HelpPage:
    """The parts of a printed help page."""
    usage, _, rest = printed.strip().partition("\n\n")
    text, sections = [], []
    for block in re.split(r"\n\n+(?=\S)", rest):
        first, *lines = block.splitlines()
        title = TITLE.match(first)
        if title and lines:
            sections.append(_section(title[1], lines))
        else:
            text.append(block)
    return HelpPage(usage.removeprefix("usage: "), "\n\n".join(text), tuple(sections))


def _section(title: str, lines: list[str]) -> Section:
    shown = tuple(line.removeprefix("  ") for line in lines)
    has_options = title == ARGUMENTS or shown[0].startswith("-")
    return Section(title, shown, tuple(_options(lines)) if has_options else ())


def _options(lines: list[str]) -> Iterator[Option]:
    """Options: a line that is indented by two opens one, others continue its meaning."""
    flags, meaning = "", ""
    for line in lines:
        if not (item := ITEM.match(line)):
            meaning = f"{meaning} {line.strip()}".strip()
            continue
        if flags:
            yield Option(flags, meaning)
        flags, meaning = item[1], item[2] or ""
    yield Option(flags, meaning)
