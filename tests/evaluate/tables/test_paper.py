"""The paper's Tables 1 and 2 come out of paper.csv cell by cell, marks included, and the LaTeX is well formed."""

from __future__ import annotations

import re
import shutil
import subprocess
from collections.abc import Sequence
from pathlib import Path

import pytest

from evaluate.tables.format_latex import MAX_ROWS, PREAMBLE, to_latex
from evaluate.tables.paper import NOTE, paper_table_1, paper_table_2, read_paper, with_paper
from evaluate.tables.study import studies
from evaluate.tables.table import BEST, DASH, SECOND, Table
from evaluate.tables.write import build_tables
from tests.support.evaluations import PROTOCOL, evaluation

# R marks what the paper prints on red, Y what it prints on yellow; copied from its source by hand.
TABLE_1 = """
ID 1 | 25.40  0.892  0.147  | 27.63  0.918  0.089Y | 32.00Y 0.938Y 0.121  | 33.61R 0.956R 0.060R
ID 2 | 24.77  0.893  0.142  | 20.29  0.899  0.106Y | 26.67Y 0.922Y 0.123  | 28.23R 0.939R 0.079R
ID 3 | 23.52  0.917  0.107  | 24.31  0.936  0.088  | 24.99R 0.938Y 0.087Y | 24.76Y 0.942R 0.064R
ID 4 | 19.43  0.797  0.215  | 19.51  0.836  0.186  | 25.58Y 0.917Y 0.126Y | 26.02R 0.932R 0.064R
ID 5 | 23.76  0.933  0.070  | 27.30Y 0.965Y 0.053Y | 26.96  0.926  0.103  | 27.35R 0.968R 0.046R
"""
TABLE_2 = """
w/o Geometry Morph Adjuster | 28.43  0.926  0.092
w/o tri-plane               | 33.41Y 0.953  0.061Y
w/o LBS                     | 33.01  0.952  0.062
w/o initialization          | 33.34  0.954Y 0.062
Ours                        | 33.61R 0.956R 0.060R
"""
COLORS = {"R": "\\cellcolor{red!25}", "Y": "\\cellcolor{yellow!25}", "": ""}


def printed(text: str) -> dict[str, list[str]]:
    """Cells by row, such as `33.61R`."""
    rows = [line.partition("|") for line in text.strip().splitlines()]
    return {label.strip(): cells.replace("|", " ").split() for label, _, cells in rows}


def latex_rows(table: Table) -> dict[str, list[str]]:
    """Cells by row as they stand in the LaTeX source."""
    source = to_latex([table])
    body = source.split("\\hline\\hline")[1].split("\n")
    rows = [line.strip().removesuffix("\\\\").split(" & ") for line in body if "&" in line and "column" not in line]
    return {label: [cell.strip() for cell in cells] for label, *cells in rows}


@pytest.mark.parametrize(("table", "expected"), [(paper_table_1(), TABLE_1), (paper_table_2(), TABLE_2)])
def test_the_papers_tables_are_reproduced_cell_by_cell(table: Table, expected: str) -> None:
    signs = {BEST: "R", SECOND: "Y", "": ""}
    found = {row.label: [cell.text + signs[cell.mark] for cell in row.cells] for row in table.rows}
    assert found == printed(expected)
    source = {label: [COLORS[cell[5:]] + cell[:5] for cell in cells] for label, cells in printed(expected).items()}
    assert latex_rows(table) == source


def test_table_1_has_the_papers_60_cells_and_heading() -> None:
    table = paper_table_1()
    assert sum(len(row.cells) for row in table.rows) == 60
    source = to_latex([table])
    assert "\\begin{tabular}{c|ccc|ccc|ccc|ccc}" in source
    heading = (
        r"\multicolumn{3}{c|}{PointAvatar} & \multicolumn{3}{c|}{GaussianAvatars} & \multicolumn{3}{c|}{FlashAvatar}"
    )
    assert heading + r" & \multicolumn{3}{c}{Ours} \\" in source
    assert source.count(r"PSNR $\uparrow$ & SSIM $\uparrow$ & LPIPS $\downarrow$") == 4


def test_every_row_of_the_csv_says_that_the_protocol_is_not_stated() -> None:
    text = (Path(__file__).parents[3] / "evaluate" / "tables" / "paper.csv").read_text(encoding="utf-8").splitlines()
    assert len(text) == 26
    assert all(line.endswith("protocol not stated") for line in text[1:])
    assert len(read_paper()) == 25


def test_the_papers_rows_stand_beside_ours_without_being_ranked_against_them() -> None:
    study = studies([evaluation("ID 1", "ggavatar", (99.0, 99.0)), evaluation("ID 1", "mine", (20.0, 20.0))])[0]
    table = with_paper(study)
    groups = list(dict.fromkeys(column.group for column in table.columns))
    assert groups == ["GGAvatar", "mine", "PointAvatar", "GaussianAvatars", "FlashAvatar"]
    ours, first = table.rows[0], table.rows[1]
    assert (ours.section, first.section) == ("ours", "paper (protocol not stated)")
    assert ours.cells[0].mark == BEST
    assert [cell.text for cell in ours.cells[6:9]] == [DASH] * 3
    assert first.cells[0].text == "33.61"
    assert first.cells[0].mark == BEST
    assert first.cells[12].mark == SECOND
    assert NOTE in table.notes
    assert len(table.rows) == 6


def test_an_ablation_stands_beside_the_papers_table_2() -> None:
    runs = [evaluation("Anna", "ggavatar"), evaluation("Anna", "ggavatar_without_lbs", (20.0, 21.0))]
    (table, *_) = build_tables(runs, "ablation", paper=True)
    assert [row.label for row in table.rows][:2] == ["w/o LBS", "GGAvatar"]
    assert [row.section for row in table.rows] == ["Anna"] * 2 + ["ID 1, paper (protocol not stated)"] * 5
    assert table.rows[1].cells[0].mark == BEST
    assert [cell.text + cell.mark for cell in table.rows[-1].cells] == ["33.61best", "0.956best", "0.060best"]
    assert table.rows[-1].label == "GGAvatar"


def environments_close(source: str) -> bool:
    stack = []
    for kind, name in re.findall(r"\\(begin|end)\{([^}]*)\}", source):
        if kind == "begin":
            stack.append(name)
        elif not stack or stack.pop() != name:
            return False
    return not stack


def test_latex_is_well_formed_for_tables_of_every_kind() -> None:
    runs = [evaluation(f"50% _{name}_ & {{x}}", method, lpips=()) for name in "ab" for method in ("m_1", "m#2")]
    tables = build_tables(runs, paper=True)
    source = to_latex([*tables, paper_table_1(), paper_table_2()])
    assert environments_close(source)
    assert source.count("{") - source.count(r"\{") == source.count("}") - source.count(r"\}")
    assert all(ord(character) < 128 or character in "–" for character in re.sub(r"[§·⌈⌉]", "", source)), source
    for block in re.findall(r"\\begin\{tabular\}\{([^}]*)\}(.*?)\\end\{tabular\}", source, flags=re.DOTALL):
        width = block[0].count("c")
        for line in block[1].splitlines():
            spans = sum(int(count) - 1 for count in re.findall(r"\\multicolumn\{(\d+)\}", line))
            if line.strip().endswith("\\\\"):
                assert len(re.findall(r"(?<!\\)&", line)) + 1 + spans == width


def test_a_row_may_begin_with_what_would_be_an_argument_of_the_line_break() -> None:
    runs = [evaluation("[x]", "a"), evaluation("*", "a")]
    source = to_latex(build_tables(runs))
    assert "\n    {[}x]" in source
    assert "\n    {*} &" in source
    assert not re.search(r"\\\\\s*[\[*]", source)


def pdf_pages(folder: Path, tables: Sequence[Table], options: str = "") -> str:
    """The text of a document that takes in the tables as a user does, with the packages that our comment names."""
    (folder / "table.tex").write_text(to_latex(tables), encoding="utf-8")
    packages = PREAMBLE.removeprefix("% ")
    document = (
        f"\\documentclass[{options}]{{article}}\n{packages}\\begin{{document}}\\input{{table}}\\end{{document}}\n"
    )
    (folder / "paper.tex").write_text(document)
    command = ["pdflatex", "-interaction=nonstopmode", "-halt-on-error", "paper.tex"]
    done = subprocess.run(command, cwd=folder, capture_output=True, check=False)
    log = (folder / "paper.log").read_text(encoding="latin-1")
    assert done.returncode == 0, log[-2000:]
    assert "Overfull" not in log and "too large" not in log, "everything fits the page"
    return subprocess.run(["pdftotext", "-layout", "paper.pdf", "-"], cwd=folder, capture_output=True, text=True).stdout


needs_latex = pytest.mark.skipif(
    not (shutil.which("pdflatex") and shutil.which("pdftotext")),
    reason="needs pdflatex and pdftotext (Debian: texlive-latex-recommended, poppler-utils)",
)


@needs_latex
def test_the_papers_tables_compile_and_print_every_cell(tmp_path: Path) -> None:
    text = pdf_pages(tmp_path, [paper_table_1(), paper_table_2()])
    lines = [line.split() for line in text.splitlines()]
    for expected in (TABLE_1, TABLE_2):
        for label, cells in printed(expected).items():
            wanted = [*label.split(), *(cell[:5] for cell in cells)]
            assert wanted in lines


@needs_latex
@pytest.mark.parametrize("options", ["", "twocolumn"])
def test_our_tables_compile_and_fit_the_page(tmp_path: Path, options: str) -> None:
    runs = [evaluation(f"50% of #{k} & {{B_b}}", m) for k in range(5) for m in ("ggavatar", "x_y ☃", "[a]*")]
    runs += [evaluation("Anna", "ggavatar", (33.0 + k, -1.5), lpips=(), seed=k) for k in range(2)]
    regions = PROTOCOL.override(regions=tuple(f"part{k}" for k in range(30)))
    long = build_tables([evaluation("Anna", "ggavatar", protocol=regions)])
    tables = [*build_tables(runs, paper=True), *build_tables(runs[:4], "ablation", paper=True), *long]
    tall = [table for table in tables if len(table.rows) > MAX_ROWS]
    assert {len({row.section for row in table.rows}) > 1 for table in tall} == {True, False}
    text = pdf_pages(tmp_path, tables, options)
    assert "50% of #4 & {B_b}" in text
    assert "no weights: alexnet_features.pth" in " ".join(text.split())
