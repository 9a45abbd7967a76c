"""Paths, names and modules that the documentation mentions exist.

The pages are those of docs/ (except the dated records in docs/experiments), README.md and CONTRIBUTING.md. Checked are
`path.py` and `path.py:Name, Class.method`, relative to the repository, a package, tests/ or a folder named on the same
line; dotted names such as `ggavatar.optim.seeding.seeded`; and `test_name` or `test_prefix_…`.
"""

from __future__ import annotations

import ast
import functools
import importlib
import re
from collections.abc import Iterator
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
PAGES = [
    *sorted((ROOT / "docs").glob("*.md")),
    *sorted((ROOT / "docs" / "methods").glob("*.md")),
    ROOT / "README.md",
    ROOT / "CONTRIBUTING.md",
]
FOLDERS = (ROOT, ROOT / "ggavatar", ROOT / "preprocess", ROOT / "evaluate", ROOT / "tests")
"""What a path may be relative to."""
PLACEHOLDERS = {
    "ggavatar/methods/painted_mesh.py",  # written by the reader of adding-a-method.md
    "recompute_intervals.py",  # written by ggavatar-eval beside its results
    "tests/PACKAGE/ROOM/test_MODULE.py",  # a pattern in architecture.md
    *(f"ggavatar.{group}" for group in ("capture_formats", "importers", "metrics", "splat_formats")),  # entry points
}
FENCED = re.compile(r"^```.*?^```", re.DOTALL | re.MULTILINE)
QUOTED = re.compile(r"`([^`\n]+)`")
PATH = re.compile(r"([\w./-]+\.py)(?::\s*([A-Za-z_][\w.]*(?:, [A-Za-z_][\w.]*)*))?")
DOTTED = re.compile(r"((?:ggavatar|preprocess|evaluate)(?:\.[A-Za-z_]\w*)+)(?:\(.*\))?")
TEST = re.compile(r"(test_\w+)(…)?")


@functools.cache
def defined_names(path: Path) -> frozenset[str]:
    """Functions, classes, constants, and methods and fields as `Class.name`."""
    return frozenset(_names(ast.parse(path.read_text()).body, ""))


def _names(body: list[ast.stmt], prefix: str) -> Iterator[str]:
    for node in body:
        if isinstance(node, ast.FunctionDef | ast.ClassDef):
            yield prefix + node.name
        if isinstance(node, ast.ClassDef):
            yield from _names(node.body, f"{prefix}{node.name}.")
        targets = (
            node.targets if isinstance(node, ast.Assign) else [node.target] if isinstance(node, ast.AnnAssign) else []
        )
        for name in (name for target in targets for name in ast.walk(target) if isinstance(name, ast.Name)):
            yield prefix + name.id


@functools.cache
def known_tests() -> frozenset[str]:
    """Names of all test functions."""
    functions = (name for path in (ROOT / "tests").rglob("test_*.py") for name in defined_names(path))
    return frozenset(name for name in functions if name.startswith("test_"))


def exists(dotted: str) -> bool:
    """Whether a dotted name is a module, or names reached from one."""
    parts = dotted.split(".")
    for count in range(len(parts), 0, -1):
        try:
            found = importlib.import_module(".".join(parts[:count]))
        except ModuleNotFoundError as error:
            if not dotted.startswith(str(error.name)):
                raise
            continue
        for name in parts[count:]:
            if not hasattr(found, name):
                return name in getattr(found, "__annotations__", {})
            found = getattr(found, name)
        return True
    return False


def complaints(text: str) -> list[str]:
    """What a page mentions that does not exist."""
    found = []
    for line in FENCED.sub("", text).splitlines():
        mentions = [quoted for quoted in QUOTED.findall(line) if quoted not in PLACEHOLDERS]
        subfolders = [quoted for quoted in mentions if quoted.endswith("/")]
        places = [*FOLDERS, *(folder / subfolder for folder in FOLDERS for subfolder in subfolders)]
        for quoted in mentions:
            found += complaints_about(quoted, places)
    return found


def complaints_about(quoted: str, places: list[Path]) -> list[str]:
    """What is wrong with one mention, a path in it being relative to one of `places`."""
    if match := PATH.fullmatch(quoted):
        files = [place / match[1] for place in places if (place / match[1]).is_file()]
        if not files:
            return [f"{match[1]}: no such file"]
        wanted = match[2].split(", ") if match[2] else []
        return [f"{match[1]}: no {name}" for name in wanted if name not in defined_names(files[0])]
    if match := DOTTED.fullmatch(quoted):
        return [] if exists(match[1]) else [f"{match[1]}: cannot be imported"]
    if match := TEST.fullmatch(quoted):
        known = any(name.startswith(match[1]) if match[2] else name == match[1] for name in known_tests())
        return [] if known else [f"{quoted}: no such test"]
    return []


@pytest.mark.parametrize("page", PAGES, ids=lambda page: str(page.relative_to(ROOT)))
def test_what_a_page_mentions_exists(page: Path) -> None:
    found = complaints(page.read_text())
    assert not found, "\n".join(found)


def test_the_readme_is_one_screen_with_the_commands_that_ci_runs() -> None:
    text = (ROOT / "README.md").read_text(encoding="utf-8")
    commands = re.findall(r"^make (\w+)", "\n".join(FENCED.findall(text)), re.MULTILINE)
    assert commands == ["demo", "test"] and len(text.splitlines()) <= 45
    continuous = (ROOT / ".ci" / "run").read_text(encoding="utf-8")
    assert all(f"make {command} " in continuous for command in commands)


def test_the_pages_mention_something() -> None:
    mentions = [quoted for page in PAGES for quoted in QUOTED.findall(page.read_text())]
    assert sum(bool(PATH.fullmatch(quoted)) for quoted in mentions) > 20
    assert sum(bool(DOTTED.fullmatch(quoted)) for quoted in mentions) > 5


@pytest.mark.parametrize(
    ("text", "complaint"),
    [
        ("see `geometry.py:triangle_frames`", "geometry.py: no such file"),
        ("see `geometry/triangles.py:squares`", "geometry/triangles.py: no squares"),
        ("see `methods/ggavatar.py:Config, no_such_rate`", "methods/ggavatar.py: no no_such_rate"),
        ("see `methods/ggavatar.py:GGAvatar.render`", "methods/ggavatar.py: no GGAvatar.render"),
        ("call `ggavatar.optim.seeding.unseeded(3)`", "ggavatar.optim.seeding.unseeded: cannot be imported"),
        ("import `ggavatar.density`", "ggavatar.density: cannot be imported"),
        ("| `losses/` | `no_terms.py` |", "no_terms.py: no such file"),
        ("proved by `test_eq_99_…`", "test_eq_99_…: no such test"),
    ],
)
def test_a_made_up_page_is_refused(text: str, complaint: str) -> None:
    assert complaints(f"# A page\n\n{text}, and `docs` too.\n") == [complaint]


@pytest.mark.parametrize(
    "text",
    [
        "`geometry/triangles.py:triangle_frames` and `ggavatar/geometry/triangles.py`",
        "`methods/ggavatar.py:Config, GGAvatar.losses, VARIANTS, Config.latent`",
        "`ggavatar.optim.seeding.seeded(scene.seed, stream, step)` and `ggavatar.head.model.HeadModel.faces`",
        "`test_eq_4_…`",
        "| `losses/` | the terms (`terms.py`) |",
        "```\n`geometry.py`\n```",
    ],
)
def test_a_right_page_passes(text: str) -> None:
    assert not complaints(text)
