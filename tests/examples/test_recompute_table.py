"""The scripts in examples/ find every number of a table in the files beside it, and notice a changed one."""

from __future__ import annotations

import ast
import dataclasses
import json
import math
import re
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from evaluate.tables.write import build_tables, write_copies, write_tables
from tests.support.evaluations import evaluation

EXAMPLES = Path(__file__).parents[2] / "examples"
SCRIPTS = ("recompute_table.py", "recompute_intervals.py")


def write_study(folder: Path) -> list[Path]:
    """Two subjects, three methods, one of them with two seeds; returns the result files."""
    random = np.random.default_rng(0)
    runs = []
    for subject in ("Anna", "Bert"):
        for method, seed in (("a", 1), ("a", 2), ("b", 1), ("c", None)):
            columns = [random.uniform(low, high, 33).tolist() for low, high in ((20, 40), (0.8, 1), (0, 0.3))]
            columns[2] = [value + 0.2 * (method == "b") for value in columns[2]]
            columns[0][5] = math.inf if method == "b" else columns[0][5]
            lpips = () if method == "c" else columns[2]
            runs.append(evaluation(subject, method, columns[0], columns[1], lpips, seed))
    costs = {"fps": 31.5, "gaussians": 5000, "model_megabytes": None}
    runs[0] = dataclasses.replace(runs[0], efficiency=costs)
    paths = write_copies(runs, folder)
    write_tables(build_tables(runs, paper=True), folder / "tables", paths)
    return paths


def recompute(folder: Path, script: str) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, str(EXAMPLES / script), str(folder / "tables" / "table.json")]
    return subprocess.run(command, capture_output=True, text=True, check=False)


def test_every_printed_number_is_found_again(tmp_path: Path) -> None:
    write_study(tmp_path)
    tables = json.loads((tmp_path / "tables" / "table.json").read_text())["tables"]
    tables = [table for table in tables if table["name"] != "sources"]
    paper = "paper (protocol not stated)"
    cells = [cell for table in tables for row in table["rows"] if row["section"] != paper for cell in row["cells"]]
    printed = [cell for cell in cells if re.search(r"\d", cell["text"])]
    assert all(cell["source"] for cell in printed)
    assert {cell["source"]["statistic"] for cell in printed} == {
        "mean", "median", "worst_5_percent", "std_over_frames", "std_over_seeds", "count", "difference", "efficiency",
    }  # fmt: skip
    differences = [cell for cell in printed if cell["source"]["statistic"] == "difference"]
    intervals, numbers = recompute(tmp_path, SCRIPTS[1]), recompute(tmp_path, SCRIPTS[0])
    assert intervals.returncode == 0, intervals.stderr
    assert [line.split(": ")[1] for line in intervals.stdout.splitlines()] == [cell["text"] for cell in differences]
    assert any(cell["text"].endswith("*") for cell in differences)
    assert not all(cell["text"].endswith("*") for cell in differences)
    assert numbers.returncode == 0, numbers.stderr
    found = [line.split(" = ")[0].split()[-1] for line in numbers.stdout.splitlines()]
    texts = [cell["text"] for cell in printed if cell["source"]["statistic"] != "difference"]
    assert found == [part for text in texts for part in text.split(" ± ")]
    assert any("±" in text for text in texts)
    assert len(found) > 150


@pytest.mark.parametrize("script", SCRIPTS)
def test_a_changed_number_is_noticed(tmp_path: Path, script: str) -> None:
    for path in write_study(tmp_path):
        content = json.loads(path.read_text())
        content["per_frame"]["psnr"][3] += 1.0 + 2.0 * (content["method"] == "a")
        path.write_text(json.dumps(content))
    done = recompute(tmp_path, script)
    assert done.returncode == 1
    assert " is not " in done.stderr


@pytest.mark.parametrize("script", SCRIPTS)
def test_the_scripts_have_twenty_lines(script: str) -> None:
    body = ast.parse((EXAMPLES / script).read_text(encoding="utf-8")).body
    kinds = (ast.stmt, ast.excepthandler)
    statements = [node for top in body for node in ast.walk(top) if isinstance(node, kinds)]
    imports = [node for node in statements if isinstance(node, (ast.Import, ast.ImportFrom))]
    sentences = [node for node in statements if isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant)]
    assert len(statements) - len(imports) - len(sentences) <= 22
