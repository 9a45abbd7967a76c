"""Every cell of `examples/notebooks/` runs, on a smaller person; what a cell ends with can be shown.

The cells run in this process one after another, as a kernel would run them: a kernel would only add its start and a
dependency. The notebooks share a folder of files, so that the first one's run serves the others; each makes its own
where it is opened alone. Also covers `preprocess/api/captures.py`.
"""

from __future__ import annotations

import ast
import json
import shutil
import sys
from pathlib import Path
from typing import Any

import pytest

ROOT = Path(__file__).parents[2]
NOTEBOOKS = {path.stem: path for path in sorted((ROOT / "examples" / "notebooks").glob("*.ipynb"))}
ORDER = ("video-to-avatar", "score-your-renders", "method-in-a-package", "drive-by-a-curve")
SMALL = {"FRAMES": 24, "SIZE": 128, "STEPS": 20}


def code_cells(path: Path) -> list[tuple[str, bool]]:
    """Sources of the code cells, and whether each holds the parameters."""
    cells = [cell for cell in json.loads(path.read_text(encoding="utf-8"))["cells"] if cell["cell_type"] == "code"]
    return [("".join(cell["source"]), "parameters" in cell["metadata"].get("tags", ())) for cell in cells]


def run_cell(source: str, names: dict[str, Any]) -> str:
    """Run a cell and return what a notebook would show of its last expression."""
    body = ast.parse(source).body
    last = body.pop() if body and isinstance(body[-1], ast.Expr) else None
    exec(compile(ast.Module(body, []), "cell", "exec"), names)
    if last is None:
        return ""
    value = eval(compile(ast.Expression(last.value), "cell", "eval"), names)
    return str(value._repr_html_()) if hasattr(value, "_repr_html_") else repr(value)


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Where the notebooks work, with a copy of the package to install (pip leaves files beside its source)."""
    folder = tmp_path_factory.mktemp("notebooks")
    shutil.copytree(ROOT / "examples" / "plugin", folder / "plugin")
    return folder


@pytest.mark.slow
@pytest.mark.parametrize("name", ORDER)
def test_every_cell_runs(
    name: str, folder: Path, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(folder)
    monkeypatch.setenv("MPLBACKEND", "Agg")
    monkeypatch.setenv("PIP_NO_INDEX", "1")
    monkeypatch.setattr(sys, "path", list(sys.path))
    names: dict[str, Any] = {"__name__": "__main__"}
    shown = []
    for source, is_parameters in code_cells(NOTEBOOKS[name]):
        shown.append(run_cell(source, names))
        if is_parameters:
            names |= {**SMALL, "PLUGIN": str(folder / "plugin")}
    import matplotlib.pyplot as plt

    plt.close("all")
    assert "Traceback" not in capfd.readouterr().err
    assert all(len(text) < 20_000 for text in shown)
    expected = {
        "video-to-avatar": ["Diagnosis(", "Run('ggavatar', 20 steps", "PSNR", "avatar.html"],
        "score-your-renders": ["blurred", "Evaluation('with background'", "table.tex"],
        "method-in-a-package": ["Painted mesh: one Gaussian", "Run('painted_mesh', 20 steps", "Edges ↓", "painted.xyz"],
        "drive-by-a-curve": ["Performance(35 frames at 30 fps", "curves.mp4", "curves.html"],
    }[name]
    assert all(any(words in text for text in shown) for words in expected), shown


def test_none_is_forgotten_and_none_stores_outputs() -> None:
    assert sorted(ORDER) == sorted(NOTEBOOKS)
    page = (ROOT / "examples" / "notebooks" / "README.md").read_text()
    for name, path in NOTEBOOKS.items():
        assert f"]({name}.ipynb)" in page
        for cell in json.loads(path.read_text(encoding="utf-8"))["cells"]:
            assert not cell.get("outputs") and cell.get("execution_count") is None
