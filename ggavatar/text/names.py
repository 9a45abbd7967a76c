"""Names of subjects, methods and settings: any text from a file or a flag goes in, one harmless line comes out.

Cleaned where they enter (flags, capture.json, metrics.json, config.json, baselines, names of folders), so that one
subject has one name in every output. What is special in an output format is the matter of that format's escaper
(`ggavatar.text.terminal`, `evaluate.escaping`), and each of them stands on its own: it may be given any text.

Letters of every script, marks, digits, punctuation, symbols and emoji with their joiners are kept as they are.
"""

from __future__ import annotations

import re
import unicodedata
from typing import Any

MAX_NAME = 120
"""Longest name, in characters; what is cut is shown as an ellipsis."""

MAX_TEXT = 10_000
"""Longest sentence from a file, such as a note, in characters."""

UNNAMED = "unnamed"
REPLACEMENT = "\ufffd"
JOINERS = "\u200c\u200d"
"""Invisible characters that spell words of Persian and Indian languages and join emoji."""

_FILLERS = "\u115f\u1160\u3164\uffa0"  # letters of Hangul that have no shape
_FORMATS = (
    "\xad\u061c\u180e\u200b\u200e\u200f\u202a-\u202e\u2060-\u206f\ufeff\ufff9-\ufffb"
    "\U0001bca0-\U0001bca3\U0001d173-\U0001d17a\U000e0000-\U000e007f"
)
_SURROGATES = "\ud800-\udfff"
_LAST_OF_PLANES = (chr(plane | 0xFFFE) + chr(plane | 0xFFFF) for plane in range(0, 0x110000, 0x10000))
_NONCHARACTERS = "\ufdd0-\ufdef" + "".join(_LAST_OF_PLANES)
_SPACES = re.compile(r"\s+")
NOT_TEXT = re.compile(f"[\0-\x1f\x7f-\x9f{_SURROGATES}{_NONCHARACTERS}]")
"""Control characters, halves of surrogate pairs (which stand for undecodable bytes of file names), noncharacters."""

INVISIBLE = re.compile(f"[{_FILLERS}{_FORMATS}]")
"""Characters without a shape: Unicode's Cf without joiners and the signs that enclose digits or hieroglyphs, and
Hangul's fillers. Those of direction change the order in which others are shown."""


def displayable(text: str) -> str:
    """The text on one line, without characters that steer the program that shows it.

    White space, line breaks included, becomes single spaces, what is `NOT_TEXT` becomes U+FFFD, and what is `INVISIBLE`
    is left out.
    """
    return NOT_TEXT.sub(REPLACEMENT, _SPACES.sub(" ", INVISIBLE.sub("", text)).strip())


def clean_name(text: str) -> str:
    """A name: displayable, composed (Unicode NFC), at most `MAX_NAME` characters, and `unnamed` if nothing is left.

    A cleaned name is cleaned to itself.
    """
    name = _shortened(unicodedata.normalize("NFC", displayable(text)), MAX_NAME)
    return name if name.strip(JOINERS) else UNNAMED


def clean_text(text: str) -> str:
    """A sentence or a setting of any kind: displayable, and at most `MAX_TEXT` characters."""
    return _shortened(displayable(text), MAX_TEXT)


def clean_values(value: Any) -> Any:
    """JSON values with every text in them cleaned, keys of objects included."""
    if isinstance(value, str):
        return clean_text(value)
    if isinstance(value, dict):
        return {clean_text(key) if isinstance(key, str) else key: clean_values(entry) for key, entry in value.items()}
    return [clean_values(entry) for entry in value] if isinstance(value, list) else value


def _shortened(text: str, limit: int) -> str:
    return text if len(text) <= limit else f"{text[: limit - 1].rstrip()}…"
