"""Docstrings are whole: no sentence is cut between the summary and the body, and brackets close in the summary."""

from __future__ import annotations

import ast
import re
from collections.abc import Iterator
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
SOURCES = sorted(path for package in ("ggavatar", "preprocess", "evaluate") for path in (ROOT / package).rglob("*.py"))
CUT = re.compile(
    r"(And|Or|But|Since|So|That|Which|With|Without|By|Else|Below|Above|In|Of|To|Then|From|For|Height|As|Than|Reference"
    r")\b|(M|Mm|Px|Rad|Degrees|S|Ms|MiB)[.,;](?! [A-Z]\w)|[a-z]{2,}[ ,]"
)
"""How a paragraph begins that is the rest of a sentence: a conjunction, a preposition, a unit, or in lower case."""


def docstrings(tree: ast.Module) -> Iterator[tuple[int, str]]:
    """Line and text of every docstring, those of constants and fields included."""
    for node in ast.walk(tree):
        body = getattr(node, "body", None)
        if not isinstance(body, list):
            continue
        for statement in body:
            value = getattr(statement, "value", None)
            if isinstance(statement, ast.Expr) and isinstance(value, ast.Constant) and isinstance(value.value, str):
                yield statement.lineno, value.value


def complaint(text: str) -> str:
    """What is wrong with a docstring; empty if nothing is."""
    paragraphs = [paragraph.strip() for paragraph in text.strip().split("\n\n")]
    summary = paragraphs[0]
    half_open = re.search(r"\[[^\[\]()]*\)|\([^\[\]()]*\]", summary)  # an interval such as [0, 1)
    for opening, closing in ("()", "[]"):
        if summary.count(opening) != summary.count(closing) and not half_open:
            return f"unbalanced {opening}{closing} in the summary: {summary!r}"
    for paragraph in paragraphs[1:]:
        if match := CUT.match(paragraph):
            return f"a paragraph begins with {match[0]!r}, as the rest of a sentence would: {paragraph[:60]!r}"
    return ""


@pytest.mark.parametrize("path", SOURCES, ids=lambda path: str(path.relative_to(ROOT)))
def test_docstrings_are_whole(path: Path) -> None:
    found = [
        f"{path.relative_to(ROOT)}:{line} {what}"
        for line, text in docstrings(ast.parse(path.read_text()))
        if (what := complaint(text))
    ]
    assert not found, "\n".join(found)


@pytest.mark.parametrize(
    "text",
    [
        "Square windows (left, top, width.\n\nHeight).",
        "Colors [L.\n\n3] of landmarks.",
        "Distance between the eyes.\n\nM.",
        "The text.\n\nAnd more of the same sentence.",
        "What a file holds.\n\nwith names.",
    ],
)
def test_a_cut_sentence_is_noticed(text: str) -> None:
    assert complaint(text)


@pytest.mark.parametrize(
    "text", ["Shares in [0, 1).", "A summary.\n\nThe body says more.", "A summary.\n\nArgs:\n    x: In px."]
)
def test_a_whole_docstring_passes(text: str) -> None:
    assert not complaint(text)
