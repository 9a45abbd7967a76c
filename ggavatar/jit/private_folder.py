"""Which folders compiled kernels are kept in: only those that nobody else could have written to.

The files of the cache are machine code and pickles that numba loads, so whoever can write them runs code as this user.
"""

from __future__ import annotations

import os
import stat
from pathlib import Path

_SHARED = stat.S_IWGRP | stat.S_IWOTH


def is_private(folder: Path) -> bool:
    """Whether `folder` is a folder, not a link, that this user owns and only they may write to or replace.

    Every folder above it is asked too: who may write there can put another in its place. A sticky folder (/tmp) may
    lie above it, where only owners can move what is theirs, but never is it. Windows has no such modes; there the
    user's own folders are private by default.
    """
    if not hasattr(os, "geteuid"):
        return stat.S_ISDIR(folder.lstat().st_mode)
    status = folder.lstat()
    if not stat.S_ISDIR(status.st_mode) or status.st_uid != os.geteuid() or status.st_mode & _SHARED:
        return False
    return all(_is_safe_above(parent) for parent in folder.resolve().parents)


def is_own_file(path: str) -> bool:
    """Whether a file in such a folder is a regular one, not a link, of this user."""
    status = os.lstat(path)
    return stat.S_ISREG(status.st_mode) and (not hasattr(os, "geteuid") or status.st_uid == os.geteuid())


def _is_safe_above(folder: Path) -> bool:
    """Whether only this user, or an administrator, can replace what lies in a folder and is this user's."""
    status = folder.stat()
    if status.st_uid not in (0, os.geteuid()):
        return False
    if not status.st_mode & _SHARED or status.st_mode & stat.S_ISVTX:
        return True
    return not status.st_mode & stat.S_IWOTH and _is_own_group(status.st_gid)


def _is_own_group(group: int) -> bool:
    """Whether a group has the user's name and no other member, as where new files may be written by the group."""
    try:
        import grp
        import pwd

        user, found = pwd.getpwuid(os.geteuid()), grp.getgrgid(group)
    except (ImportError, KeyError):
        return False
    return found.gr_name == user.pw_name and set(found.gr_mem) <= {user.pw_name}
