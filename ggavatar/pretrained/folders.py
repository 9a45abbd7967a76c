"""Where files of pretrained models are looked for. Nothing is downloaded, and torch is not imported."""

from __future__ import annotations

import os
from collections.abc import Sequence
from pathlib import Path

from ggavatar.io.cache_folder import cache_folder

MODELS_VARIABLE = "GGAVATAR_MODELS"
"""Environment variable that names a folder of model files."""


def downloads_folder() -> Path:
    """The folder for downloaded models in the user's cache; it need not exist."""
    return cache_folder("models")


def model_folders(folder: Path | None = None) -> list[Path]:
    """The folders to search, in order: `folder`, $GGAVATAR_MODELS, the user's cache."""
    named = [folder] if folder else []
    if variable := os.environ.get(MODELS_VARIABLE):
        named.append(Path(variable))
    return [*named, downloads_folder()]


def first_file(folders: Sequence[Path], names: Sequence[str]) -> Path | None:
    """The first existing file of these names in the first folder that has one."""
    candidates = (folder / name for folder in folders for name in names)
    return next((path for path in candidates if path.is_file()), None)
