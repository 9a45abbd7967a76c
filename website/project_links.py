"""Links between the pages of the site and files of the repository that are not in docs/.

A page of docs/ links to what it means in the repository, so that it can be read there too. On the site README.md is the
first page, CONTRIBUTING.md and CHANGELOG.md are pages, and any other file that a page links to is copied.
"""

from __future__ import annotations

import posixpath
import re
from collections.abc import Iterator
from pathlib import Path

ROOT = Path(__file__).parents[1]
PAGES = {"README.md": "index.md", "CONTRIBUTING.md": "contributing.md", "CHANGELOG.md": "changelog.md"}
"""Files of the repository that become pages of the site."""
FENCED = re.compile(r"(^```.*?^```)", re.DOTALL | re.MULTILINE)
LINK = re.compile(r"(\]\()([^)\s#]+)((?:#[^)\s]*)?\))")


def with_site_links(text: str, origin: str) -> str:
    """Markdown of the file at `origin` (relative to the repository) with links as they are on the site."""
    here = posixpath.dirname(site_path(origin))

    def relative(match: re.Match[str]) -> str:
        target = _in_repository(match[2], origin)
        if target is None or not (ROOT / target).is_file():
            return match[0]  # a web address, or a broken link, which mkdocs reports
        return f"{match[1]}{posixpath.relpath(site_path(target), here or '.')}{match[3]}"

    parts = FENCED.split(text)
    return "".join(part if place % 2 else LINK.sub(relative, part) for place, part in enumerate(parts))


def linked_files(text: str, origin: str) -> Iterator[str]:
    """Files outside docs/ that a page links to and that are no pages, relative to the repository."""
    for match in LINK.finditer(FENCED.sub("", text)):
        target = _in_repository(match[2], origin)
        if target and not target.startswith("docs/") and target not in PAGES and (ROOT / target).is_file():
            yield target


def site_path(path: str) -> str:
    """Where a file of the repository is on the site."""
    return PAGES.get(path, path.removeprefix("docs/"))


def _in_repository(target: str, origin: str) -> str | None:
    """A link's target relative to the repository; None for web addresses and what lies outside."""
    if "://" in target or target.startswith(("mailto:", "/")):
        return None
    path = posixpath.normpath(posixpath.join(posixpath.dirname(origin), target))
    return None if path.startswith("..") else path
