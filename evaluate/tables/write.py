"""Builds the tables of all evaluations and writes them in every format."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from pathlib import Path

from evaluate.escaping.file_names import file_stem
from evaluate.protocols.results import Evaluation, to_json
from evaluate.tables import format_data, format_html, format_latex, format_markdown
from evaluate.tables.comparison import ablation_table, subjects_table
from evaluate.tables.details import detail_table, efficiency_table, significance_table
from evaluate.tables.paper import ablation_with_paper, paper_table_1, paper_table_2, with_paper
from evaluate.tables.paper_aligned import ablation_table_aligned, parse_paper_subjects, subjects_table_aligned
from evaluate.tables.provenance import sources_table
from evaluate.tables.study import Study, studies
from evaluate.tables.table import Table
from ggavatar.io.atomic import write_text

RENDERERS = {
    "md": format_markdown.to_markdown,
    "tex": format_latex.to_latex,
    "csv": format_data.to_csv,
    "html": format_html.to_page,
}


def build_tables(
    evaluations: Sequence[Evaluation], layout: str = "auto", paper: bool = False, paper_subjects: Sequence[str] = ()
) -> list[Table]:
    """The main table of every protocol, followed by paired differences, costs, details and what was scored.

    Args:
        evaluations: Any number of evaluations, in the order in which subjects and methods appear.
        layout: `subjects` as in the paper's Table 1, `ablation` as in its Table 2; `auto` takes the latter for one
            subject with more than four methods.
        paper: Add the paper's rows below ours, or return its tables alone without evaluations.
        paper_subjects: The paper's subject for each of ours, as `NAME=ID`; its numbers then stand in the same lines.

    Raises:
        InputError: Two evaluations of one subject, method, seed and protocol, or an unknown subject.
    """
    tables: list[Table] = [paper_table_1(), paper_table_2()] if paper and not evaluations else []
    aligned = parse_paper_subjects(paper_subjects, list(dict.fromkeys(e.subject for e in evaluations)))
    for study in studies(evaluations):
        tables.append(_main_table(study, layout, paper, aligned))
        tables += [found for found in (significance_table(study), efficiency_table(study)) if found]
        tables += [detail_table(study), sources_table(study)]
    return tables


def _main_table(study: Study, layout: str, paper: bool, aligned: Mapping[str, str]) -> Table:
    many = len(study.subjects) == 1 and len(study.methods) > 4
    is_ablation = layout == "ablation" or (layout == "auto" and many)
    if here := {ours: theirs for ours, theirs in aligned.items() if ours in study.subjects}:
        return ablation_table_aligned(study, here) if is_ablation else subjects_table_aligned(study, here)
    if paper:
        return ablation_with_paper(study) if is_ablation else with_paper(study)
    return ablation_table(study) if is_ablation else subjects_table(study)


def write_tables(tables: Sequence[Table], folder: Path, results: Sequence[Path]) -> list[Path]:
    """Write `table.md`, `.tex`, `.csv`, `.json` and `.html` atomically and return their paths.

    Args:
        tables: Tables from `build_tables`.
        folder: Output folder.
        results: Result files behind the tables; `table.json` lists them relative to the folder.
    """
    relative = [Path(os.path.relpath(path, folder)).as_posix() for path in results]
    texts = {f"table.{suffix}": render(tables) for suffix, render in RENDERERS.items()}
    texts["table.json"] = format_data.to_json(tables, relative)
    for name, text in texts.items():
        write_text(folder / name, text)
    return [folder / name for name in texts]


def write_copies(evaluations: Sequence[Evaluation], folder: Path) -> list[Path]:
    """Write copies of the results behind a table into its folder, under the labels of the table, and return them."""
    paths = []
    for place, evaluation in enumerate(evaluations):
        name = file_stem(f"{place:02d}-{evaluation.subject}-{evaluation.method}")
        paths.append(folder / "results" / f"{name}.json")
        write_text(paths[-1], to_json(evaluation.as_dict()))
    return paths
