"""A disk of limited size in place of a folder: a tmpfs where mounting is allowed."""

from __future__ import annotations

import contextlib
import functools
import os
import subprocess
import tempfile
import time
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

PLENTY = 1 << 30
TRIES = 40


@dataclass(frozen=True)
class SmallDisk:
    """A file system of its own, mounted on a folder."""

    folder: Path

    @property
    def used(self) -> int:
        """Bytes in use."""
        status = os.statvfs(self.folder)
        return (status.f_blocks - status.f_bfree) * status.f_frsize

    def resize(self, size: int) -> None:
        """Let it hold `size` bytes and no more."""
        _mount("-o", f"remount,rw,size={max(size, self.used, 4096)}", self.folder)

    def make_read_only(self) -> None:
        """Refuse all writing, also root's; what was killed a moment ago may still have to close its files."""
        for _ in range(TRIES):
            with contextlib.suppress(subprocess.CalledProcessError):
                _mount("-o", "remount,ro", self.folder)
                return
            time.sleep(0.05)
        _mount("-o", "remount,ro", self.folder)


@contextlib.contextmanager
def small_disk(folder: Path) -> Iterator[SmallDisk]:
    """Mount a disk on an empty folder, with plenty of room at first."""
    _mount("-t", "tmpfs", "-o", f"size={PLENTY}", "tmpfs", folder)
    try:
        yield SmallDisk(folder)
    finally:
        subprocess.run(["umount", "--lazy", folder], check=False, capture_output=True)


@functools.cache
def can_mount() -> bool:
    """Whether this user may mount a tmpfs."""
    with tempfile.TemporaryDirectory(prefix="ggavatar-mount-") as name:
        try:
            with small_disk(Path(name)):
                return True
        except (OSError, subprocess.CalledProcessError):
            return False


def _mount(*arguments: object) -> None:
    subprocess.run(["mount", *map(str, arguments)], check=True, capture_output=True)
