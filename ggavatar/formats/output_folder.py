"""Output files and folders of exports: they appear complete or not at all, and replace nothing unasked."""

from __future__ import annotations

import contextlib
import shutil
import tempfile
from collections.abc import Iterator
from pathlib import Path

from ggavatar.errors import InputError


def check_output_file(path: Path, overwrite: bool) -> None:
    """Check that a file may be written.

    Raises:
        InputError: It exists and `overwrite` is not set, or it is a folder.
    """
    if path.is_dir():
        raise InputError(f"{path}: expected a file to write, found a folder; choose another with -o")
    if path.exists() and not overwrite:
        raise InputError(f"{path}: already exists; pass --overwrite to replace it, or choose another file with -o")


@contextlib.contextmanager
def atomic_folder(folder: Path, overwrite: bool) -> Iterator[Path]:
    """A temporary folder that is renamed to `folder` when the block succeeds, and removed when it raises.

    A folder that is not empty is replaced only with `overwrite`, and only if it holds no names but those that the
    block has written.

    Raises:
        InputError: The folder exists and must not be replaced.
    """
    if folder.exists() and not folder.is_dir():
        raise InputError(f"{folder}: expected a folder to write, found a file; choose another with -o")
    if folder.is_dir() and any(folder.iterdir()) and not overwrite:
        raise InputError(f"{folder}: already exists; pass --overwrite to replace it, or choose another folder with -o")
    folder.parent.mkdir(parents=True, exist_ok=True)
    home = Path(tempfile.mkdtemp(prefix=f".{folder.name}.", dir=folder.parent))
    try:
        temporary = home / "new"
        temporary.mkdir()
        yield temporary
        if folder.is_dir():
            _check_replaceable(folder, temporary)
            folder.rename(home / "old")
        try:
            temporary.rename(folder)
        except OSError:
            if (home / "old").is_dir():
                (home / "old").rename(folder)
            raise
    finally:
        shutil.rmtree(home, ignore_errors=True)


def _check_replaceable(folder: Path, replacement: Path) -> None:
    """Raise an `InputError` if the folder holds names that the replacement does not."""
    others = {path.name for path in folder.iterdir()} - {path.name for path in replacement.iterdir()}
    if others:
        raise InputError(
            f"{folder}: expected only files of an earlier export, found others ({', '.join(sorted(others)[:3])}); "
            "choose another folder with -o"
        )
