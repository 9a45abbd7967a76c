"""`import ggavatar`: every public name exists, is documented, typed and lazy. Also covers `ggavatar/__init__.py`."""

from __future__ import annotations

import ast
import importlib
import inspect
import re
import subprocess
import sys
from pathlib import Path

import pytest

import ggavatar

ROOT = Path(__file__).parents[3]
PAGE = ROOT / "docs" / "api.md"
STUB = ROOT / "ggavatar" / "__init__.pyi"


def stub_modules() -> dict[str, str]:
    """Modules by the names that the stub imports from them."""
    nodes = [node for node in ast.parse(STUB.read_text()).body if isinstance(node, ast.ImportFrom)]
    assert all(alias.name == alias.asname for node in nodes for alias in node.names)
    return {alias.name: str(node.module) for node in nodes for alias in node.names}


def test_the_page_lists_them_all() -> None:
    """Names in the first column of the tables of docs/api.md, without what is in their brackets."""
    listed = re.findall(r"^\| `(?:ggavatar\.)?(\w+)", PAGE.read_text(), re.MULTILINE)
    assert sorted(listed) == sorted(ggavatar.__all__)


def test_type_checkers_see_the_same_objects() -> None:
    modules = stub_modules()
    assert sorted(modules) == sorted(set(ggavatar.__all__) - {"__version__"})
    for name, module in modules.items():
        assert getattr(ggavatar, name) is getattr(importlib.import_module(module), name), name


@pytest.mark.parametrize("name", sorted(set(ggavatar.__all__) - {"__version__"}))
def test_every_name_is_documented_and_typed(name: str) -> None:
    found = getattr(ggavatar, name)
    assert len(inspect.getdoc(found) or "") > 20
    if inspect.isfunction(found):
        signature = inspect.signature(found)
        assert signature.return_annotation is not inspect.Signature.empty
        for argument in signature.parameters.values():
            if argument.kind is not inspect.Parameter.VAR_KEYWORD or argument.name != "options":
                assert argument.name in (inspect.getdoc(found) or ""), f"{name}: {argument.name}"


def test_importing_it_imports_nothing_else() -> None:
    code = (
        "import sys; before = set(sys.modules); import ggavatar; dir(ggavatar); "
        "print(sorted(name for name in set(sys.modules) - before if '.' not in name))"
    )
    shown = subprocess.run([sys.executable, "-c", code], cwd=ROOT, capture_output=True, text=True, check=True)
    assert shown.stdout.strip() == "['ggavatar']"


def test_no_name_is_that_of_a_room() -> None:
    """Importing a room would put the module in the place of the function."""
    rooms = {path.parent.name for path in (ROOT / "ggavatar").glob("*/__init__.py")}
    assert not rooms & set(ggavatar.__all__)


def test_an_old_installation_says_so(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("ggavatar.plugins.entry_points.own_entry_points", lambda group: {})
    monkeypatch.delitem(vars(ggavatar), "score_run", raising=False)
    with pytest.raises(ImportError, match="score_run: the installed package is older than this source"):
        _ = ggavatar.score_run
    with pytest.raises(AttributeError, match="no attribute 'spam'"):
        _ = ggavatar.spam
