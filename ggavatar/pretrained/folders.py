"""Where files of pretrained models lie on this computer. Nothing is fetched, and torch is not needed to ask."""

from __future__ import annotations

import os
from pathlib import Path


def model_folders(folder: Path | None = None) -> list[Path]:
    """The folders to search, in order: `folder`, $GGAVATAR_MODELS, the user's cache."""
    named = [folder] if folder else []
    if variable := os.environ.get("GGAVATAR_MODELS"):
        named.append(Path(variable))
    cache = os.environ.get("GGAVATAR_CACHE") or os.environ.get("XDG_CACHE_HOME") or str(Path.home() / ".cache")
    return [*named, Path(cache) / "ggavatar" / "models"]
