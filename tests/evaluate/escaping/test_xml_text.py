"""XML: expat accepts every name, in attributes and in text."""

from __future__ import annotations

from xml.etree import ElementTree

import pytest
from hypothesis import given

from evaluate.escaping.xml_text import xml_text
from tests.support.hostile_names import NATURAL, TEXTS, patient


@patient
@given(TEXTS)
def test_expat_reads_back_what_was_written(text: str) -> None:
    shown = xml_text(text)
    element = ElementTree.Element("a", name=shown)
    element.text = shown
    read = ElementTree.fromstring(ElementTree.tostring(element, encoding="utf-8"))
    assert (read.get("name"), read.text or "") == (shown, shown)


@pytest.mark.parametrize("name", [*NATURAL, "two\nlines"])
def test_ordinary_text_is_kept(name: str) -> None:
    assert xml_text(name) == name
