"""The one part of the packaging that pyproject.toml cannot say: README.md as a package index can show it.

README.md links to files of the repository by relative addresses, so that every copy of the repository shows its own
pictures. A package index has no such files. Where pyproject.toml names the repository (`Repository` in
`[project.urls]`), addresses become absolute; where it does not, pictures are left out and links become plain text.
"""

from __future__ import annotations

import re
import tomllib
from pathlib import Path

from setuptools import setup

ROOT = Path(__file__).parent
LINK = re.compile(r"(?P<picture>!?)\[(?P<text>[^\]]*)\]\((?P<target>(?!https?:|mailto:|#)[^)\s]+)\)")


def description(readme: str, repository: str | None) -> str:
    """The text of README.md without addresses that are relative to the repository."""

    def readable(match: re.Match[str]) -> str:
        if repository:
            kind = "raw" if match["picture"] else "blob"
            return f"{match['picture']}[{match['text']}]({repository.rstrip('/')}/{kind}/HEAD/{match['target']})"
        return "" if match["picture"] else match["text"]

    return re.sub(r"\n{3,}", "\n\n", LINK.sub(readable, readme))


def repository_address() -> str | None:
    """Where pyproject.toml says that the repository is."""
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    return project.get("urls", {}).get("Repository")


if __name__ == "__main__":
    setup(
        long_description=description((ROOT / "README.md").read_text(encoding="utf-8"), repository_address()),
        long_description_content_type="text/markdown",
    )
