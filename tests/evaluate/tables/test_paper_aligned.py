"""The paper's numbers (Li et al. 2024, Tables 1 and 2) in the lines of our subjects, marked and ranked apart."""

from __future__ import annotations

import pytest

from evaluate.tables.format_data import to_csv
from evaluate.tables.format_latex import to_latex
from evaluate.tables.format_markdown import to_markdown
from evaluate.tables.paper_aligned import parse_paper_subjects
from evaluate.tables.write import build_tables
from ggavatar.errors import InputError
from tests.support.evaluations import evaluation


def runs(*subjects: str, methods: tuple[str, ...] = ("ggavatar", "flash_avatar")) -> list:
    levels = dict(zip(methods, (40.0, 20.0, 10.0), strict=False))
    return [evaluation(subject, method, (levels[method],) * 2) for subject in subjects for method in methods]


def test_a_line_has_our_numbers_and_the_papers() -> None:
    table = build_tables(runs("b", "a", "c"), paper_subjects=["a=ID1,b=3"])[0]
    groups = list(dict.fromkeys(column.group for column in table.columns))
    assert groups == [
        "GGAvatar", "FlashAvatar", "PointAvatar †", "GaussianAvatars †", "FlashAvatar †", "GGAvatar †",
    ]  # fmt: skip
    rows = {row.label: [cell.text for cell in row.cells] for row in table.rows}
    assert list(rows) == ["b (ID 3)", "a (ID 1)", "c", "mean of 3"]
    assert rows["a (ID 1)"][0] == "40.00" and rows["a (ID 1)"][6:9] == ["25.40", "0.892", "0.147"]
    assert rows["a (ID 1)"][-3:] == ["33.61", "0.956", "0.060"]
    assert rows["b (ID 3)"][-3:] == ["24.76", "0.942", "0.064"]
    assert rows["c"][6:] == rows["mean of 3"][6:] == ["–"] * 12


def test_ours_and_theirs_are_ranked_apart() -> None:
    table = build_tables(runs("a"), paper_subjects=["a=ID 1"])[0]
    marks = [cell.mark for cell in table.rows[0].cells[::3]]
    assert marks == ["best", "second", "", "", "second", "best"]


def test_every_format_says_that_the_protocol_is_not_stated() -> None:
    tables = build_tables(runs("a"), paper_subjects=["a=ID1"])[:1]
    for render in (to_markdown, to_latex, to_csv):
        assert "its protocol is not stated" in render(tables)
    assert "?" not in to_latex(tables) and r"GGAvatar $\dagger$" in to_latex(tables)
    assert "a = ID 1" in tables[0].notes[0] and "Not ranked with ours" in tables[0].notes[0]


def test_an_ablation_has_the_papers_table_2_beside_it() -> None:
    methods = ("ggavatar", "ggavatar_without_lbs", "mine")
    table = build_tables(runs("a", "b", methods=methods), "ablation", paper_subjects=["a=ID1"])[0]
    rows = {(row.section, row.label): row.cells for row in table.rows}
    assert [cell.text for cell in rows["a (ID 1)", "w/o LBS"][3:]] == ["33.01", "0.952", "0.062"]
    assert [cell.text for cell in rows["a (ID 1)", "GGAvatar"][3:]] == ["33.61", "0.956", "0.060"]
    assert [cell.text for cell in rows["a (ID 1)", "mine"][3:]] == ["–"] * 3
    assert [cell.text for cell in rows["b", "GGAvatar"][3:]] == ["–"] * 3
    assert rows["a (ID 1)", "GGAvatar"][3].mark == "best" == rows["a (ID 1)", "GGAvatar"][0].mark


@pytest.mark.parametrize("text", ["a", "a=", "a=ID9", "a=x", "=ID1", "a=ID1,"])
def test_nonsense_is_refused(text: str) -> None:
    with pytest.raises(InputError, match="--paper-subjects"):
        parse_paper_subjects([text], ["a"])
    with pytest.raises(InputError, match="did you mean subject-1"):
        parse_paper_subjects(["subjct-1=ID1"], ["subject-1"])


def test_names_may_contain_an_equals_sign() -> None:
    assert parse_paper_subjects(["a=b=id 2"], ["a=b"]) == {"a=b": "ID 2"}
