"""Whether a disk has room for what will surely be written, told before the work begins."""

from __future__ import annotations

import errno
import shutil
from pathlib import Path


def require_space(folder: Path, needed: int) -> None:
    """Check the free space where a folder is, or will be.

    Args:
        folder: The folder, which need not exist.
        needed: What is written at the least, bytes: who asks for more than that refuses work that could be done.

    Raises:
        OSError: `ENOSPC`, as the write itself would raise later.
    """
    existing = next((path for path in (folder, *folder.absolute().parents) if path.is_dir()), None)
    if existing is None:
        return
    try:
        free = shutil.disk_usage(existing).free
    except OSError:  # a file system that does not tell
        return
    if free < needed:
        found = f"No space left on device: at least {needed / 1e6:.1f} MB are needed, {free / 1e6:.1f} MB are free"
        raise OSError(errno.ENOSPC, found, str(folder))
