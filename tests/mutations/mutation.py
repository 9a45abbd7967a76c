"""A planted fault as data, and how it is applied to a copy of the project."""

from __future__ import annotations

import shutil
from dataclasses import dataclass
from pathlib import Path

ROOT = Path(__file__).parents[2]

COPIED = ("ggavatar", "preprocess", "evaluate", "tests", "docs", "pyproject.toml", "README.md", "CONTRIBUTING.md")
"""What a copy of the project holds: all that tests import or read."""


class StaleMutation(ValueError):
    """The old text of a mutation is not found exactly once in its file: the code has changed."""


@dataclass(frozen=True)
class Mutation:
    """A fault that tests must notice.

    A change that no test could see (an equivalent mutant) does not belong in the list.
    """

    name: str
    """Unique name that says what is wrong."""
    file: str
    """Path of the source file below the root of the project."""
    old: str
    """Text that occurs exactly once in the file."""
    new: str
    """Text in its place."""
    tests: tuple[str, ...]
    """Tests that should see it, as pytest takes them: files or, to take seconds only, `FILE::TEST`."""

    def planted(self, text: str) -> str:
        """The file's text with the fault.

        Raises:
            StaleMutation: `old` does not occur exactly once, or nothing changes.
        """
        count = text.count(self.old)
        if count != 1 or self.old == self.new:
            raise StaleMutation(
                f"{self.name}: expected the old text once in {self.file}, found it {count} times; change the list in "
                f"tests/mutations to what the code says now:\n{self.old}"
            )
        return text.replace(self.old, self.new)

    def plant(self, root: Path) -> None:
        """Change the file in a copy of the project and forget its bytecode; never the checkout itself."""
        assert root.resolve() != ROOT.resolve(), "mutations are applied to copies only"
        path = root / self.file
        path.write_text(self.planted(path.read_text(encoding="utf-8")), encoding="utf-8")
        for bytecode in (path.parent / "__pycache__").glob(f"{path.stem}.*"):
            bytecode.unlink()


def copy_project(root: Path, target: Path) -> None:
    """Copy what `COPIED` lists and `root` has to an empty folder."""
    target.mkdir(parents=True, exist_ok=True)
    for name in COPIED:
        source = root / name
        if source.is_dir():
            shutil.copytree(source, target / name, ignore=shutil.ignore_patterns("__pycache__", "*.egg-info"))
        elif source.is_file():
            shutil.copy(source, target / name)
