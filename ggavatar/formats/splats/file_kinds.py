"""What kind of file of Gaussians a path is, by its content. Does not import torch."""

from __future__ import annotations

import zlib
from pathlib import Path

import numpy as np

from ggavatar.errors import InputError
from ggavatar.io.regular_files import read_file, read_start
from ggavatar.io.zip_files import open_zip

SPLAT_RECORD = np.dtype([("mean", "<f4", 3), ("scale", "<f4", 3), ("color", "u1", 4), ("quat", "u1", 4)])
"""One Gaussian of a .splat file."""
QUATERNION_TOLERANCE = 0.05
"""Largest deviation from length 1 of a quaternion of four bytes, by which a .splat file is recognized."""
SPZ_MAGIC, ZIP_MAGIC, GZIP_MAGIC, GLB_MAGIC = b"NGSP", b"PK\x03\x04", b"\x1f\x8b", b"glTF"
SOG_META, SOG_LEVELS = "meta.json", "lod-meta.json"
KINDS = {"ply": "PLY", "splat": ".splat", "spz": ".spz", "sog": "SOG", "glb": "glTF binary"}
SUFFIXES = {".ply": "ply", ".splat": "splat", ".spz": "spz", ".sog": "sog", ".glb": "glb"}
_MAX_META_BYTES = 1 << 22
_START_BYTES = 4096
"""What is read to know a kind; deflate needs some hundred bytes before it yields the first four."""
_RUN_FILE = "config.json"


def file_kind(path: Path) -> str | None:
    """One of `KINDS`, or None for a path that is none of them, such as a run.

    The content decides; of a file that is missing, or has a content of no kind, the suffix does, so that its reader can
    say what is wrong. A folder is a SOG if it has its meta.json.
    """
    if path.is_dir():
        return "sog" if not (path / _RUN_FILE).exists() and _is_sog_meta(path / SOG_META) else None
    if not path.is_file():
        return SUFFIXES.get(path.suffix.lower())
    return _kind_of_content(path) or SUFFIXES.get(path.suffix.lower())


def _kind_of_content(path: Path) -> str | None:
    start = read_start(path, _START_BYTES)
    if start.startswith((b"ply\n", b"ply\r", b"ply ", b"ply\t")):
        return "ply"
    if start.startswith(SPZ_MAGIC) or (start.startswith(GZIP_MAGIC) and _starts_unzipped(start, SPZ_MAGIC)):
        return "spz"
    if start.startswith(GLB_MAGIC):
        return "glb"
    if start.startswith(ZIP_MAGIC):
        return "sog" if _holds_sog(path) else None
    if start.lstrip().startswith(b"{"):
        return "sog" if _is_sog_meta(path) else None
    return "splat" if looks_like_splat(path) else None


def _starts_unzipped(start: bytes, magic: bytes) -> bool:
    try:
        return zlib.decompressobj(wbits=31).decompress(start, len(magic)) == magic
    except zlib.error:
        return False


def _holds_sog(path: Path) -> bool:
    try:
        with open_zip(path, "a SOG") as archive:
            return any(Path(name).name == SOG_META for name in archive.namelist())
    except InputError:
        return False


def _is_sog_meta(path: Path) -> bool:
    """Whether a JSON file names the parts of a SOG, or the levels of a streamed one."""
    if not path.is_file() or path.stat().st_size > _MAX_META_BYTES:
        return False
    text = read_file(path, _MAX_META_BYTES)
    return all(name in text for name in (b'"means"', b'"quats"', b'"sh0"')) or b'"lodLevels"' in text


def looks_like_splat(path: Path) -> bool:
    """Whether the first records of a file are Gaussians: the format has no header to tell it by."""
    size = path.stat().st_size
    if size == 0 or size % SPLAT_RECORD.itemsize:
        return False
    records = np.frombuffer(read_start(path, 64 * SPLAT_RECORD.itemsize), SPLAT_RECORD)
    lengths = np.linalg.norm(splat_quats(records), axis=1)
    plausible = np.isfinite(records["mean"]).all(axis=1) & (records["scale"] >= 0).all(axis=1)
    return bool((plausible & (np.abs(lengths - 1) < QUATERNION_TOLERANCE)).mean() > 0.9)


def splat_quats(records: np.ndarray) -> np.ndarray:
    """Quaternions wxyz of .splat records, float32 [N, 4]."""
    return (records["quat"].astype(np.float32) - 128) / 128
