"""Where GGAvatar keeps files that it can fetch or compute again."""

from __future__ import annotations

import os
from pathlib import Path


def cache_folder(name: str) -> Path:
    """The cache folder `name`, which need not exist: `$GGAVATAR_CACHE/ggavatar/<name>`, else in the user's cache.

    The user's cache is the platform's: `$XDG_CACHE_HOME` or `~/.cache` on Linux, `~/Library/Caches` on macOS,
    `%LOCALAPPDATA%` on Windows. A user without a home has none: the path that is returned then cannot be created.
    """
    if chosen := os.environ.get("GGAVATAR_CACHE"):
        return Path(chosen) / "ggavatar" / name
    import platformdirs

    folder = platformdirs.user_cache_path("ggavatar", appauthor=False) / name
    # A user without a home (no $HOME, not in the list of users): `~` is no folder, and must not be made in this one.
    return folder if folder.is_absolute() else Path(os.devnull) / "ggavatar" / name
