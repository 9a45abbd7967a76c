"""JSON objects from and to files: strict, of bounded size, written atomically."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

from ggavatar.errors import InputError
from ggavatar.io.atomic import write_atomically

MAX_JSON_BYTES = 1 << 26


def read_json(path: Path, limit: int = MAX_JSON_BYTES) -> dict[str, Any]:
    """A JSON object from a file of at most `limit` bytes; NaN and infinities are refused."""

    def refuse(constant: str) -> float:
        raise ValueError(f"{constant} is not a number JSON knows")

    try:
        size = path.stat().st_size
        if size > limit:
            raise InputError(f"{path}: {size >> 20} MiB of JSON, the limit is {limit >> 20} MiB")
        data = json.loads(path.read_text(encoding="utf-8"), parse_constant=refuse)
    except (FileNotFoundError, NotADirectoryError) as error:
        raise InputError(f"{path}: no such file") from error
    except IsADirectoryError as error:
        raise InputError(f"{path}: expected a JSON file, found a folder") from error
    except (ValueError, RecursionError) as error:
        raise InputError(f"{path}: not valid JSON ({error})") from error
    if not isinstance(data, dict):
        raise InputError(f"{path}: expected a JSON object, found {type(data).__name__}")
    return data


def write_json(path: Path, values: dict[str, Any]) -> None:
    """Write JSON atomically."""
    text = json.dumps(values, indent=1, allow_nan=False) + "\n"
    write_atomically(path, lambda stream: stream.write(text.encode()))
