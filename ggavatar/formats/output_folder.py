"""Writing where nothing of the user's is lost: a file or a folder appears complete or not at all."""

from __future__ import annotations

import contextlib
import shutil
import tempfile
from collections.abc import Iterator
from pathlib import Path

from ggavatar.errors import InputError


def require_free(path: Path, overwrite: bool) -> None:
    """Refuse an output that exists, unless it may be overwritten.

    Raises:
        InputError: It exists and `overwrite` is not set, or a folder stands where a file goes.
    """
    if path.is_dir():
        raise InputError(f"{path}: expected a file to write, found a folder; choose another with -o")
    if path.exists() and not overwrite:
        raise InputError(f"{path}: exists already; pass --overwrite to replace it, or choose another with -o")


@contextlib.contextmanager
def appearing_folder(folder: Path, overwrite: bool) -> Iterator[Path]:
    """A folder to write into that takes its name when the block ends well, and vanishes otherwise.

    An existing folder is replaced only with `overwrite`, and only if it holds nothing by another name than what is
    written now.

    Raises:
        InputError: The folder exists and must not be replaced.
    """
    if folder.exists() and not folder.is_dir():
        raise InputError(f"{folder}: expected a folder to write, found a file; choose another with -o")
    if folder.is_dir() and any(folder.iterdir()) and not overwrite:
        raise InputError(f"{folder}: exists already; pass --overwrite to replace it, or choose another with -o")
    folder.parent.mkdir(parents=True, exist_ok=True)
    home = Path(tempfile.mkdtemp(prefix=f".{folder.name}.", dir=folder.parent))
    try:
        unfinished = home / "new"
        unfinished.mkdir()
        yield unfinished
        if folder.is_dir():
            _require_ours(folder, unfinished)
            folder.rename(home / "old")
        try:
            unfinished.rename(folder)
        except OSError:
            if (home / "old").is_dir():
                (home / "old").rename(folder)
            raise
    finally:
        shutil.rmtree(home, ignore_errors=True)


def _require_ours(folder: Path, unfinished: Path) -> None:
    strangers = {path.name for path in folder.iterdir()} - {path.name for path in unfinished.iterdir()}
    if strangers:
        raise InputError(
            f"{folder}: holds other files than an export writes ({', '.join(sorted(strangers)[:3])}); choose another "
            "with -o"
        )
