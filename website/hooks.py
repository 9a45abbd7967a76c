"""Hooks of mkdocs: pages that are made when the site is built, and links that leave docs/."""

from __future__ import annotations

from pathlib import Path

from mkdocs.config.defaults import MkDocsConfig
from mkdocs.structure.files import File, Files
from mkdocs.structure.pages import Page

from website.command_help import entry_points
from website.command_pages import command_pages
from website.project_links import PAGES, ROOT, linked_files, with_site_links

NAVIGATION = {
    "Commands": lambda: [{"Overview": "commands/index.md"}, *(f"commands/{name}.md" for name in entry_points())],
    "Methods": lambda: [{"Overview": "methods.md"}, *_inside("methods")],
}
"""Sections of the navigation that are filled with whatever there is."""


def on_config(config: MkDocsConfig) -> MkDocsConfig:
    """Fill the sections of the navigation that the configuration leaves empty."""
    for section in (entry for entry in config.nav or [] if isinstance(entry, dict)):
        for title in section.keys() & NAVIGATION.keys():
            section[title] = list(NAVIGATION[title]())
    return config


def on_files(files: Files, config: MkDocsConfig) -> Files:
    """Add the pages that are not in docs/, and the files that pages link to."""
    for source, path in PAGES.items():
        files.append(File.generated(config, path, content=_text(source)))
    for path, text in command_pages().items():
        files.append(File.generated(config, path, content=text))
    linked = {
        target for file in files.documentation_pages() for target in linked_files(file.content_string, _origin(file))
    }
    for target in sorted(linked):
        files.append(File.generated(config, target, abs_src_path=str(ROOT / target)))
    return files


def on_page_markdown(markdown: str, page: Page, config: MkDocsConfig, files: Files) -> str:
    """Turn links that are right in the repository into links that are right on the site."""
    if page.is_homepage:
        page.meta["hide"] = ["navigation", "toc"]
    return with_site_links(markdown, _origin(page.file))


def _origin(file: File) -> str:
    """Where a page is in the repository; a page that is made here counts as one of docs/."""
    sources = {path: source for source, path in PAGES.items()}
    return sources.get(file.src_uri, f"docs/{file.src_uri}")


def _text(name: str) -> str:
    return (ROOT / name).read_text(encoding="utf-8")


def _inside(folder: str) -> list[str]:
    """Pages of a folder of docs/, by name."""
    return sorted(f"{folder}/{path.name}" for path in Path(ROOT / "docs" / folder).glob("*.md"))
