"""Tables: ranks, ties, missing cells, seeds, means, and the marks in every format.

Also covers `evaluate/protocols/method_names.py`.
"""

from __future__ import annotations

import dataclasses
import io
import json
import math

import pytest
from rich.console import Console

from evaluate.tables.comparison import ablation_table, subjects_table
from evaluate.tables.details import detail_table, efficiency_table, significance_table
from evaluate.tables.format_data import to_csv, to_json
from evaluate.tables.format_html import to_page
from evaluate.tables.format_latex import to_latex
from evaluate.tables.format_markdown import to_markdown
from evaluate.tables.format_terminal import column_chunks, show
from evaluate.tables.provenance import ranges
from evaluate.tables.study import Study, studies
from evaluate.tables.table import BEST, DASH, SECOND, Cell, Column, Row, Table, missing_cell, number_cell, rank_marks
from evaluate.tables.write import build_tables
from ggavatar.errors import InputError
from tests.support.evaluations import PROTOCOL, evaluation


def numbers(*values: float | None) -> list[Cell]:
    return [missing_cell("absent") if value is None else number_cell(value, 2) for value in values]


def test_best_and_second_follow_the_direction() -> None:
    assert rank_marks(numbers(30.1, 28.0, 29.0), True, 2) == [BEST, "", SECOND]
    assert rank_marks(numbers(30.1, 28.0, 29.0), False, 2) == ["", BEST, SECOND]


def test_ties_after_rounding_share_their_mark() -> None:
    assert rank_marks(numbers(30.001, 30.004, 29.0, 29.004, 28.0), True, 2) == [BEST, BEST, SECOND, SECOND, ""]


def test_missing_cells_have_no_rank_and_one_competitor_none_either() -> None:
    assert rank_marks(numbers(None, 30.0, 29.0), True, 2) == ["", BEST, SECOND]
    assert rank_marks(numbers(None, 30.0), True, 2) == ["", ""]


def test_identical_images_beat_every_number() -> None:
    assert rank_marks([*numbers(99.0), Cell("identical"), *numbers(98.0)], True, 2) == [SECOND, BEST, ""]


def study() -> Study:
    runs = [
        evaluation("Anna", "ggavatar", (33.0, 34.0), (0.95, 0.96), (0.05, 0.06)),
        evaluation("Anna", "flash_avatar", (31.0, 32.0), (0.95, 0.96), (0.10, 0.12)),
        evaluation("Bert", "ggavatar", (28.0, 29.0), (0.90, 0.91), (0.07, 0.08)),
        evaluation("Bert", "flash_avatar", (28.5, 29.5), (0.91, 0.92), ()),
        evaluation("Cleo", "ggavatar", (20.0, 22.0), (0.80, 0.81), (0.2, 0.2)),
    ]
    return studies(runs)[0]


def test_the_comparison_has_subjects_methods_and_metrics() -> None:
    table = subjects_table(study())
    assert [column.group for column in table.columns] == ["GGAvatar"] * 3 + ["FlashAvatar"] * 3
    assert [column.title for column in table.columns[:3]] == ["PSNR ↑", "SSIM ↑", "LPIPS ↓"]
    texts = {row.label: [cell.text for cell in row.cells] for row in table.rows}
    assert texts["Anna"] == ["33.50", "0.955", "0.055", "31.50", "0.955", "0.110"]
    assert texts["Bert"] == ["28.50", "0.905", "0.075", "29.00", "0.915", DASH]
    assert texts["Cleo"][3:] == [DASH] * 3
    marks = {row.label: [cell.mark for cell in row.cells] for row in table.rows}
    assert marks["Anna"] == [BEST, BEST, BEST, SECOND, BEST, SECOND]
    assert marks["Bert"] == [SECOND, SECOND, "", BEST, BEST, ""]
    assert marks["Cleo"] == [""] * 6


def test_the_mean_row_takes_subjects_that_every_method_has() -> None:
    row = subjects_table(study()).rows[-1]
    assert row.label == "mean of 1–2"
    assert [cell.text for cell in row.cells] == ["31.00", "0.930", "0.055", "30.25", "0.935", "0.110"]
    assert row.cells[0].source is not None
    assert row.cells[0].source.subjects == ("Anna", "Bert")


def test_dashes_have_reasons() -> None:
    table = subjects_table(study())
    rows = {row.label: row for row in table.rows}
    assert "alexnet_features.pth" in rows["Bert"].cells[5].reason
    assert rows["Cleo"].cells[3].reason == "FlashAvatar was not evaluated on Cleo"
    assert any("alexnet_features.pth" in note for note in table.notes)


def test_seeds_give_a_deviation_labelled_apart_from_frames() -> None:
    runs = [evaluation("Anna", "ggavatar", (30.0 + seed, 32.0 + seed), seed=seed) for seed in (0, 1, 2)]
    found = studies(runs)[0]
    cell = subjects_table(found).rows[0].cells[0]
    assert cell.text == "32.00 ± 1.00"
    assert cell.deviation == pytest.approx(1)
    assert any("over seeds, not over frames" in note for note in subjects_table(found).notes)
    rows = [row for row in detail_table(found).rows if row.label.startswith("PSNR, ")]
    assert [row.label for row in rows] == ["PSNR, seed 0", "PSNR, seed 1", "PSNR, seed 2"]
    assert rows[0].cells[4].text == f"{math.sqrt(2):.2f}"
    assert [row.cells[5].text for row in rows] == ["1.00", DASH, DASH]


def test_runs_that_cannot_be_told_apart_are_refused() -> None:
    with pytest.raises(InputError, match="two evaluations"):
        studies([evaluation("Anna", "m", seed=1), evaluation("Anna", "m", seed=1)])
    with pytest.raises(InputError, match="without a seed"):
        studies([evaluation("Anna", "m", seed=1), evaluation("Anna", "m")])


def test_protocols_never_share_a_table() -> None:
    other = PROTOCOL.override(background="black")
    tables = build_tables([evaluation("Anna", "a"), evaluation("Anna", "b", protocol=other)])
    main = [table for table in tables if table.name == "comparison"]
    assert [len(table.columns) for table in main] == [3, 3]
    assert [table.protocol for table in main] == [PROTOCOL.id, other.id]
    assert other.digest[:12] in main[1].caption


def test_different_ground_truths_are_pointed_out() -> None:
    other = dataclasses.replace(evaluation("Anna", "b"), hashes={"ground_truth": "another"})
    table = subjects_table(studies([evaluation("Anna", "a"), other])[0])
    assert any("different ground truths" in note for note in table.notes)


def test_identical_renders_are_named_not_numbered() -> None:
    perfect = evaluation("Anna", "copy", (math.inf, math.inf), (1.0, 1.0), (0.0, 0.0))
    table = subjects_table(studies([perfect, evaluation("Anna", "other")])[0])
    assert table.rows[0].cells[0].text == "identical"
    assert table.rows[0].cells[0].mark == BEST
    partly = evaluation("Anna", "part", (math.inf, 40.0))
    notes = subjects_table(studies([partly])[0]).notes
    assert any("1 identical frames" in note for note in notes)


def test_the_ablation_ranks_down_and_ends_with_the_full_method() -> None:
    runs = [
        evaluation("Anna", "ggavatar", (33.0, 34.0)),
        evaluation("Anna", "ggavatar-no-triplane", (32.0, 33.0)),
        evaluation("Anna", "ggavatar-no-lbs", (31.0, 32.0)),
    ]
    table = ablation_table(studies(runs)[0])
    assert [row.label for row in table.rows] == ["ggavatar-no-triplane", "ggavatar-no-lbs", "GGAvatar"]
    assert [row.cells[0].mark for row in table.rows] == [SECOND, "", BEST]
    assert [row.cells[1].mark for row in table.rows] == [BEST] * 3
    assert table.rows[-1].rule


def test_significance_compares_frames_pairwise() -> None:
    better = [30 + 0.1 * math.sin(k) for k in range(40)]
    worse = [value - 0.5 for value in better]
    runs = [evaluation("Anna", method, psnr, [0.9] * 40, [0.1] * 40) for method, psnr in (("a", better), ("b", worse))]
    table = significance_table(studies(runs)[0])
    assert table is not None
    assert table.rows[0].label == "a − b"
    assert table.rows[0].cells[0].text == "+0.50 [+0.50, +0.50]*"
    assert table.rows[0].cells[1].text == "+0.000 [+0.000, +0.000]"
    assert significance_table(studies(runs[:1])[0]) is None


def test_costs_are_shown_with_what_the_speed_includes() -> None:
    known = dataclasses.replace(
        evaluation("Anna", "a"), efficiency={"fps": 12.34, "fps_statement": "FPS includes the head.", "gaussians": 1000}
    )
    table = efficiency_table(studies([known])[0])
    assert table is not None
    assert [cell.text for cell in table.rows[0].cells] == ["12.3", "1000", DASH, DASH, DASH]
    assert table.notes == ("FPS includes the head.",)
    assert efficiency_table(studies([evaluation("Anna", "a")])[0]) is None


def test_every_format_says_what_was_scored() -> None:
    frames = (0, 20, 21, 22, *range(40, 200, 20))
    digests = {"predictions": "a1" * 32, "ground_truth": "b2" * 32}
    run = evaluation("Anna", "a", [30.0] * 12, [0.9] * 12, [0.1] * 12, 7)
    run = dataclasses.replace(run, frames=frames, hashes=digests)
    tables = build_tables([run, evaluation("Anna", "b")])
    row = tables[-1].rows[0]
    assert row.label == "Anna · a, seed 7"
    assert [cell.text for cell in row.cells[:4]] == ["–"] * 4
    assert row.cells[4].text == "0, 20–22, 40, 60, …, 120, 140, 160, 180"
    assert row.cells[4].reason == "0, 20–22, 40, 60, 80, 100, 120, 140, 160, 180"
    assert [cell.reason for cell in row.cells[5:]] == [PROTOCOL.digest, *digests.values()]
    assert ranges((3, 5, 6)) == "3, 5–6"
    for render in (to_markdown, to_latex, to_csv, to_page, to_json):
        text = render(tables).replace("\\_", "_")
        assert PROTOCOL.id in text and PROTOCOL.digest[:16] in text, render
        assert "a1" * 8 in text and "b2" * 8 in text, render
        assert "20–22" in text or "20--22" in text, render


def test_markdown_is_exact() -> None:
    table = subjects_table(studies([evaluation("A|b", "x_y"), evaluation("A|b", "z", (29.0, 30.0))])[0])
    lines = to_markdown([table]).splitlines()
    assert lines[2] == "| Metrics | x\\_y PSNR ↑ | x\\_y SSIM ↑ | x\\_y LPIPS ↓ | z PSNR ↑ | z SSIM ↑ | z LPIPS ↓ |"
    assert lines[3] == "| --- | ---: | ---: | ---: | ---: | ---: | ---: |"
    assert lines[4] == "| A\\|b | **30.50** | **0.910** | **0.090** | <u>29.50</u> | **0.910** | **0.090** |"


def test_json_and_csv_hold_unrounded_numbers_marks_and_reasons() -> None:
    tables = build_tables([*study().evaluations])
    content = json.loads(to_json(tables), parse_constant=lambda text: pytest.fail(text))
    cells = content["tables"][0]["rows"][1]["cells"]
    assert cells[0]["value"] == 28.5
    assert cells[5]["value"] is None
    assert "alexnet" in cells[5]["reason"]
    lines = to_csv(tables).splitlines()
    assert lines[0].startswith("table,section,row,group,column,value")
    assert f"comparison,,Anna,GGAvatar,PSNR ↑,33.5,,33.50,best,,{PROTOCOL.id},setup not recorded" in lines
    assert sum(table_cells(tables)) == len(lines) - 1


def table_cells(tables: list[Table]) -> list[int]:
    return [len(table.rows) * len(table.columns) for table in tables]


def test_html_is_self_contained_escaped_and_marked() -> None:
    page = to_page(build_tables([evaluation("<Anna>", "a"), evaluation("<Anna>", "b", (20.0, 21.0), lpips=())]))
    assert "&lt;Anna&gt;" in page
    assert "<Anna>" not in page
    assert '<td class="gg-best" title="setup not recorded">30.50</td>' in page
    assert '<td class="gg-second" title="setup not recorded">20.50</td>' in page
    assert "http" not in page
    assert 'title="no weights' in page


@pytest.mark.parametrize("width", [40, 80, 200])
def test_the_terminal_shows_every_number_at_any_width(width: int) -> None:
    console = Console(file=io.StringIO(), width=width)
    table = subjects_table(study())
    show(table, console)
    text = console.file.getvalue()  # type: ignore[attr-defined]
    for row in table.rows:
        for cell in row.cells:
            assert cell.text in text
    assert "33.50*" in text
    assert "31.50'" in text
    assert "…" not in text
    assert sorted(place for part in column_chunks(table, width) for place in part) == list(range(6))


def test_a_row_with_a_wrong_number_of_cells_is_our_own_mistake() -> None:
    with pytest.raises(ValueError, match="expected 1 cells"):
        Table("t", "c", "r", (Column("a"),), (Row("x", ()),))
