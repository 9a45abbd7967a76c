"""JSON objects from and to files: strict, of bounded size, written atomically."""

from __future__ import annotations

import json
import re
from pathlib import Path
from typing import Any

from ggavatar.errors import InputError
from ggavatar.io.atomic import write_text

MAX_JSON_BYTES = 1 << 26
"""Largest JSON file that is read (64 MiB)."""


def read_json(path: Path, limit: int = MAX_JSON_BYTES) -> dict[str, Any]:
    """Read a JSON object from a file of at most `limit` bytes.

    Raises:
        InputError: No such file, larger than `limit`, not valid JSON, not an object, or holding NaN or infinity.
    """
    try:
        with path.open("rb") as file:
            text = file.read(limit + 1)
    except (FileNotFoundError, NotADirectoryError) as error:
        raise InputError(f"{path}: no such file") from error
    except IsADirectoryError as error:
        raise InputError(f"{path}: expected a JSON file, found a folder") from error
    if len(text) > limit:
        raise InputError(f"{path}: expected at most {limit / 2**20:g} MiB of JSON, found more; not one of our files")
    return parse_json(path, text)


def parse_json(path: Path, text: bytes) -> dict[str, Any]:
    """A JSON object from the bytes of a file, or of a part of it.

    Raises:
        InputError: Not valid JSON, not an object, or holding NaN or infinity.
    """

    def refuse(constant: str) -> float:
        raise ValueError(f"{constant} is not a JSON number")

    try:
        data = json.loads(text.decode("utf-8"), parse_constant=refuse)
    except (ValueError, RecursionError) as error:
        raise InputError(f"{path}: not valid JSON ({error})") from error
    if not isinstance(data, dict):
        raise InputError(f"{path}: expected a JSON object, found {type(data).__name__}")
    return data


def readable_json(value: Any, indent: int | None = None) -> str:
    """A value as JSON with letters of every script as they are; NaN and infinity raise `ValueError`.

    Halves of surrogate pairs, which stand for undecodable bytes of file names, are escaped: UTF-8 has none.
    """
    text = json.dumps(value, indent=indent, allow_nan=False, ensure_ascii=False)
    return re.sub("[\ud800-\udfff]", lambda found: f"\\u{ord(found[0]):04x}", text)


def write_json(path: Path, values: dict[str, Any]) -> None:
    """Write a JSON object atomically; NaN and infinity raise `ValueError`."""
    write_text(path, json.dumps(values, indent=1, allow_nan=False) + "\n")
