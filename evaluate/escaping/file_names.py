"""Names of files and folders made from names."""

from __future__ import annotations

import hashlib
import re
import unicodedata

from ggavatar.text.names import clean_name

MAX_BYTES = 80
"""Longest stem; file systems allow 255 bytes with prefix and suffix."""

_DEVICES = re.compile(r"(con|prn|aux|nul|com\d|lpt\d)(\.|$)", re.IGNORECASE)
"""Names that Windows keeps for devices, with any suffix."""


def file_stem(name: str) -> str:
    """A file name without suffix: letters and digits of any script, and `-_.+=`.

    Where anything had to be changed, eight digits of a digest follow, so that different names get different files.
    """
    composed = unicodedata.normalize("NFC", name)
    stem = "".join(letter if letter.isalnum() or letter in "-_.+=" else "-" for letter in clean_name(name))
    stem = stem.encode()[:MAX_BYTES].decode(errors="ignore").strip("-.") or "name"
    if _DEVICES.match(stem):
        stem = f"_{stem}"
    if stem == composed:
        return stem
    return f"{stem}-{hashlib.sha256(composed.encode(errors='surrogatepass')).hexdigest()[:8]}"
