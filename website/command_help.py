"""What a command prints for `--help`, and its parts: text, and boxes with their options."""

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
COLUMNS = 119
"""Width of the terminal that is pretended; on wider ones boxes stand side by side."""
BOX_TOP, BOX_LINE, RULE = re.compile(r"^╭─ (.*?) ─*╮$"), re.compile(r"^│ (.*?)\s*│$"), re.compile(r"^─+$")
GAP = re.compile(r" {2,}")


@dataclass(frozen=True)
class Option:
    """An option or argument: how it is written, and what it means."""

    flags: str
    meaning: str


@dataclass(frozen=True)
class Box:
    """A group of options with its title and introduction."""

    title: str
    text: str
    options: tuple[Option, ...]


@dataclass(frozen=True)
class HelpPage:
    """A help page: its usage line, the text around the boxes, and the boxes."""

    usage: str
    text: str
    boxes: tuple[Box, ...]


def entry_points() -> dict[str, str]:
    """Names of the commands and where they start, as in pyproject.toml."""
    return dict(tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]["scripts"])


def printed_help(command: str, columns: int = COLUMNS) -> str:
    """What `COMMAND --help` prints on a terminal of this width, without colors."""
    module, _, function = entry_points()[command].partition(":")
    shown = io.TextIOWrapper(io.BytesIO(), encoding="utf-8")  # boxes are drawn where the encoding has them
    plain = {"COLUMNS": str(columns), "NO_COLOR": "1"}
    with (
        mock.patch.dict(os.environ, plain),
        mock.patch.object(sys, "argv", [command, "--help"]),
        contextlib.redirect_stdout(shown),
        contextlib.suppress(SystemExit),
    ):
        getattr(importlib.import_module(module), function)()
    shown.seek(0)
    return shown.read()


def read_help(printed: str) -> HelpPage:
    """The parts of a printed help page."""
    outside: list[str] = []
    boxes: list[Box] = []
    lines = iter(printed.splitlines())
    for line in lines:
        if top := BOX_TOP.match(line):
            boxes.append(_box(top[1], lines))
        else:
            outside.append(line)
    usage, _, text = "\n".join(outside).strip().partition("\n\n")
    return HelpPage(usage.removeprefix("usage: "), text.strip(), tuple(boxes))


def _box(title: str, lines: Iterator[str]) -> Box:
    """The box whose top has been read: what stands above its rule is its introduction."""
    inside: list[str] = []
    for line in lines:
        if not (match := BOX_LINE.match(line)):
            break
        inside.append(match[1])
    rules = [place for place, line in enumerate(inside) if RULE.match(line)]
    start = rules[0] + 1 if rules else 0
    return Box(title, " ".join(inside[: max(start - 1, 0)]), tuple(_options(inside[start:])))


def _options(lines: list[str]) -> Iterator[Option]:
    """Options: a line that begins at the margin opens one, indented lines continue its meaning."""
    flags = ""
    meaning: list[str] = []
    for line in lines:
        if line.startswith(" ") or not line:
            meaning.append(line.strip())
            continue
        if flags:
            yield Option(flags, " ".join(filter(None, meaning)))
        flags, *meaning = GAP.split(line, maxsplit=1)
    if flags:
        yield Option(flags, " ".join(filter(None, meaning)))
