"""Output files and folders of exports: they appear complete or not at all, and replace nothing unasked."""

from __future__ import annotations

import contextlib
import shutil
from collections.abc import Iterator
from pathlib import Path

from ggavatar.errors import InputError
from ggavatar.io.atomic import remove_partial_files
from ggavatar.io.folder_lock import lock_output


@contextlib.contextmanager
def output_file(path: Path, overwrite: bool) -> Iterator[None]:
    """Hold a file that the block writes atomically.

    Raises:
        InputError: It exists and `overwrite` is not set, it is a folder, or another process is writing it.
    """
    check_output_file(path, overwrite)
    with lock_output(path):
        check_output_file(path, overwrite)  # again: another process may have had the lock until now
        remove_partial_files(path.parent, begin=f"{path.name}.")
        yield


def check_output_file(path: Path, overwrite: bool) -> None:
    """The checks of `output_file`, before anything is read or rendered."""
    if path.is_dir():
        raise InputError(f"{path}: expected a file to write, found a folder; choose another with -o")
    if path.exists() and not overwrite:
        raise InputError(f"{path}: already exists; pass --overwrite to replace it, or choose another file with -o")


@contextlib.contextmanager
def atomic_folder(folder: Path, overwrite: bool) -> Iterator[Path]:
    """A temporary folder that is renamed to `folder` when the block succeeds, and removed when it raises.

    A folder that is not empty is replaced only with `overwrite`, and only if it holds no names but those that the
    block has written. What a killed process has left is put right first: the earlier folder is at its place again.

    Raises:
        InputError: The folder exists and must not be replaced, or another process is writing it.
    """
    _check_output_folder(folder, overwrite)
    with lock_output(folder):
        home = folder.with_name(f".{folder.name}.partial")
        new, old = home / "new", home / "old"
        _clear_leftovers(home, folder)
        _check_output_folder(folder, overwrite)
        home.mkdir()
        try:
            new.mkdir()
            yield new
            if folder.is_dir():
                _check_replaceable(folder, new)
                folder.rename(old)
            new.rename(folder)
        finally:
            _put_back(old, folder)
            shutil.rmtree(home, ignore_errors=True)


def _clear_leftovers(home: Path, folder: Path) -> None:
    """Put right what a killed process has left in its temporary folder, and remove that."""
    others = {path.name for path in home.iterdir()} - {"new", "old"} if home.is_dir() else set()
    if others:
        raise InputError(
            f"{home}: expected nothing, or what an interrupted export has left, found other files ({min(others)}); "
            "move them away"
        )
    _put_back(home / "old", folder)
    shutil.rmtree(home, ignore_errors=True)


def _put_back(old: Path, folder: Path) -> None:
    """Give an earlier folder its place again if nothing has taken it."""
    if old.is_dir() and not folder.exists():
        old.rename(folder)


def _check_output_folder(folder: Path, overwrite: bool) -> None:
    """Raise an `InputError` if a folder must not be replaced."""
    if folder.exists() and not folder.is_dir():
        raise InputError(f"{folder}: expected a folder to write, found a file; choose another with -o")
    if folder.is_dir() and any(folder.iterdir()) and not overwrite:
        raise InputError(f"{folder}: already exists; pass --overwrite to replace it, or choose another folder with -o")


def _check_replaceable(folder: Path, replacement: Path) -> None:
    """Raise an `InputError` if the folder holds names that the replacement does not."""
    others = {path.name for path in folder.iterdir()} - {path.name for path in replacement.iterdir()}
    if others:
        raise InputError(
            f"{folder}: expected only files of an earlier export, found others ({', '.join(sorted(others)[:3])}); "
            "choose another folder with -o"
        )
