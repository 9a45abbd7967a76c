"""Hooks of mkdocs: pages that are made when the site is built, and links that leave docs/."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

from mkdocs.config.defaults import MkDocsConfig
from mkdocs.structure.files import File, Files
from mkdocs.structure.pages import Page

from website.api_reference import REFERENCE, reference_page
from website.command_pages import PAGES as COMMANDS
from website.command_pages import command_pages
from website.project_links import PAGES, ROOT, linked_files, with_site_links

NAVIGATION: Mapping[str, Callable[[], list[Any]]] = {
    "Commands": lambda: [{"Overview": "commands/index.md"}, *(f"commands/{name}.md" for name in COMMANDS)],
    "Methods": lambda: [{"Overview": "methods.md"}, *_inside("methods")],
    "API": lambda: ["api.md", "plugins.md", REFERENCE],
}
"""Sections of the navigation that are filled with whatever there is."""


def on_config(config: MkDocsConfig) -> MkDocsConfig:
    """Fill the sections of the navigation that the configuration leaves empty."""
    for section in (entry for entry in config.nav or [] if isinstance(entry, dict)):
        for title in section.keys() & NAVIGATION.keys():
            section[title] = NAVIGATION[title]()
    return config


def on_files(files: Files, config: MkDocsConfig) -> Files:
    """Add the pages that are not in docs/, and the files that pages link to, and those that these link to."""
    for source, path in PAGES.items():
        files.append(File.generated(config, path, content=_text(source)))
    for path, text in {**command_pages(), REFERENCE: reference_page()}.items():
        files.append(File.generated(config, path, content=text))
    waiting = list(files.documentation_pages())
    while waiting:
        page = waiting.pop()
        for target in linked_files(page.content_string, _origin(page)):
            if files.get_file_from_path(target) is None:
                files.append(File.generated(config, target, abs_src_path=str(ROOT / target)))
                waiting += [file for file in files.documentation_pages() if file.src_uri == target]
    return files


def on_page_markdown(markdown: str, page: Page, config: MkDocsConfig, files: Files) -> str:
    """Turn links that are right in the repository into links that are right on the site."""
    if page.is_homepage:
        page.meta["hide"] = ["navigation", "toc"]
    return with_site_links(markdown, _origin(page.file))


def _origin(file: File) -> str:
    """Where a page is in the repository; a page that is made here counts as one of docs/."""
    sources = {path: source for source, path in PAGES.items()}
    inside = f"docs/{file.src_uri}"
    is_outside = not (ROOT / inside).is_file() and (ROOT / file.src_uri).is_file()
    return sources.get(file.src_uri, file.src_uri if is_outside else inside)


def _text(name: str) -> str:
    return (ROOT / name).read_text(encoding="utf-8")


def _inside(folder: str) -> list[str]:
    """Pages of a folder of docs/, by name."""
    return sorted(f"{folder}/{path.name}" for path in Path(ROOT / "docs" / folder).glob("*.md"))
