"""The viewer beside a training: a process of its own, which ends with the training and cannot disturb it."""

from __future__ import annotations

import contextlib
import importlib.util
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

from ggavatar.errors import InputError

VIEWER = "evaluate.cli.view"
"""Its module, by name: `ggavatar` imports nothing of `evaluate`."""
PATIENCE = 10.0
"""Time that the viewer has to end, s."""


@contextlib.contextmanager
def viewer_beside(run: Path) -> Iterator[None]:
    """Have a viewer follow a run while the block is executed, even if it does not exist yet.

    The viewer ends when its standard input does, so also when this process is killed.

    Raises:
        InputError: viser is not installed.
    """
    if importlib.util.find_spec("viser") is None or importlib.util.find_spec(VIEWER.partition(".")[0]) is None:
        raise InputError(
            "--view shows pictures through viser, which is not installed; add it with: pip install 'viser>=1.1', or "
            "leave out --view"
        )
    command = [sys.executable, "-m", VIEWER, str(run.resolve()), "--wait"]
    # A session of its own: Ctrl-C is for the training, which saves before it ends.
    process = subprocess.Popen(command, stdin=subprocess.PIPE, start_new_session=True)
    try:
        yield
    finally:
        if process.stdin is not None:
            with contextlib.suppress(OSError):
                process.stdin.close()
        try:
            process.wait(PATIENCE)
        except subprocess.TimeoutExpired:
            process.kill()
            process.wait()
