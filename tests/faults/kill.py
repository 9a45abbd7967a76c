"""Row by row, a command is killed at random moments and run again until it is done."""

from __future__ import annotations

from tests.faults.case import Row

ROWS: tuple[Row, ...] = ()
