"""File names made from names: valid on every system, and different for different names."""

from __future__ import annotations

import re
import unicodedata

import pytest
from hypothesis import given

from evaluate.escaping.file_names import file_stem
from tests.support.hostile_names import HOSTILE, TEXTS, patient


@patient
@given(TEXTS)
def test_a_stem_is_a_file_name_everywhere(text: str) -> None:
    """Characters and names that Windows refuses: Microsoft, Naming Files, Paths, and Namespaces."""
    stem = file_stem(text)
    assert 0 < len(stem.encode()) <= 100
    assert not re.search(r'[<>:"/\\|?*\s\0-\x1f]', stem)
    assert not re.match(r"(?i)(con|prn|aux|nul|com\d|lpt\d)(\.|$)", stem)
    assert not stem.startswith((".", "-")) and not stem.endswith((".", " "))


@patient
@given(TEXTS, TEXTS)
def test_different_names_get_different_files(first: str, second: str) -> None:
    same = unicodedata.normalize("NFC", first) == unicodedata.normalize("NFC", second)
    assert (file_stem(first) == file_stem(second)) == same


def test_hostile_names_get_different_files() -> None:
    stems = [file_stem(name) for name in HOSTILE]
    assert len(set(stems)) == len(stems)


@pytest.mark.parametrize("name", ["Anna", "00-my_subject-ggavatar", "a+b=1.5", "张三"])
def test_ordinary_names_are_kept(name: str) -> None:
    assert file_stem(name) == name


def test_what_is_replaced() -> None:
    assert re.fullmatch(r"a-b-[0-9a-f]{8}", file_stem("a b"))
    assert re.fullmatch(r"_con\.txt-[0-9a-f]{8}", file_stem("con.txt"))
    assert re.fullmatch(r"etc-passwd-[0-9a-f]{8}", file_stem("../etc/passwd"))
