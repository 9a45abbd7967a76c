"""The journal of a training: one line of JSON per logged step."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

from ggavatar.errors import InputError
from ggavatar.io.json_files import parse_json
from ggavatar.io.regular_files import open_regular

_MAX_LINE_BYTES = 1 << 20


class Journal:
    """A file of JSON lines, each with a `step`, that is only appended to.

    It is opened at the step of a checkpoint: lines that a crash left beyond that step are cut off its end.
    """

    def __init__(self, path: Path, after: int) -> None:
        """Keep the lines up to step `after`, cut off the others, and append from now on.

        Raises:
            InputError: The path is a link, whose target may be someone else's, or a folder, pipe or device.
        """
        if path.is_symlink() or (path.exists() and not path.is_file()):
            raise InputError(f"{path}: expected a journal of a training, found a link or no file; remove it")
        end = max((end for end, record in _records(path) if record["step"] <= after), default=0)
        self._file = path.open("r+b" if path.exists() else "xb")
        self._file.truncate(end)
        self._file.seek(end)

    def write(self, record: Mapping[str, Any]) -> None:
        """Append a line and flush it."""
        self._file.write(json.dumps(record).encode() + b"\n")
        self._file.flush()

    def close(self) -> None:
        """Close the file."""
        self._file.close()


def read_journal(path: Path) -> list[dict[str, Any]]:
    """All complete lines of a journal, in order; a damaged line is skipped, a missing file is an empty journal."""
    return [record for _, record in _records(path)]


def _records(path: Path) -> Iterator[tuple[int, dict[str, Any]]]:
    """The complete lines with a step, each with the position of its end in the file."""
    if not path.exists():
        return
    end = 0
    with open_regular(path, "a journal of a training") as file:
        while line := file.readline(_MAX_LINE_BYTES):
            end += len(line)
            try:
                record = parse_json(path, line) if line.endswith(b"\n") else {}
            except InputError:
                continue
            if type(record.get("step")) is int:
                yield end, record
