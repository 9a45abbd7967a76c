"""The pages of the site: made ones are added, a broken link stops a strict build, nothing is left out of the menu.

Also covers `website/hooks.py`. The build of the whole site is `make docs`, which CI runs. Reference: mkdocs itself, on a
copy of mkdocs.yml with a few pages.
"""

from __future__ import annotations

import logging
from pathlib import Path

import pytest

from ggavatar.training import registry

ROOT = Path(__file__).parents[2]
mkdocs_config = pytest.importorskip("mkdocs.config", reason="needs the extra docs")

from mkdocs.commands.build import build  # noqa: E402 - after the skip
from mkdocs.structure.files import get_files  # noqa: E402
from mkdocs.structure.nav import get_navigation  # noqa: E402

from website.hooks import on_config, on_files  # noqa: E402


def test_every_method_has_a_page_with_a_picture_and_a_place_in_the_index() -> None:
    """Its text is not in docs/methods.md, which is the index: move the section to docs/methods/METHOD.md."""
    index = (ROOT / "docs" / "methods.md").read_text(encoding="utf-8")
    assert "\n## " not in index
    for name in {variant.partition("_with")[0] for variant in registry.names()} & {
        path.stem for path in (ROOT / "ggavatar" / "methods").glob("*.py")
    }:
        page = ROOT / "docs" / "methods" / f"{name}.md"
        assert page.is_file() and f"(methods/{name}.md)" in index, name
        assert (ROOT / "docs" / "images" / "methods" / f"{name}.jpg").is_file(), name
        assert f"../images/methods/{name}.jpg" in page.read_text(encoding="utf-8"), name
