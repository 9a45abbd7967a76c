"""Where GGAvatar keeps files that it can fetch or compute again."""

from __future__ import annotations

import os
from pathlib import Path


def cache_folder(name: str) -> Path:
    """The cache folder `name`, which need not exist: `$GGAVATAR_CACHE/ggavatar/<name>`, else in the user's cache.

    The user's cache is the platform's: `$XDG_CACHE_HOME` or `~/.cache` on Linux, `~/Library/Caches` on macOS,
    `%LOCALAPPDATA%` on Windows.
    """
    if chosen := os.environ.get("GGAVATAR_CACHE"):
        return Path(chosen) / "ggavatar" / name
    import platformdirs

    return platformdirs.user_cache_path("ggavatar", appauthor=False) / name
