"""The reference names what the package offers. Reference: `ggavatar.__all__`, and stubs written out here."""

from __future__ import annotations

from pathlib import Path

import pytest

import ggavatar
from website import api_reference
from website.api_reference import public_names, reference_page

STUB_TEXT = """
from typing import Any

from ggavatar.core import Camera as Camera, Drive
from evaluate.api.scores import score_run as score_run

__version__: str
"""


def test_names_are_those_that_a_stub_passes_on() -> None:
    assert list(public_names(STUB_TEXT)) == ["ggavatar.core.Camera", "evaluate.api.scores.score_run"]


def test_every_public_name_is_on_the_page() -> None:
    page = reference_page()
    shown = {line.rpartition(".")[2] for line in page.splitlines() if line.startswith("::: ")}
    expected = {*ggavatar.__all__} - {"__version__"}
    assert expected <= shown
    assert all(name.endswith("Options") for name in shown - expected)


def test_options_of_a_function_are_found(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    text = "def paint(run, **options: Unpack[PaintOptions]): ...\ndef plain(run, **others: Any): ...\n"
    (tmp_path / "pictures").mkdir()
    (tmp_path / "pictures" / "paints.py").write_text(text)
    monkeypatch.setattr(api_reference, "ROOT", tmp_path)
    assert list(api_reference.option_types("pictures.paints.paint")) == ["pictures.paints.PaintOptions"]
    assert not list(api_reference.option_types("pictures.paints.plain"))
    assert not list(api_reference.option_types("pictures.absent.paint"))
