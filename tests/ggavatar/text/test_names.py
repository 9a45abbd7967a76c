"""Names: what is kept, what is replaced, and that cleaning ends."""

from __future__ import annotations

import unicodedata

import pytest
from hypothesis import given

from ggavatar.text.names import (
    JOINERS,
    MAX_NAME,
    MAX_TEXT,
    UNNAMED,
    clean_name,
    clean_text,
    clean_values,
    displayable,
)
from tests.support.hostile_names import NATURAL, TEXTS, patient

SHAPED = {*JOINERS, *"\u0600\u0601\u0602\u0603\u0604\u0605\u06dd\u070f\u0890\u0891\u08e2\U000110bd\U000110cd"}
SHAPED |= {chr(code) for code in range(0x13430, 0x13440)}
"""Format characters that spell: joiners, Unicode's Prepended_Concatenation_Mark, and the joints of hieroglyphs."""


@patient
@given(TEXTS)
def test_a_cleaned_name_is_one_short_line_of_text(text: str) -> None:
    """Unicode's own categories are the reference: no control, surrogate, format character, or line separator."""
    name = clean_name(text)
    assert 0 < len(name) <= MAX_NAME
    assert name == name.strip() and "  " not in name
    categories = {unicodedata.category(letter) for letter in name if letter not in SHAPED}
    assert not categories & {"Cc", "Cs", "Cf", "Zl", "Zp"}
    assert not any(ord(letter) & 0xFFFE == 0xFFFE or 0xFDD0 <= ord(letter) <= 0xFDEF for letter in name)
    assert unicodedata.is_normalized("NFC", name)
    name.encode()


@patient
@given(TEXTS)
def test_cleaning_ends(text: str) -> None:
    for clean in (clean_name, clean_text, displayable):
        assert clean(clean(text)) == clean(text)


@pytest.mark.parametrize("name", NATURAL)
def test_names_of_people_and_methods_are_kept(name: str) -> None:
    assert clean_name(name) == name


@pytest.mark.parametrize(
    ("text", "name"),
    [
        ("a\nb\r\n\tc", "a b c"),
        ("\x1b[31mred", "\ufffd[31mred"),
        ("a\u202eb\u2066", "ab"),
        ("caf\udce9", "caf\ufffd"),
        ("\ufffe", "\ufffd"),
        ("e\u0301", "é"),
        (" \u200b\u200d\u3164 ", UNNAMED),
        ("", UNNAMED),
        ("x" * 500, "x" * (MAX_NAME - 1) + "…"),
    ],
)
def test_what_is_replaced(text: str, name: str) -> None:
    assert clean_name(text) == name


def test_texts_within_json_are_cleaned_and_numbers_are_not() -> None:
    values = {"a\nb": ["\x1b", 1.5, None, {"x": True, "y": "z" * (MAX_TEXT + 1)}]}
    cleaned = clean_values(values)
    assert cleaned == {"a b": ["\ufffd", 1.5, None, {"x": True, "y": "z" * (MAX_TEXT - 1) + "…"}]}
