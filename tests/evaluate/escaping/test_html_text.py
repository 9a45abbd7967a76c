"""HTML: Python's parser finds no element and no attribute in a name, and the name itself as text."""

from __future__ import annotations

from html.parser import HTMLParser

import pytest
from hypothesis import given

from evaluate.escaping.html_text import html_text
from ggavatar.text.names import displayable
from tests.support.hostile_names import NATURAL, TEXTS, patient


class Parser(HTMLParser):
    """Keeps what it finds."""

    def __init__(self) -> None:
        super().__init__(convert_charrefs=True)
        self.tags: list[tuple[str, list[tuple[str, str | None]]]] = []
        self.text = ""

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.tags.append((tag, attrs))

    def handle_data(self, data: str) -> None:
        self.text += data


@patient
@given(TEXTS)
def test_a_name_is_text_in_elements_and_attributes(text: str) -> None:
    parser = Parser()
    parser.feed(f'<p title="{html_text(text)}">{html_text(text)}</p><i>')
    parser.close()
    assert parser.tags == [("p", [("title", displayable(text))]), ("i", [])]
    assert parser.text == displayable(text)


@pytest.mark.parametrize("name", [name for name in NATURAL if "&" not in name and "'" not in name])
def test_ordinary_text_is_kept(name: str) -> None:
    assert html_text(name) == name
