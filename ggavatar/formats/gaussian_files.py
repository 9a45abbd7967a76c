"""Reads Gaussians from a file of any kind; its content decides which."""

from __future__ import annotations

import hashlib
import os
from pathlib import Path

from ggavatar.errors import InputError
from ggavatar.formats.source_options import GaussianReadingOptions
from ggavatar.formats.splats.file_kinds import KINDS, SOG_META, file_kind
from ggavatar.formats.splats.gaussian_ply import read_gaussian_ply
from ggavatar.formats.splats.sog import read_sog
from ggavatar.formats.splats.splat import read_splat
from ggavatar.formats.splats.spz_reader import read_spz
from ggavatar.formats.splats.stored_gaussians import StoredGaussians
from ggavatar.io.digests import sha256_of

_READERS = {"splat": read_splat, "spz": read_spz, "sog": read_sog}


def read_gaussians(path: Path, options: GaussianReadingOptions | None = None) -> StoredGaussians:
    """Gaussians of a file in our axes; what was assumed, dropped or ignored is in their `notes`.

    Args:
        path: PLY (3DGS, GaussianAvatars, compressed), .splat, .spz, or SOG (archive, folder or meta.json).
        options: How its numbers are meant.

    Raises:
        InputError: No such file, of another kind, or damaged.
    """
    options = options or GaussianReadingOptions()
    if not path.exists():
        raise InputError(f"{path}: expected a file of Gaussians, found no such file")
    kind = file_kind(path)
    if kind == "ply":
        return read_gaussian_ply(path, options.axes, options.scales, options.opacities)
    if kind not in _READERS:
        found = KINDS.get(kind or "", "another file")
        known = ", ".join(KINDS[name] for name in ("ply", *_READERS))
        raise InputError(f"{path}: expected a file of Gaussians ({known}), found {found}; export it as one of these")
    if options.scales != "auto" or options.opacities != "auto":
        raise InputError(f"{path}: --scales and --opacities belong to PLY, this is {KINDS[kind]}; leave them out")
    return _READERS[kind](path, options.axes)


def digest(path: Path) -> str:
    """SHA-256 of a file of Gaussians; of a SOG in a folder, of the digests of its files."""
    if path.is_file() and path.name != SOG_META:
        return sha256_of(path)
    folder = path if path.is_dir() else path.parent
    files = sorted(file for file in folder.iterdir() if file.is_file())
    lines = (os.fsencode(file.name) + f" {sha256_of(file)}\n".encode() for file in files)
    return hashlib.sha256(b"".join(lines)).hexdigest()
