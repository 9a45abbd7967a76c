"""examples/recompute_table.py finds every number of a table in the files beside it, and notices a changed one."""

from __future__ import annotations

import dataclasses
import json
import subprocess
import sys
from pathlib import Path

import numpy as np
from evaluations import evaluation

from evaluate.outputs import build_tables, write_copies, write_tables

SCRIPT = Path(__file__).parents[2] / "examples" / "recompute_table.py"


def write_study(folder: Path) -> list[Path]:
    """Two subjects, three methods, one of them with two seeds; returns the result files."""
    random = np.random.default_rng(0)
    runs = []
    for subject in ("Anna", "Bert"):
        for method, seed in (("a", 1), ("a", 2), ("b", 1), ("c", None)):
            columns = [tuple(random.uniform(low, high, 33).tolist()) for low, high in ((20, 40), (0.8, 1), (0, 0.3))]
            lpips = () if method == "c" else columns[2]
            runs.append(evaluation(subject, method, columns[0], columns[1], lpips, seed))
    costs = {"fps": 31.5, "gaussians": 5000, "model_megabytes": None}
    runs[0] = dataclasses.replace(runs[0], efficiency=costs)
    paths = write_copies(runs, folder)
    write_tables(build_tables(runs, paper=True), folder / "tables", paths)
    return paths


def recompute(folder: Path) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, str(SCRIPT), str(folder / "tables" / "table.json")]
    return subprocess.run(command, capture_output=True, text=True, check=False)


def test_every_number_is_found_again(tmp_path: Path) -> None:
    write_study(tmp_path)
    done = recompute(tmp_path)
    assert done.returncode == 0, done.stderr
    cells = [
        cell
        for table in json.loads((tmp_path / "tables" / "table.json").read_text())["tables"]
        for row in table["rows"]
        if row["section"] != "paper (protocol not stated)"
        for cell in row["cells"]
        if cell["value"] is not None
    ]
    assert all(cell["source"] for cell in cells)
    assert len(done.stdout.splitlines()) == len(cells) > 150
    kinds = {cell["source"]["statistic"] for cell in cells}
    assert kinds == {
        "mean", "median", "worst_5_percent", "std_over_frames", "std_over_seeds", "count", "difference", "efficiency",
    }  # fmt: skip


def test_a_changed_number_is_noticed(tmp_path: Path) -> None:
    first = write_study(tmp_path)[0]
    content = json.loads(first.read_text())
    content["per_frame"]["psnr"][3] += 0.01
    first.write_text(json.dumps(content))
    done = recompute(tmp_path)
    assert done.returncode == 1
    assert "does not follow" in done.stderr


def test_the_script_is_short() -> None:
    lines = SCRIPT.read_text(encoding="utf-8").splitlines()
    code = [line for line in lines if line.strip() and not line.strip().startswith(('"""', "import", "from"))]
    assert len(code) <= 24
