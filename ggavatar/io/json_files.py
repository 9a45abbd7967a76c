"""JSON objects from and to files: strict, of bounded size, written atomically.

What Python's parser accepts or raises beyond the standard is refused here, so that no reader has to: NaN and infinity,
numbers that no float64 or 64-bit integer holds, a name twice in one object, nesting without end,
and files that unpack to more memory than `MAX_VALUE_BYTES`.
"""

from __future__ import annotations

import hashlib
import json
import math
import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from ggavatar.errors import InputError
from ggavatar.io.atomic import write_text
from ggavatar.io.regular_files import read_file

MAX_JSON_BYTES = 1 << 26
"""Largest JSON file that is read (64 MiB)."""

MAX_VALUE_BYTES = 1 << 29
"""Most memory that the values of a file may take (512 MiB); `{}` takes 64 bytes for two."""

SEAL = "content_sha256"
"""Entry of a sealed file: SHA-256 of all other entries."""

_COSTS = {b",": 64, b"[": 96, b"{": 240, b":": 160, b'"': 16}
"""About what CPython needs for the value, list, object, name or text of one such character, bytes."""

_LARGEST = 1 << 64


def read_json(path: Path, limit: int = MAX_JSON_BYTES) -> dict[str, Any]:
    """Read a JSON object from a file of at most `limit` bytes.

    A file of `write_sealed_json` is returned without its seal, after that was checked.

    Raises:
        InputError: No such file, larger than `limit`, not strictly JSON, not an object, or changed since it was sealed.
    """
    values = parse_json(path, read_file(path, limit, "a JSON file"))
    if SEAL in values:
        seal = values.pop(SEAL)
        if seal != digest_of(values):
            raise InputError(
                f"{path}: changed since it was written (its {SEAL} no longer fits); restore it or, if you changed it "
                f"on purpose, remove its entry {SEAL!r}"
            )
    return values


def parse_json(path: Path, text: bytes) -> dict[str, Any]:
    """A JSON object from the bytes of a file, or of a part of it.

    Raises:
        InputError: Not strictly JSON, or not an object.
    """
    try:
        data = parse_value(text)
    except ValueError as error:
        raise InputError(f"{path}: not valid JSON ({str(error)[:200]}); create or copy the file again") from error
    if not isinstance(data, dict):
        raise InputError(f"{path}: expected a JSON object, found {type(data).__name__}; create or copy the file again")
    return data


def readable_json(value: Any, indent: int | None = None) -> str:
    """A value as JSON with letters of every script as they are; NaN and infinity raise `ValueError`.

    Halves of surrogate pairs, which stand for undecodable bytes of file names, are escaped: UTF-8 has none.
    """
    text = json.dumps(value, indent=indent, allow_nan=False, ensure_ascii=False)
    return re.sub("[\ud800-\udfff]", lambda found: f"\\u{ord(found[0]):04x}", text)


def parse_value(text: bytes | str) -> Any:
    """Any JSON value.

    Raises:
        ValueError: Not strictly JSON, or it takes too much memory.
    """
    encoded = text.encode("utf-8", "surrogatepass") if isinstance(text, str) else text
    if sum(cost * encoded.count(mark) for mark, cost in _COSTS.items()) > MAX_VALUE_BYTES:
        raise ValueError(f"more values than {MAX_VALUE_BYTES >> 20} MiB hold")
    try:
        return _DECODER.decode(encoded.decode("utf-8"))
    except RecursionError as error:
        raise ValueError("nested too deeply") from error


def _refuse(constant: str) -> float:
    raise ValueError(f"{constant} is not a JSON number")


def _whole(digits: str) -> int:
    value = int(digits) if len(digits) <= 20 else _LARGEST
    if abs(value) >= _LARGEST:
        raise ValueError(f"{digits:.20}… is too large for a 64-bit number")
    return value


def _real(digits: str) -> float:
    value = float(digits)
    if not math.isfinite(value):
        raise ValueError(f"{digits:.20} is too large for a 64-bit number")
    return value


def _object(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    values = dict(pairs)
    if len(values) != len(pairs):
        seen: set[str] = set()
        twice = next(name for name, _ in pairs if name in seen or seen.add(name))  # type: ignore[func-returns-value]
        raise ValueError(f"the name {twice[:60]!r} is there twice in one object")
    return values


_DECODER = json.JSONDecoder(parse_constant=_refuse, parse_int=_whole, parse_float=_real, object_pairs_hook=_object)


def write_json(path: Path, values: dict[str, Any]) -> None:
    """Write a JSON object atomically; NaN and infinity raise `ValueError`."""
    write_text(path, json.dumps(values, indent=1, allow_nan=False) + "\n")


def write_sealed_json(path: Path, values: Mapping[str, Any]) -> None:
    """Write a JSON object with a digest of itself, so that `read_json` notices every later change; atomically."""
    write_json(path, sealed(values))


def sealed(values: Mapping[str, Any]) -> dict[str, Any]:
    """Values with their digest as last entry."""
    return {**values, SEAL: digest_of(values)}


def digest_of(values: Mapping[str, Any]) -> str:
    """SHA-256 over all values of a JSON object, whatever their order and spacing in the file.

    Raises:
        ValueError: NaN, infinity, or a number that `read_json` would refuse.
    """
    plain = _DECODER.decode(json.dumps(values, allow_nan=False))
    return hashlib.sha256(json.dumps(plain, sort_keys=True).encode()).hexdigest()
