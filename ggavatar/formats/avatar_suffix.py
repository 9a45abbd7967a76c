"""Whether a path names an avatar file. Does not import torch."""

from __future__ import annotations

from pathlib import Path

from ggavatar.errors import InputError
from ggavatar.io.regular_files import read_start
from ggavatar.io.zip_files import open_zip

SUFFIX, DESCRIPTION, EXPECTED = ".ggavatar", "avatar.json", "an avatar file"


def is_avatar_file(path: Path) -> bool:
    """Whether a path names an avatar file: an archive with its description, or any file with its suffix."""
    if not path.is_file():
        return path.suffix.lower() == SUFFIX and not path.is_dir()
    if path.suffix.lower() == SUFFIX:
        return True
    if not read_start(path, 4).startswith(b"PK"):
        return False
    try:
        with open_zip(path, EXPECTED) as archive:
            return DESCRIPTION in archive.namelist()
    except InputError:
        return False


def results_beside(path: Path) -> Path:
    """Folder for what is rendered and exported from an avatar file: beside it, with its name."""
    return path.with_suffix("") if path.suffix.lower() == SUFFIX else path.with_name(f"{path.name}-results")
