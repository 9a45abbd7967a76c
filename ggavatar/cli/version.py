"""What every command answers to --version."""

from __future__ import annotations

import importlib.metadata
import sys
from collections.abc import Sequence


def answer_version(program: str, arguments: Sequence[str] | None = None) -> None:
    """Print the program's name and version and end it with code 0, if `--version` is among its arguments.

    Args:
        program: Name of the command.
        arguments: Those of the command line by default.
    """
    if "--version" in (sys.argv[1:] if arguments is None else arguments):
        sys.stdout.write(f"{program} {importlib.metadata.version('ggavatar')}\n")
        raise SystemExit(0)
