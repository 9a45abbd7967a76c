r"""Text in LaTeX, for pdfTeX with `\usepackage[T1]{fontenc}` and `\usepackage[utf8]{inputenc}`."""

from __future__ import annotations

import re
import unicodedata

from ggavatar.text.names import displayable

COMMANDS = {
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
    "…": r"\ldots{}",
    "±": r"$\pm$",
    "↑": r"$\uparrow$",
    "↓": r"$\downarrow$",
    "σ": r"$\sigma$",
    "λ": r"$\lambda$",
    "Δ": r"$\Delta$",
    "−": "$-$",
    "×": r"$\times$",
    "·": r"$\cdot$",
    "†": r"$\dagger$",
    "≥": r"$\geq$",
    "≤": r"$\leq$",
    "<": r"\textless{}",
    ">": r"\textgreater{}",
    "|": r"\textbar{}",
    '"': r"\textquotedbl{}",
    "[": "{[}",
    "*": "{*}",
}
"""What stands for characters that TeX would obey or that its fonts have in mathematics only."""

MISSING = frozenset("ĦħĸĿŀŉŦŧſ")
"""Letters up to U+017F that the T1 encoding does not have (LaTeX's t1enc.dfu)."""

_SPECIAL = re.compile(r"[^A-Za-z0-9 .,:;()/+=]")
_LIGATURES = re.compile(r"(?<=[-`'!?,])(?=[-`',])")


def latex_text(text: str) -> str:
    """The text for a paragraph, a cell or a caption, with a true minus sign before numbers.

    A letter that T1 lacks keeps the part that T1 has (ễ becomes ê); anything else becomes a question mark, so that the
    file compiles.
    """
    composed = unicodedata.normalize("NFC", displayable(text))
    signed = re.sub(r"(?<![\w-])-(?=\d)", "−", composed)
    return _SPECIAL.sub(_in_tex, _LIGATURES.sub("\0", signed))


def _in_tex(found: re.Match[str]) -> str:
    return _letter(found[0])


def _letter(letter: str) -> str:
    if letter == "\0":
        return "{}"  # keeps "--" or "?`" from becoming another sign
    if letter in COMMANDS:
        return COMMANDS[letter]
    if letter.isascii() or ("\u00a1" <= letter <= "\u017f" and letter not in MISSING):
        return letter
    parts = unicodedata.normalize("NFD", letter)
    if len(parts) > 1:
        return _letter(unicodedata.normalize("NFC", parts[:-1]))
    return "" if unicodedata.category(letter) in ("Mn", "Me", "Cf") else "?"
