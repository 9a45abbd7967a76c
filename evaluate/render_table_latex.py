"""Tables as LaTeX in the layout of the paper's Tables 1 and 2; needs xcolor (option table) and booktabs."""

from __future__ import annotations

import re
from collections.abc import Sequence

from evaluate.table import BEST, SECOND, Cell, Row, Table

PREAMBLE = r"""% \usepackage[table]{xcolor} \usepackage{booktabs} \usepackage{graphicx}
"""
COLORS = {BEST: "red!25", SECOND: "yellow!25"}
SPECIAL = {
    "\\": r"\textbackslash{}",
    "&": r"\&",
    "%": r"\%",
    "$": r"\$",
    "#": r"\#",
    "_": r"\_",
    "{": r"\{",
    "}": r"\}",
    "~": r"\textasciitilde{}",
    "^": r"\textasciicircum{}",
    "–": "--",
    "±": r"$\pm$",
    "↑": r"$\uparrow$",
    "↓": r"$\downarrow$",
    "σ": r"$\sigma$",
    "Δ": r"$\Delta$",
    "−": "$-$",
    "×": r"$\times$",
    "≥": r"$\geq$",
    "≤": r"$\leq$",
    "<": r"\textless{}",
    ">": r"\textgreater{}",
    "[": "{[}",
    "*": "{*}",
}


def to_latex(tables: Sequence[Table]) -> str:
    """Table environments one after the other; a comment names the packages."""
    return PREAMBLE + "\n".join(_table(table) for table in tables)


def to_document(tables: Sequence[Table]) -> str:
    """A complete document that compiles on its own."""
    packages = "\\usepackage[table]{xcolor}\n\\usepackage{booktabs}\n\\usepackage{graphicx}\n"
    head = f"\\documentclass{{article}}\n\\usepackage[T1]{{fontenc}}\n\\usepackage[utf8]{{inputenc}}\n{packages}"
    return f"{head}\\begin{{document}}\n{to_latex(tables)}\\end{{document}}\n"


def _table(table: Table) -> str:
    wide = len(table.columns) > 6
    environment = "table*" if wide else "table"
    lines = [f"\\begin{{{environment}}}[t]", "  \\centering", f"  \\caption{{{_caption(table)}}}"]
    lines += ["  \\resizebox{\\textwidth}{!}{%"] if wide else []
    lines += [f"  \\begin{{tabular}}{{{_alignment(table)}}}", "    \\hline\\hline", *_heading(table), "    \\midrule"]
    lines += _body(table)
    lines += ["    \\hline\\hline", "  \\end{tabular}%" if wide else "  \\end{tabular}"]
    lines += ["  }"] if wide else []
    lines += [rf"  \par\smallskip{{\footnotesize {escaped(note)}}}" for note in table.notes]
    return "\n".join([*lines, f"\\end{{{environment}}}", ""])


def _caption(table: Table) -> str:
    """The caption; the key to the colours follows where anything is coloured."""
    colored = any(cell.mark for row in table.rows for cell in row.cells)
    key = r" \colorbox{red!25}{Red} indicates the best and \colorbox{yellow!25}{yellow} indicates the second."
    return escaped(table.caption) + (key if colored else "")


def _alignment(table: Table) -> str:
    """`c|ccc|ccc`: a rule after the labels and between groups; `c|c|c` without groups."""
    spans = table.groups
    return "c|" + ("|".join("c" * span for _, span in spans) if spans else "|".join("c" for _ in table.columns))


def _heading(table: Table) -> list[str]:
    lines = []
    if spans := table.groups:
        cells = [rf"\multicolumn{{1}}{{c|}}{{{escaped(table.group_corner)}}}"]
        for place, (name, span) in enumerate(spans):
            rule = "" if place == len(spans) - 1 else "|"
            cells.append(rf"\multicolumn{{{span}}}{{c{rule}}}{{{escaped(name)}}}")
        lines += [f"    {' & '.join(cells)} \\\\", "    \\hline"]
    titles = [rf"\multicolumn{{1}}{{c|}}{{{escaped(table.corner)}}}", *(escaped(c.title) for c in table.columns)]
    return [*lines, f"    {' & '.join(titles)} \\\\"]


def _body(table: Table) -> list[str]:
    lines: list[str] = []
    section = ""
    for row in table.rows:
        if row.section and row.section != section:
            span = len(table.columns) + 1
            lines += ["    \\hline"] if lines else []
            lines += [rf"    \multicolumn{{{span}}}{{c}}{{\textit{{{escaped(row.section)}}}}} \\", "    \\hline"]
            section = row.section
        lines += ["    \\hline"] if row.rule and lines else []
        lines.append(f"    {_row(row)} \\\\")
    return lines


def _row(row: Row) -> str:
    return " & ".join([escaped(row.label), *(_cell(cell) for cell in row.cells)])


def _cell(cell: Cell) -> str:
    text = escaped(cell.text)
    return rf"\cellcolor{{{COLORS[cell.mark]}}}{text}" if cell.mark else text


def escaped(text: str) -> str:
    """Text without any character that means something to TeX, and a true minus before numbers.

    What pdfTeX's fonts do not have (anything beyond Latin letters) becomes a question mark, so that the file compiles.
    """
    signed = re.sub(r"(?<![\w-])-(?=\d)", "−", text)
    return "".join(SPECIAL.get(character, character if ord(character) < 0x180 else "?") for character in signed)
