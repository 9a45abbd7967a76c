"""Dictionaries of arrays as people save a network's output: npz, pickle, torch.save, or a folder of npy files."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from pathlib import Path
from typing import Any

from ggavatar.errors import InputError
from ggavatar.io.npz import npz_headers, read_npy, read_npz
from ggavatar.io.regular_files import read_start
from ggavatar.io.restricted_pickle import read_pickle

MAX_NPY_BYTES = 1 << 20
"""Largest file of coefficients; detailed textures are not read."""


def array_names(path: Path) -> frozenset[str]:
    """Names of the arrays in a file or a folder of npy files; none if it is something else. Never raises."""
    try:
        if path.is_dir():
            return frozenset(file.stem for file in path.glob("*.npy"))
        if not path.is_file() or not _is_archive(path):
            return frozenset()
        try:
            return frozenset(npz_headers(path))
        except InputError:
            content = read_pickle(path)
            return frozenset(map(str, content)) if isinstance(content, Mapping) else frozenset()
    except (InputError, OSError):
        return frozenset()


def read_arrays(path: Path, names: Collection[str]) -> dict[str, Any]:
    """The named arrays, or lists, of a file or a folder of npy files; absent ones are left out.

    Raises:
        InputError: Nothing of the kind, damaged, too large, or it holds objects that could run code.
    """
    if path.is_dir():
        files = {name: path / f"{name}.npy" for name in names}
        return {name: read_npy(file, MAX_NPY_BYTES) for name, file in files.items() if file.is_file()}
    if path.is_file() and _is_pickle(path):
        content = read_pickle(path)
        if not isinstance(content, Mapping):
            raise InputError(f"{path}: expected a dictionary of arrays, found {type(content).__name__}; save it again")
        return {name: content[name] for name in names if name in content}
    return dict(read_npz(path, names))


def _head(path: Path) -> bytes:
    return read_start(path, 2)


def _is_archive(path: Path) -> bool:
    head = _head(path)
    return head == b"PK" or head[:1] == b"\x80"


def _is_pickle(path: Path) -> bool:
    """Whether a file is a pickle or torch.save's zip, which npz files are not."""
    if _head(path) != b"PK":
        return _head(path)[:1] == b"\x80"
    try:
        npz_headers(path)
    except InputError:
        return True
    return False
