"""Markdown: markdown-it, an independent parser of CommonMark and GitHub's tables, finds the name and nothing else."""

from __future__ import annotations

import re

import pytest
from hypothesis import given
from markdown_it import MarkdownIt

from evaluate.escaping.markdown import markdown_text
from ggavatar.text.names import displayable
from tests.support.hostile_names import HOSTILE, NATURAL, TEXTS, patient

PARSER = MarkdownIt("commonmark").enable(["table", "strikethrough"])
PARSER.validateLink = lambda _: True  # type: ignore[method-assign]  # else `javascript:` is text, escaped or not


def shown(source: str) -> tuple[list[str], list[str]]:
    """Kinds of all blocks in order, and the text of every paragraph, cell or heading; a `<span>` around `$` is read."""
    blocks, texts = [], []
    for token in PARSER.parse(source):
        if token.type != "inline":
            blocks.append(token.type)
            continue
        kinds = {(part.type, part.content if part.type == "html_inline" else "") for part in token.children or ()}
        assert kinds <= {("text", ""), ("text_special", ""), ("html_inline", "<span>"), ("html_inline", "</span>")}, (
            kinds
        )
        texts.append("".join(part.content for part in token.children or () if part.type != "html_inline"))
    return blocks, texts


@patient
@given(TEXTS)
def test_a_name_is_text_wherever_it_stands(text: str) -> None:
    escaped, wanted = markdown_text(text), displayable(text)
    assert shown(f"| h |\n| --- |\n| {escaped} |\n")[1] == ["h", wanted]
    blocks, texts = shown(f"- {escaped}\n")
    paragraph = ["paragraph_open", "paragraph_close"] if wanted else []
    assert blocks == ["bullet_list_open", "list_item_open", *paragraph, "list_item_close", "bullet_list_close"]
    assert "".join(texts) == wanted
    assert shown(f"{escaped}\n") == (paragraph, [wanted] if wanted else [])
    assert shown(f"# {escaped} x\n")[1] == [f"{wanted} x".strip()]


@patient
@given(TEXTS)
def test_github_finds_no_link_and_no_formula(text: str) -> None:
    """The literals of the autolink extension of GitHub's specification (6.9), and dollars, each in its element."""
    escaped = markdown_text(text)
    assert not re.search(r"(?i)(?<![^\W_])(https?:|ftp:|mailto:|xmpp:|www\.)", escaped)
    assert "$" not in escaped.replace("<span>$</span>", "")


@pytest.mark.parametrize("name", [name for name in NATURAL if "_" not in name])
def test_ordinary_text_is_kept(name: str) -> None:
    assert markdown_text(name) == name


@pytest.mark.parametrize(
    ("text", "source"),
    [
        ("a|b_c*d", r"a\|b\_c\*d"),
        ("-1.5 +2", "-1.5 +2"),
        ("- 1", r"\- 1"),
        ("1. FC", r"1\. FC"),
        ("# x #1", r"\# x #1"),
        ("Smith & Co &lt;", r"Smith & Co \&lt;"),
        ("5 $", "5 <span>$</span>"),
    ],
)
def test_no_more_than_necessary_is_escaped(text: str, source: str) -> None:
    assert markdown_text(text) == source


def test_every_hostile_name_is_one_line() -> None:
    assert all("\n" not in markdown_text(name) for name in HOSTILE)
