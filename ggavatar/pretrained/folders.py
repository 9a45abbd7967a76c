"""Where files of pretrained models are looked for, and whether the network may be used. Imports no torch."""

from __future__ import annotations

import os
from pathlib import Path

from ggavatar.errors import InputError
from ggavatar.io.cache_folder import cache_folder

MODELS_VARIABLE = "GGAVATAR_MODELS"
"""Environment variable that names a folder of model files."""

OFFLINE_VARIABLE = "GGAVATAR_OFFLINE"
"""Environment variable that forbids the network; unset, empty and 0 allow it."""


def downloads_folder() -> Path:
    """The folder for downloaded models in the user's cache; it need not exist."""
    return cache_folder("models")


def model_folders(folder: Path | None = None) -> list[Path]:
    """The folders to search, in order: `folder`, $GGAVATAR_MODELS, the user's cache.

    Raises:
        InputError: `folder`, which is what the user passed with --models, does not exist.
    """
    if folder is not None and not folder.is_dir():
        raise InputError(f"--models {folder}: no such folder; pass an existing one, or leave it out to use the cache")
    named = [folder] if folder else []
    if variable := os.environ.get(MODELS_VARIABLE):
        named.append(Path(variable))
    return [*named, downloads_folder()]


def is_offline(offline: bool = False) -> bool:
    """Whether the network must not be used: by `offline` (--offline) or by $GGAVATAR_OFFLINE."""
    return offline or os.environ.get(OFFLINE_VARIABLE, "") not in ("", "0")


def export_choice(folder: Path | None, offline: bool) -> None:
    """Put a command's --models and --offline into the environment, for everything that this process loads or starts.

    Raises:
        InputError: `folder` does not exist.
    """
    if folder is not None:
        model_folders(folder)
        os.environ[MODELS_VARIABLE] = str(folder.resolve())
    if offline:
        os.environ[OFFLINE_VARIABLE] = "1"
