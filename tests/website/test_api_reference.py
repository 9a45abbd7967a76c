"""The reference names what the package offers. Reference: `ggavatar.__all__`, and stubs written out here."""

from __future__ import annotations

import ggavatar
from website.api_reference import CORE, STUB, public_names, reference_page

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
    expected = {*ggavatar.__all__} - {"__version__"} if STUB.is_file() else {name.rpartition(".")[2] for name in CORE}
    assert shown == expected
