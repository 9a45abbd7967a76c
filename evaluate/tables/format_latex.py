"""Tables as LaTeX in the layout of the paper's Tables 1 and 2.

Not by pandas' Styler.to_latex, which sets no section rows, rules between groups, notes or boxes that fit a page, and
leaves arrows and other symbols unescaped (tried on Table 1).
"""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator, Sequence

from evaluate.escaping.latex import latex_text
from evaluate.tables.table import BEST, SECOND, Cell, Row, Table

PREAMBLE = r"""% \usepackage[T1]{fontenc} \usepackage[utf8]{inputenc} \usepackage[table]{xcolor} \usepackage{graphicx}
"""
"""The packages that a document needs to include our tables with \\input."""

MAX_NARROW_COLUMNS = 6
"""A table with more columns than this spans both columns of a page."""

MAX_ROWS = 45
"""A table with more rows than this is split into one table per section, so that each fits on a page."""

SCALE_BOXES = (
    r"  \resizebox{\ifdim\width>\linewidth \linewidth\else\width\fi}{!}{%",
    r"  \resizebox*{!}{\ifdim\totalheight>0.75\textheight 0.75\textheight\else\totalheight\fi}{%",
)
"""Boxes that scale their content down to the width and most of the height of a page, but never up."""

COLORS = {BEST: "red!25", SECOND: "yellow!25"}


def to_latex(tables: Sequence[Table]) -> str:
    """Table environments one after the other; a comment lists the required packages."""
    escaped = (table.with_texts(latex_text) for table in tables)
    return PREAMBLE + "\n".join(_table(part) for table in escaped for part in _parts(table))


def _parts(table: Table) -> Iterator[Table]:
    """The table itself, or one table per section of a tall one; the notes follow the last."""
    sections = list(dict.fromkeys(row.section for row in table.rows))
    if len(table.rows) <= MAX_ROWS or len(sections) == 1:
        yield table
        return
    for section in sections:
        rows = tuple(dataclasses.replace(row, section="") for row in table.rows if row.section == section)
        notes = table.notes if section == sections[-1] else ()
        yield dataclasses.replace(table, caption=f"{section}. {table.caption}", rows=rows, notes=notes)


def _table(table: Table) -> str:
    environment = "table*" if len(table.columns) > MAX_NARROW_COLUMNS else "table"
    lines = [f"\\begin{{{environment}}}[tp]", "  \\centering", f"  \\caption{{{_caption(table)}}}\\smallskip"]
    lines += [
        *SCALE_BOXES,
        f"  \\begin{{tabular}}{{{_alignment(table)}}}",
        "    \\hline\\hline",
        *_heading(table),
        "    \\hline",
    ]
    lines += [*_body(table), "    \\hline\\hline", "  \\end{tabular}}}"]
    lines += [rf"  \par\smallskip{{\footnotesize\raggedright {note}\par}}" for note in table.notes]
    return "\n".join([*lines, f"\\end{{{environment}}}", ""])


def _caption(table: Table) -> str:
    """The caption, followed by the color key if any cell is marked."""
    colored = any(cell.mark for row in table.rows for cell in row.cells)
    key = r" \colorbox{red!25}{Red} indicates the best and \colorbox{yellow!25}{yellow} indicates the second."
    return table.caption + (key if colored else "")


def _alignment(table: Table) -> str:
    """`c|ccc|ccc`: rules after the labels and between groups; `c|c|c` without groups."""
    spans = table.groups
    return "c|" + ("|".join("c" * span for _, span in spans) if spans else "|".join("c" for _ in table.columns))


def _heading(table: Table) -> list[str]:
    lines = []
    if spans := table.groups:
        cells = [rf"\multicolumn{{1}}{{c|}}{{{table.group_corner}}}"]
        for place, (name, span) in enumerate(spans):
            rule = "" if place == len(spans) - 1 else "|"
            cells.append(rf"\multicolumn{{{span}}}{{c{rule}}}{{{name}}}")
        lines += [f"    {' & '.join(cells)} \\\\", "    \\hline"]
    titles = [rf"\multicolumn{{1}}{{c|}}{{{table.corner}}}", *(c.title for c in table.columns)]
    return [*lines, f"    {' & '.join(titles)} \\\\"]


def _body(table: Table) -> list[str]:
    lines: list[str] = []
    section = ""
    for row in table.rows:
        if row.section and row.section != section:
            span = len(table.columns) + 1
            lines += ["    \\hline"] if lines else []
            lines += [rf"    \multicolumn{{{span}}}{{c}}{{\textit{{{row.section}}}}} \\", "    \\hline"]
            section = row.section
        lines += ["    \\hline"] if row.rule and lines else []
        lines.append(f"    {_row(row)} \\\\")
    return lines


def _row(row: Row) -> str:
    return " & ".join([row.label, *(_cell(cell) for cell in row.cells)])


def _cell(cell: Cell) -> str:
    text = cell.text
    return rf"\cellcolor{{{COLORS[cell.mark]}}}{text}" if cell.mark else text
