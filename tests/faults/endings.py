"""How a command may end: with the exit code that is documented, one message, and no traceback."""

from __future__ import annotations

import re
from collections.abc import Collection

from tests.faults.bench import Ended

MESSAGE = re.compile(
    r"^(?:error|gate failed|interrupted|terminated|out of memory|failed with exit code \d+): "
    r"|^(?:╭─+)? (?:Missing|Unrecognized|Parsing|Invalid|Required)\b",
    re.MULTILINE,
)
"""How a message begins: one of ours, or the box of the argument parser."""
CRASHES = ("Traceback (most recent call last)", "Exception ignored", "Fatal Python error", "Segmentation fault")
FAILURES = (1, 2)
"""Exit codes that come with a message."""


def complaints(ended: Ended, codes: Collection[int], messages: int = 1) -> list[str]:
    """What is wrong with the end of a command.

    Args:
        ended: The end.
        codes: Exit codes that are right; negative ones stand for signals.
        messages: Number of messages that a failure may have; a sweep has one for each cell.
    """
    if ended.code is None:
        return [f"hung: {ended.last_words}"]
    wrong = [] if ended.code in codes else [f"expected exit code {_words(codes)}, found {ended.last_words}"]
    wrong += [f"printed {text!r}: {ended.last_words}" for text in CRASHES if text in ended.errors + ended.output]
    said = len(MESSAGE.findall(ended.errors))
    if ended.code in FAILURES and not 1 <= said <= messages:
        wrong.append(f"expected one message, found {said}: {ended.last_words}")
    return wrong


def _words(codes: Collection[int]) -> str:
    return " or ".join(map(str, sorted(codes)))
