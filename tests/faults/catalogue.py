"""All rows of faults."""

from __future__ import annotations

import fnmatch
from collections.abc import Sequence

from tests.faults import disk, kill, surroundings
from tests.faults.case import Row
from tests.faults.hostile import rows as files

ROWS: tuple[Row, ...] = (*kill.ROWS, *disk.ROWS, *surroundings.ROWS, *files.ROWS)


def named(patterns: Sequence[str], rows: Sequence[Row] = ROWS) -> list[Row]:
    """The rows whose name matches one of the patterns (`*` stands for anything); all without patterns."""
    return [row for row in rows if not patterns or any(fnmatch.fnmatch(row.name, pattern) for pattern in patterns)]
