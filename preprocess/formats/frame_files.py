"""Folders with one pickled dictionary per frame (`.frame`), told apart by what is in the files, not by their names."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import Any

from ggavatar.errors import InputError
from ggavatar.io.regular_files import read_start
from ggavatar.io.restricted_pickle import read_pickle

_PLACES = (".", "checkpoint")
_NUMBER = re.compile(r"(\d{1,9})\D*$")
_OTHER_SUFFIXES = frozenset({".png", ".jpg", ".jpeg", ".npz", ".npy", ".ply", ".obj", ".mp4", ".json", ".txt"})
_PROBES = 3


def frame_files(folder: Path, accepts: Callable[[Mapping[str, Any]], bool]) -> dict[int, Path]:
    """Files by frame number, from the folder or from `checkpoint` in it, if their content is accepted.

    The first readable of three files decides for all of one suffix, so that a damaged file hides nothing.

    Args:
        folder: A folder; anything else has no such files.
        accepts: Whether a file's dictionary is of the format.
    """
    return next((files for files in _groups(folder) if _accepted(files, accepts)), {})


def pickled_files(folder: Path) -> dict[int, Path]:
    """Numbered pickles in the folder or in `checkpoint`, whatever they hold: what a message should be about."""
    return next(iter(_groups(folder)), {})


def _groups(folder: Path) -> Iterator[dict[int, Path]]:
    """Numbered pickles by frame number, one group for each place and suffix."""
    for place in _PLACES:
        if not (folder / place).is_dir():
            continue
        by_suffix: dict[str, dict[int, Path]] = {}
        for path in sorted((folder / place).iterdir()):
            number = _NUMBER.search(path.stem)
            if number and path.suffix.lower() not in _OTHER_SUFFIXES and _is_pickle(path):
                by_suffix.setdefault(path.suffix, {})[int(number[1])] = path
        yield from (dict(sorted(files.items())) for files in by_suffix.values())


def _is_pickle(path: Path) -> bool:
    """Whether a file begins as a zip or as a binary pickle; the rest is not looked at."""
    if not path.is_file():
        return False
    head = read_start(path, 2)
    return head == b"PK" or head[:1] == b"\x80"


def _accepted(files: Mapping[int, Path], accepts: Callable[[Mapping[str, Any]], bool]) -> bool:
    for path in list(files.values())[:_PROBES]:
        try:
            content = read_pickle(path)
        except InputError:
            continue
        return isinstance(content, Mapping) and accepts(content)
    return False


def frame_content(path: Path, expected: str) -> Mapping[str, Any]:
    """The dictionary in a file; `InputError` if it is none."""
    content = read_pickle(path)
    if not isinstance(content, Mapping):
        raise InputError(f"{path}: expected {expected}, found {type(content).__name__}; track the frame again")
    return content
