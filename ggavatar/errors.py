"""Exceptions for invalid input and failed checks, the exit codes of the commands, and name suggestions."""

from __future__ import annotations

import difflib
from collections.abc import Collection

EXIT_FAILURE, EXIT_USAGE, EXIT_GATE, EXIT_INTERRUPTED, EXIT_TERMINATED = 1, 2, 3, 130, 143
"""A crash or failed cell, invalid input or flags, a failed check, Ctrl-C (SIGINT), and SIGTERM."""


class InputError(ValueError):
    """The user's input cannot be used; the message says what was expected, what was found, where, and what to do."""


class GateError(Exception):
    """A check that the user asked for has failed: a regression gate, or the strict doctor (exit code 3)."""


class Terminated(KeyboardInterrupt):
    """SIGTERM asked the process to end (exit code 143), as Ctrl-C does."""


def nearest(name: str, known: Collection[str]) -> str:
    """' (did you mean …?)' with the closest known name, or an empty string if none is close."""
    close = difflib.get_close_matches(name, list(known), n=1, cutoff=0.5)
    return f" (did you mean {close[0]}?)" if close else ""
