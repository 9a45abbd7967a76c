"""Tables as a self-contained HTML page or as fragments for a report.

Not by pandas' Styler.to_html, which has no section rows and notes and triples the size with styles by cell id (tried on
Table 1), nor by Jinja2, whose import takes 0.1 s in every call of the command.
"""

from __future__ import annotations

from collections.abc import Sequence

from evaluate.escaping.html_text import html_text
from evaluate.tables.table import BEST, SECOND, Cell, Table

STYLE = """
.gg-table { border-collapse: collapse; font: 14px/1.4 system-ui, sans-serif; margin: 1em 0; }
.gg-table caption { text-align: left; font-weight: 600; padding: 0.3em 0; }
.gg-table th, .gg-table td { padding: 0.25em 0.7em; text-align: right; white-space: nowrap; }
.gg-table tbody th, .gg-table thead th:first-child { text-align: left; }
.gg-table thead tr:last-child th { border-bottom: 1px solid currentColor; }
.gg-table thead th.gg-group { text-align: center; border-bottom: 1px solid #bbb; }
.gg-table tr.gg-rule > * { border-top: 1px solid currentColor; }
.gg-table tr.gg-section th { text-align: center; font-style: italic; font-weight: 400; border-top: 1px solid #bbb; }
.gg-table td.gg-best { background: #ffbfbf; color: #000; font-weight: 600; }
.gg-table td.gg-second { background: #ffffbf; color: #000; }
.gg-notes { font: 13px/1.4 system-ui, sans-serif; color: #666; padding-left: 1.2em; }
"""


def to_page(tables: Sequence[Table]) -> str:
    """A self-contained page that needs neither network nor server."""
    body = "\n".join(to_fragment(table) for table in tables)
    head = '<meta charset="utf-8"><meta name="viewport" content="width=device-width"><title>GGAvatar evaluation</title>'
    return f'<!doctype html>\n<html lang="en"><head>{head}<style>{STYLE}</style></head><body>\n{body}\n</body></html>\n'


def to_fragment(table: Table) -> str:
    """One table with its notes, styled by `STYLE`."""
    table = table.with_texts(html_text)
    lines = [f'<table class="gg-table" id="{table.name}">', f"<caption>{table.caption}</caption>"]
    lines += ["<thead>", *_heading(table), "</thead>", "<tbody>", *_body(table), "</tbody></table>"]
    if table.notes:
        lines += ['<ul class="gg-notes">', *(f"<li>{note}</li>" for note in table.notes), "</ul>"]
    return "\n".join(lines)


def _heading(table: Table) -> list[str]:
    lines = []
    if spans := table.groups:
        cells = "".join(f'<th class="gg-group" colspan="{span}">{name}</th>' for name, span in spans)
        lines.append(f"<tr><th>{table.group_corner}</th>{cells}</tr>")
    titles = "".join(f"<th>{column.title}</th>" for column in table.columns)
    return [*lines, f"<tr><th>{table.corner}</th>{titles}</tr>"]


def _body(table: Table) -> list[str]:
    lines = []
    section = ""
    for row in table.rows:
        if row.section and row.section != section:
            span = len(table.columns) + 1
            lines.append(f'<tr class="gg-section"><th colspan="{span}">{row.section}</th></tr>')
            section = row.section
        style = ' class="gg-rule"' if row.rule else ""
        lines.append(f"<tr{style}><th>{row.label}</th>{''.join(map(_cell, row.cells))}</tr>")
    return lines


def _cell(cell: Cell) -> str:
    style = {BEST: ' class="gg-best"', SECOND: ' class="gg-second"'}.get(cell.mark, "")
    words = "; ".join(filter(None, (cell.reason, cell.setup)))
    hint = f' title="{words}"' if words else ""
    return f"<td{style}{hint}>{cell.text}</td>"
