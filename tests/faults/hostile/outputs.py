"""What the outputs of an evaluation must never hold, whatever the names in them, by parsers of each format."""

from __future__ import annotations

import csv
import io
import json
import re
from html.parser import HTMLParser
from pathlib import Path
from xml.etree import ElementTree

from markdown_it import MarkdownIt

_CONTROL = re.compile("[\x00-\x08\x0b-\x1f\x7f-\x9f\u202a-\u202e\u2066-\u2069\ufffe\uffff]")
_NUMBER = re.compile(r"[-+]?\d[\d.,e+-]*")
_HARMLESS_TAGS = ("<span>", "</span>")
_ACTIVE_TAGS = frozenset({"script", "svg", "iframe", "object", "embed", "link", "base", "form", "math"})


class _Page(HTMLParser):
    """Collects what a page does besides showing text."""

    def __init__(self) -> None:
        super().__init__()
        self.wrong: list[str] = []

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        """Tags and attributes that act or load something."""
        if tag in _ACTIVE_TAGS:
            self.wrong.append(f"<{tag}>")
        for name, value in attrs:
            address = (value or "").strip().lower()
            foreign = address.startswith(("javascript:", "http:", "https:", "//", "file:")) or (
                address.startswith("data:") and not address.startswith("data:image/")
            )
            if name.startswith("on") or (name in ("href", "src", "action", "srcset") and foreign):
                self.wrong.append(f"{name}={value!r:.60}")


def check_html(text: str) -> list[str]:
    """Whether a page runs or loads something."""
    page = _Page()
    page.feed(text)
    return page.wrong


def check_csv(text: str) -> list[str]:
    """Whether a spreadsheet would take a cell for a formula."""
    cells = [cell for row in csv.reader(io.StringIO(text)) for cell in row]
    starts = ("=", "+", "-", "@", "\t", "\r", "＝")
    return [f"formula {cell!r:.60}" for cell in cells if cell.startswith(starts) and not _NUMBER.fullmatch(cell)]


def check_markdown(text: str) -> list[str]:
    """Whether a name became an image, a link or markup, as a parser of CommonMark and GitHub's tables reads it."""
    tokens = [part for token in _markdown().parse(text) for part in (token, *(token.children or ()))]
    return [
        f"markup {token.type} {token.content or token.attrs!r:.60}"
        for token in tokens
        if token.type in ("image", "link_open", "html_block")
        or (token.type == "html_inline" and token.content not in _HARMLESS_TAGS)
    ]


def _markdown() -> MarkdownIt:
    """A parser that takes every address for a link, unlike ones that know dangerous addresses."""
    parser = MarkdownIt("commonmark").enable(["table", "strikethrough"])
    parser.validateLink = lambda _: True  # type: ignore[method-assign]
    return parser


def check_latex(text: str) -> list[str]:
    """Whether a name became a command that reads, writes or runs."""
    return [
        f"command {part}" for part in re.findall(r"\\(?:write|input|immediate|openout|include|csname|catcode)", text)
    ]


def check_json(text: str) -> list[str]:
    """Whether it is strict JSON."""
    json.loads(text, parse_constant=lambda name: [][0])
    return []


def check_junit(text: str) -> list[str]:
    """Whether it is well-formed XML."""
    ElementTree.fromstring(text)
    return []


def check_terminal(text: str) -> list[str]:
    """Whether a terminal or a CI runner would take something for a command."""
    wrong = [f"control character {found!r}" for found in _CONTROL.findall(text)[:3]]
    commands = [line for line in text.splitlines() if line.lstrip().startswith(("::", "##["))]
    return wrong + [f"workflow command {line!r:.60}" for line in commands]


_CHECKS = {
    ".html": check_html,
    ".csv": check_csv,
    ".md": check_markdown,
    ".tex": check_latex,
    ".json": check_json,
    ".xml": check_junit,
}


def check_outputs(folder: Path, printed: str) -> list[str]:
    """What is wrong with the files in a folder, and with what a command printed."""
    wrong = [f"{words} on the terminal" for words in check_terminal(printed)]
    for path in sorted(folder.rglob("*")):
        if path.suffix in _CHECKS:
            text = path.read_text(encoding="utf-8")
            found = _CHECKS[path.suffix](text)
            if path.suffix != ".json":
                found += [f"control character {part!r}" for part in _CONTROL.findall(text.replace("\r\n", "\n"))[:3]]
            wrong += [f"{words} in {path.name}" for words in found]
    return wrong
