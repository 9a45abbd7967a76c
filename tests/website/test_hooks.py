"""The pages of the site: those that are made are there, and every method has one with a picture.

The build of the whole site is `make docs`, which CI runs: a broken link or a page outside the menu fails there.
Reference: mkdocs's own collections of files and its menu.
"""

from __future__ import annotations

from pathlib import Path

import pytest

from ggavatar.training import registry
from website.command_pages import PAGES

pytest.importorskip("mkdocs", reason="needs the extra docs")

from mkdocs.commands.build import build
from mkdocs.config import load_config

from website.hooks import on_config

ROOT = Path(__file__).parents[2]
METHODS = sorted({path.stem for path in (ROOT / "ggavatar" / "methods").glob("*.py")} & registry.names().keys())
PAGE = "# A\n\n[c](../CITATION.cff) [r](../README.md) [p](paper.md#a) [gone](gone.md)\n"


@pytest.fixture(scope="module")
def site(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A site of one page of ours in mkdocs's plain theme, with our hooks."""
    folder = tmp_path_factory.mktemp("site")
    (folder / "docs").mkdir()
    (folder / "docs" / "cuda.md").write_text(PAGE, encoding="utf-8")
    (folder / "mkdocs.yml").write_text(
        f"site_name: x\nuse_directory_urls: false\nhooks: [{str(ROOT / 'website' / 'hooks.py')!r}]\n"
        "nav: [index.md, cuda.md, Commands: [], Methods: []]\n",
        encoding="utf-8",
    )
    build(load_config(str(folder / "mkdocs.yml")))
    return folder / "site"


def test_made_pages_and_linked_files_are_there(site: Path) -> None:
    names = ("index.html", "contributing.html", "changelog.html", "commands/index.html")
    for name in (*names, *(f"commands/{command}.html" for command in PAGES)):
        assert (site / name).is_file(), name
    assert (site / "CITATION.cff").read_bytes() == (ROOT / "CITATION.cff").read_bytes()
    assert "GGAvatar+" in (site / "index.html").read_text(encoding="utf-8")


def test_links_into_the_repository_are_links_of_the_site(site: Path) -> None:
    page = (site / "cuda.html").read_text(encoding="utf-8")
    assert 'href="CITATION.cff"' in page and 'href="index.html">r<' in page and 'href="gone.md"' in page


def test_the_menu_has_every_command_and_every_method(site: Path) -> None:
    config = load_config(str(site.parent / "mkdocs.yml"))
    *_, commands, methods = on_config(config).nav or []
    assert commands["Commands"][1:] == [f"commands/{name}.md" for name in PAGES]
    assert methods["Methods"][1:] == [f"methods/{name}.md" for name in METHODS]


@pytest.mark.parametrize("name", METHODS)
def test_every_method_has_a_page_with_a_picture(name: str) -> None:
    docs = ROOT / "docs"
    index, page = docs / "methods.md", docs / "methods" / f"{name}.md"
    text = page.read_text(encoding="utf-8") if page.is_file() else ""
    wanted = {
        f"docs/methods/{name}.md": page.is_file(),
        f"a line with (methods/{name}.md) in docs/methods.md": f"(methods/{name}.md)"
        in index.read_text(encoding="utf-8"),
        f"`{name}` · its paper · its files, below the title": f"\n`{name}` · " in text,
        "**Idea.** and **Measured**": "**Idea.**" in text and "**Measured**" in text,
        f"](../images/methods/{name}.jpg) on the page": f"](../images/methods/{name}.jpg)" in text,
        "the picture (python -m website.method_picture)": (docs / "images" / "methods" / f"{name}.jpg").is_file(),
    }
    assert [what for what, is_there in wanted.items() if not is_there] == []


def test_the_index_of_methods_holds_no_section_of_one() -> None:
    assert "\n## " not in (ROOT / "docs" / "methods.md").read_text(encoding="utf-8")
