"""CSV: the csv module reads back what was written, no cell is a formula, and numbers stay numbers."""

from __future__ import annotations

import csv
import io
import re

import pytest
from hypothesis import given

from evaluate.escaping.csv_cells import csv_cell, csv_text
from ggavatar.text.names import displayable
from tests.support.hostile_names import HOSTILE, NATURAL, TEXTS, patient

FORMULA = re.compile(r"^\s*[=+\-@\t\r\n＝＋－＠]")
"""OWASP, CSV Injection: what a cell must not begin with."""


def is_number(text: str) -> bool:
    return bool(re.fullmatch(r"[-+]?(\d+\.?\d*|\.\d+)(e[-+]?\d+)?%?", text.strip(), re.IGNORECASE))


def is_safe(cell: str) -> bool:
    """No formula, or one of nothing but numbers, such as our intervals, in which there is no letter to call."""
    return (
        not FORMULA.match(cell)
        or not re.search(r"[^-+\d.eE±%*,\[\] ]|[=@]", cell)
        or cell.lstrip("+-") in ("inf", "nan")
    )


@patient
@given(TEXTS)
def test_a_spreadsheet_computes_nothing(text: str) -> None:
    """Read with commas, and with semicolons as programs in many countries read it, where quotes do not begin a cell."""
    written = csv_text([(text, "x")])
    (row,) = csv.reader(io.StringIO(written))
    assert len(row) == 2
    if is_number(row[0]):
        return
    cells = [row[0], *re.split(r"[;\t]", written)]
    for delimiter in ";\t":
        cells += [cell for line in csv.reader(io.StringIO(written), delimiter=delimiter) for cell in line]
    assert not [cell for cell in cells if not is_safe(cell)]


@patient
@given(TEXTS)
def test_only_apostrophes_are_added(text: str) -> None:
    assert csv_cell(text).replace("'", "") == displayable(text).replace("'", "")


@pytest.mark.parametrize("name", [*NATURAL, "a-b", "a=1", "identical", "–", "x; y", ""])
def test_ordinary_text_is_kept(name: str) -> None:
    assert csv_cell(name) == name


@pytest.mark.parametrize("text", ["-1.5", "+0.50 [-0.10, +1.10]*", "-3.20 ± 0.10", "1e-05", "-inf", "-.5", "-2%"])
def test_numbers_in_words_are_kept(text: str) -> None:
    assert csv_cell(text) == text


def test_formulas_are_text() -> None:
    assert csv_cell("=1+1") == "'=1+1"
    assert csv_cell("\t=1") == "'=1"
    assert csv_cell("-x") == "'-x" and csv_cell("-1-cmd") == "'-1-cmd"
    assert csv_cell("a; =1;-2") == "a;' =1;'-2"


def test_numbers_survive_exactly() -> None:
    values = (-0.1, 1 / 3, 1e-300, float("inf"), None)
    ((*read,),) = csv.reader(io.StringIO(csv_text([values])))
    assert [float(text) if text else None for text in read] == list(values)


def test_every_hostile_name_is_one_cell_of_one_line() -> None:
    rows = list(csv.reader(io.StringIO(csv_text([(name, 1.0) for name in HOSTILE]))))
    assert [row[1] for row in rows] == ["1.0"] * len(HOSTILE)
