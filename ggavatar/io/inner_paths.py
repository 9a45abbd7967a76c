"""File names that a file gives relative to its own folder: kept within it, whatever they say."""

from __future__ import annotations

from pathlib import Path

from ggavatar.errors import InputError


def path_inside(path: Path, relative: object, siblings: bool = False) -> Path:
    """A file that `path` names relative to its own folder, links followed.

    Args:
        path: The file that holds the name.
        relative: The name.
        siblings: Also accept `../FOLDER/…`, a file in a folder beside that of `path` (VHAP's combined data sets).

    Raises:
        InputError: It is no name, or lies elsewhere.
    """
    folder = path.parent.resolve()
    if not isinstance(relative, str) or "\0" in relative or len(relative) > 1000:
        found = repr(relative[:60]) if isinstance(relative, str) else type(relative).__name__
        raise InputError(f"{path}: expected a file name, found {found}; export the data set again")
    target = (folder / relative).resolve()
    if target.is_relative_to(folder):
        return target
    parts = Path(relative).parts
    beside = len(parts) > 2 and parts[0] == ".." and ".." not in parts[1:]
    if siblings and beside and target.is_relative_to(folder.parent / parts[1]):
        return target
    where = "its own folder or a folder beside it" if siblings else "its own folder"
    raise InputError(f"{path}: expected file names within {where}, found {relative!r:.80}; export the data set again")
