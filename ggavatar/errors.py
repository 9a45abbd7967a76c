"""Exceptions for what the user gave, the exit codes of the commands, and the nearest known name."""

from __future__ import annotations

import difflib
from collections.abc import Collection

EXIT_FAILURE, EXIT_USAGE, EXIT_GATE, EXIT_INTERRUPTED, EXIT_TERMINATED = 1, 2, 3, 130, 143


class InputError(ValueError):
    """Something the user gave is not usable; says what was expected, what was found, where, and what to do next."""


class GateError(Exception):
    """A regression gate, a strict doctor or another check the user asked for has failed (exit code 3)."""


def nearest(name: str, known: Collection[str]) -> str:
    """' (did you mean …?)' if something known is close, else nothing."""
    close = difflib.get_close_matches(name, list(known), n=1, cutoff=0.5)
    return f" (did you mean {close[0]}?)" if close else ""
