"""Lines of CSV that a spreadsheet program shows as they are.

Such programs compute what a cell says after `=`, `+`, `-` or `@`, also with a link or a command in it (OWASP, CSV
Injection). An apostrophe before it makes it text. Numbers stay numbers, negative ones too.
"""

from __future__ import annotations

import csv
import io
import re
from collections.abc import Iterable, Sequence

from ggavatar.text.names import displayable

_NUMBER = r"[-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?%?"
_NUMBERS = re.compile(rf"{_NUMBER}(?: ± {_NUMBER})?(?: \[{_NUMBER}, {_NUMBER}\])?\*?|[-+]?(?:inf|nan)")
"""A number, also with its deviation or interval as in our tables: nothing that a program could compute."""

_FORMULA = re.compile(r"""(?:^|(?<=;))["'\s]*[=+\-@＝＋－＠]""")
"""The start of a formula, also in the full-width characters that Excel takes for the same."""


def csv_cell(text: str) -> str:
    """The text, with an apostrophe wherever a spreadsheet program would begin to read a formula.

    A formula may begin at its start, and after semicolons, which separate cells in many countries.
    """
    shown = displayable(text)
    return shown if _NUMBERS.fullmatch(shown) else _FORMULA.sub(r"'\g<0>", shown)


def csv_text(rows: Iterable[Sequence[str | float | None]]) -> str:
    """Rows as CSV: texts as `csv_cell`, numbers exactly, None as an empty cell."""
    stream = io.StringIO()
    writer = csv.writer(stream, lineterminator="\n")
    for row in rows:
        writer.writerow(
            [csv_cell(cell) if isinstance(cell, str) else "" if cell is None else repr(cell) for cell in row]
        )
    return stream.getvalue()
