"""Reader of `.spz` (Niantic), versions 1 to 4; the writer is `spz`.

Versions 1 to 3 are one gzip stream; version 4 has a plain header and a Zstandard stream for every attribute. Version 1
has half-precision positions, versions 1 and 2 quaternions of three bytes. Axes are x right, y up, z to the viewer, as
ours, unless Adobe's extension states others.

Read here and not by a library: `spz` on PyPI is a single 0.0.1 without wheels, `gsply` (0.4) and `gaussforge` (0.6) are
young, and what a header makes a reader allocate must be bounded here.
"""

from __future__ import annotations

import dataclasses
import itertools
import struct
import zlib
from collections.abc import Mapping
from pathlib import Path
from typing import NamedTuple

import numpy as np
import zstandard
from jaxtyping import Float, UInt8
from numpy import ndarray

from ggavatar.errors import InputError
from ggavatar.formats.splats.axes import Axes, in_our_axes
from ggavatar.formats.splats.file_kinds import GZIP_MAGIC
from ggavatar.formats.splats.ply import MAX_ROWS
from ggavatar.formats.splats.quaternion_packing import quats_from_smallest
from ggavatar.formats.splats.sound_rows import sound_rows
from ggavatar.formats.splats.spz import MAGIC
from ggavatar.formats.splats.stored_gaussians import StoredGaussians, flip_axes
from ggavatar.io.regular_files import read_file

MAX_SPZ_BYTES = 1 << 30
MAX_RATIO, LARGE_CONTENT, MAX_LARGE_RATIO = 1100, 1 << 26, 20
"""Deflate and Zstandard pack zeros 1100 times; of more than 64 MiB no Gaussians do, which pack three times or less."""
"""Largest ratio of unpacked to packed size that is read; deflate reaches 1032, real files about 2."""
_HEADER = struct.Struct("<IIIBBBB")
_ZSTD_HEADER_BYTES = 32
_HAS_EXTENSIONS = 2
_HARMONICS = (0, 3, 8, 15, 24)
_AXES_EXTENSION = 0xADBE0003
_AXES = {
    number: (1 if name[0] == "R" else -1, 1 if name[1] == "U" else -1, 1 if name[2] == "B" else -1)
    for number, name in enumerate(("LDB", "RDB", "LUB", "RUB", "LDF", "RDF", "LUF", "RUF"), start=1)
}
"""Signs that bring the axes of Adobe's extension to right, up, back; its 0 means that they are not known."""
UNSTATED_AXES_NOTE = (
    "it does not state its axes and is read in those of its format (y up); if it is upside down, pass --axes viewer"
)
"""splat-transform 3 and others copy the numbers of a PLY as they are."""
_ADVICE = "export it again"


class _Layout(NamedTuple):
    """What a header says."""

    version: int
    gaussians: int
    degree: int
    fraction_bits: int
    flags: int
    streams: int

    @property
    def sizes(self) -> dict[str, int]:
        """Bytes of one Gaussian in every block, in the order of the blocks."""
        positions, rotations = 6 if self.version == 1 else 9, 3 if self.version < 3 else 4
        harmonics = 3 * _HARMONICS[self.degree]
        return dict(positions=positions, alphas=1, colors=3, scales=3, rotations=rotations, harmonics=harmonics)


def read_spz(path: Path, axes: Axes = "auto") -> StoredGaussians:
    """Read Gaussians; `auto` means the axes of the format.

    Raises:
        InputError: Another format or version, damaged, or larger than it can be.
    """
    data = read_file(path, MAX_SPZ_BYTES, "an .spz file")
    if data.startswith(GZIP_MAGIC):
        layout, blocks, extensions = _read_gzip(path, data)
    else:
        layout, blocks, extensions = _read_zstandard(path, data)
    signs = _signs(path, extensions)
    rows = sound_rows(path, flip_axes(_rows(layout, blocks), signs or (1, 1, 1)))
    if signs is None and axes == "auto":
        rows = dataclasses.replace(rows, notes=(*rows.notes, UNSTATED_AXES_NOTE))
    return in_our_axes(rows, axes, is_for_viewers=False)


def _layout(path: Path, head: bytes) -> _Layout:
    if len(head) < _HEADER.size or _HEADER.unpack(head)[0] != MAGIC:
        raise InputError(f"{path}: expected an .spz file ('NGSP'), found another file or none of its header")
    _, version, count, degree, bits, flags, streams = _HEADER.unpack(head)
    if not 1 <= version <= 4 or degree >= len(_HARMONICS) or bits > 23:
        raise InputError(
            f"{path}: expected .spz of version 1 to 4, degree 0 to 4 and up to 23 fraction bits, found {version}, "
            f"{degree} and {bits}; {_ADVICE}"
        )
    if not 1 <= count <= MAX_ROWS:
        raise InputError(f"{path}: expected 1 to {MAX_ROWS} Gaussians, found {count}")
    return _Layout(version, count, degree, bits, flags, streams)


def _read_gzip(path: Path, data: bytes) -> tuple[_Layout, dict[str, UInt8[ndarray, "N B"]], bytes]:
    """Header, blocks and extensions of versions 1 to 3."""
    unpacker = zlib.decompressobj(wbits=31)
    try:
        layout = _layout(path, unpacker.decompress(data, _HEADER.size))
        if layout.version > 3:
            raise InputError(f"{path}: expected version 1 to 3 in a gzip stream, found {layout.version}; {_ADVICE}")
        size = layout.gaussians * sum(layout.sizes.values())
        _check_ratio(path, size, len(data))
        content = unpacker.decompress(unpacker.unconsumed_tail, size)
        # Reads to the end of a sound file, so that its checksum is compared.
        rest = unpacker.decompress(unpacker.unconsumed_tail, 1 << 16)
    except zlib.error as error:
        raise InputError(f"{path}: expected a gzip stream, found a damaged one ({error}); copy it again") from error
    if len(content) != size:
        raise InputError(f"{path}: expected {size} bytes of Gaussians, found {len(content)}; copy the file again")
    ends = np.cumsum([0, *(layout.gaussians * size for size in layout.sizes.values())])
    parts = (content[start:end] for start, end in itertools.pairwise(ends))
    return (
        layout,
        _blocks(layout, dict(zip(layout.sizes, parts, strict=True))),
        rest if layout.flags & _HAS_EXTENSIONS else b"",
    )


def _read_zstandard(path: Path, data: bytes) -> tuple[_Layout, dict[str, UInt8[ndarray, "N B"]], bytes]:
    """Header, blocks and extensions of version 4: a table of sizes, then one stream a block, without empty ones."""
    layout = _layout(path, data[: _HEADER.size])
    names = [name for name, size in layout.sizes.items() if size]
    (table,) = struct.unpack_from("<I", data, _HEADER.size) if len(data) >= _ZSTD_HEADER_BYTES else (0,)
    start = table + 16 * len(names)
    if layout.version != 4 or layout.streams != len(names) or table < _ZSTD_HEADER_BYTES or start > len(data):
        raise InputError(
            f"{path}: expected .spz of version 4 with {len(names)} streams, found version {layout.version} with "
            f"{layout.streams} or no table of them; {_ADVICE}"
        )
    sizes = {name: layout.gaussians * layout.sizes[name] for name in names}
    _check_ratio(path, sum(sizes.values()), len(data))
    parts = {}
    for index, name in enumerate(names):
        packed, unpacked = struct.unpack_from("<QQ", data, table + 16 * index)
        if unpacked != sizes[name] or start + packed > len(data):
            raise InputError(f"{path}: expected {sizes[name]} bytes of {name}, found {unpacked}; copy the file again")
        parts[name] = _unpacked(path, data[start : start + packed], sizes[name])
        start += packed
    return layout, _blocks(layout, parts), data[_ZSTD_HEADER_BYTES:table] if layout.flags & _HAS_EXTENSIONS else b""


def _unpacked(path: Path, data: bytes, size: int) -> bytes:
    """One Zstandard stream of a known size."""
    try:
        with zstandard.ZstdDecompressor(max_window_size=1 << 27).stream_reader(data) as stream:
            content = stream.read(size)
    except (zstandard.ZstdError, MemoryError) as error:
        raise InputError(f"{path}: expected Zstandard streams, found a damaged one ({error}); copy it again") from error
    if len(content) != size:
        raise InputError(f"{path}: expected a stream of {size} bytes, found {len(content)}; copy the file again")
    return content


def _check_ratio(path: Path, size: int, packed: int) -> None:
    """Raise an `InputError` before anything is unpacked if the header claims more than the file can hold."""
    if size > MAX_RATIO * packed or (size > LARGE_CONTENT and size > MAX_LARGE_RATIO * packed):
        raise InputError(
            f"{path}: the file of {packed} bytes is too small for {size} bytes of Gaussians; copy it again"
        )


def _blocks(layout: _Layout, parts: Mapping[str, bytes]) -> dict[str, UInt8[ndarray, "N B"]]:
    return {
        name: np.frombuffer(parts.get(name, b""), np.uint8).reshape(layout.gaussians, size)
        for name, size in layout.sizes.items()
    }


def _rows(layout: _Layout, blocks: Mapping[str, UInt8[ndarray, "N B"]]) -> StoredGaussians:
    """The Gaussians in the file's axes; harmonics of degree 4 are left out."""
    opacities = blocks["alphas"][:, 0] / 255
    rest = (blocks["harmonics"].astype(np.float32) - 128) / 128
    with np.errstate(divide="ignore"):
        logits = np.log(opacities) - np.log1p(-opacities)
    found = [] if layout.degree < 4 else ["its harmonics of degree 4 are left out"]
    found += ["it was trained with antialiasing (mip-splatting)"] if layout.flags & 1 else []
    return StoredGaussians(
        means=_positions(layout, blocks["positions"]),
        sh_dc=((blocks["colors"] / 255 - 0.5) / 0.15).astype(np.float32),
        sh_rest=np.ascontiguousarray(rest.reshape(layout.gaussians, -1, 3)[:, : _HARMONICS[3]]),
        opacity_logits=logits.astype(np.float32),
        log_scales=(blocks["scales"] / 16 - 10).astype(np.float32),
        quats=_rotations(layout, blocks["rotations"]),
        notes=tuple(found),
    )


def _positions(layout: _Layout, block: UInt8[ndarray, "N B"]) -> Float[ndarray, "N 3"]:
    """Half-precision numbers (version 1) or signed 24-bit fixed point."""
    if layout.version == 1:
        return block.view("<f2").astype(np.float32)
    wide = np.zeros((layout.gaussians, 3, 4), np.uint8)
    wide[..., 1:] = block.reshape(layout.gaussians, 3, 3)
    return ((wide.view("<i4")[..., 0] >> 8) / (1 << layout.fraction_bits)).astype(np.float32)


def _rotations(layout: _Layout, block: UInt8[ndarray, "N B"]) -> Float[ndarray, "N 4"]:
    """Quaternions wxyz: x, y, z as bytes, w not negative; from version 3 on the three smallest of xyzw with 9 bits."""
    if layout.version < 3:
        vector = block / 127.5 - 1
        return quats_from_smallest(vector, np.zeros(layout.gaussians, np.int64))
    words = np.ascontiguousarray(block).view("<u4")[:, 0]
    fields = np.stack([words >> np.uint32(shift) & np.uint32(1023) for shift in (20, 10, 0)], axis=1)
    magnitudes = (fields & np.uint32(511)) * (np.sqrt(0.5) / 511)
    others = np.where(fields & np.uint32(512), -magnitudes, magnitudes)
    return quats_from_smallest(others, words >> np.uint32(30))[:, [3, 0, 1, 2]]


def _signs(path: Path, extensions: bytes) -> tuple[int, int, int] | None:
    """Signs that bring the file's axes to ours, from its records of type, length and content; None if not stated."""
    position = 0
    while position + 8 <= len(extensions):
        kind, length = struct.unpack_from("<II", extensions, position)
        content = extensions[position + 8 : position + 8 + length]
        if kind == _AXES_EXTENSION and len(content) == 4:
            number = int.from_bytes(content, "little")
            if number == 0:
                return None
            if number not in _AXES:
                raise InputError(
                    f"{path}: expected axes of right, up and back in this order (Adobe's numbers 0 to 8), found "
                    f"{number}; export it again without the extension"
                )
            return _AXES[number]
        position += 8 + length
    return None
