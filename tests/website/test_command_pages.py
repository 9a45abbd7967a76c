"""The page of a command shows every option as it is printed, whatever its text means in Markdown.

Reference: python-markdown, with which the site is made.
"""

from __future__ import annotations

import html
import re

import pytest

from website.command_help import HelpPage, Option, Section, entry_points
from website.command_pages import command_pages, escaped, markdown, summary

markdown_library = pytest.importorskip("markdown", reason="needs the extra docs")


def shown(text: str) -> str:
    """Text of a page as a browser shows it."""
    page = markdown_library.markdown(text, extensions=["def_list", "fenced_code", "tables"])
    return html.unescape(re.sub(r"<[^>]+>", "", page))


def test_text_with_markup_is_shown_as_it_is() -> None:
    text = "RUN/*/x_y_z <b> [a](b) `c` | {None}|PATH ~5 #1 a*b*c & &amp;"
    assert shown(escaped(text)) == text


def test_a_page_shows_usage_sections_and_options() -> None:
    options = (Option("--way {a,b}", "A *way*. (default: a_b_c)"), Option("PATH", ""))
    sections = (Section("the way", ("...",), options), Section("examples", ("tool *a*", "    <b>")))
    page = HelpPage("tool PATH", "Do a thing:\nwell. It takes long.", sections)
    text = shown(markdown("tool", page))
    for part in (
        "tool PATH",
        "well. It takes",
        "The way",
        "--way {a,b}",
        "A *way*. (default: a_b_c)",
        "tool *a*\n    <b>",
    ):
        assert part in text
    assert summary(page) == "Do a thing: well."


def test_every_command_has_a_page_and_is_in_the_index() -> None:
    pages = command_pages()
    assert set(pages) == {"commands/index.md", *(f"commands/{name}.md" for name in entry_points())}
    assert all(f"]({name}.md)" in pages["commands/index.md"] for name in entry_points())
