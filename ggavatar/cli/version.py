"""The flag --version of every command."""

from __future__ import annotations

import importlib.metadata
import sys
from collections.abc import Sequence

from ggavatar.text.terminal import write_out


def handle_version_flag(program: str, arguments: Sequence[str] | None = None) -> None:
    """Print the program's name and version and exit with code 0 if `--version` is among its arguments.

    Args:
        program: Name of the command.
        arguments: Its arguments; those of the command line by default.
    """
    if "--version" in (sys.argv[1:] if arguments is None else arguments):
        write_out(f"{program} {importlib.metadata.version('ggavatar')}")
        raise SystemExit(0)
