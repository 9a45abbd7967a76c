"""The page of a command shows every flag as `--help` does, whatever its text means in Markdown.

Reference: python-markdown, with which the site is made, what the commands print, and the commands of pyproject.toml.
"""

from __future__ import annotations

import html
import re
import tomllib
from pathlib import Path

import pytest

from website.command_pages import PAGES, command_pages, escaped, markdown

markdown_library = pytest.importorskip("markdown", reason="needs the extra docs")
SCRIPTS = tomllib.loads((Path(__file__).parents[2] / "pyproject.toml").read_text("utf-8"))["project"]["scripts"]


def shown(text: str) -> str:
    """Text of a page as a browser shows it."""
    page = markdown_library.markdown(text, extensions=["def_list", "fenced_code", "tables"])
    return html.unescape(re.sub(r"<[^>]+>", "", page))


def words(text: str) -> str:
    return " ".join(text.split())


def test_text_with_markup_is_shown_as_it_is() -> None:
    text = "RUN/*/x_y_z <b> [a](b) `c` | {None}|PATH ~5 #1 a*b*c & &amp;"
    assert shown(escaped(text)) == text


@pytest.mark.parametrize("command", SCRIPTS)
def test_nothing_that_help_prints_is_lost(command: str) -> None:
    """Usage, listing, examples, flags, texts and defaults, whose lines are broken elsewhere."""
    page = PAGES[command]
    found = words(shown(markdown(page))).lower()
    lines = page.lines(10_000)
    for line in lines[: lines.index("about the command:")]:
        for part in re.split(r"  +", line.strip()):
            assert words(part).removeprefix("usage: ").removesuffix(":").lower() in found, line


def test_every_command_has_a_page_and_is_in_the_index() -> None:
    pages = command_pages()
    assert set(pages) == {"commands/index.md", *(f"commands/{name}.md" for name in SCRIPTS)}
    assert all(f"]({name}.md)" in pages["commands/index.md"] for name in SCRIPTS)
