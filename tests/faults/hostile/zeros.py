"""Gigabytes of zeros as deflate packs them, made in a moment: one packed block is repeated."""

from __future__ import annotations

import struct
import zlib

_BLOCK = 1 << 24


def deflated(head: bytes, size: int) -> bytes:
    """A head and `size` zeros (whole blocks of 16 MiB) as a bare deflate stream."""
    return _packed(head) + _packed(bytes(_BLOCK)) * (size // _BLOCK) + zlib.compressobj(9, zlib.DEFLATED, -15).flush()


def _packed(data: bytes) -> bytes:
    """Data that ends at a whole byte and refers to nothing before it."""
    packer = zlib.compressobj(9, zlib.DEFLATED, -15)
    return packer.compress(data) + packer.flush(zlib.Z_FULL_FLUSH)


def checksum(head: bytes, size: int) -> int:
    """CRC-32 of a head and zeros."""
    found, block = zlib.crc32(head), bytes(_BLOCK)
    for _ in range(size // _BLOCK):
        found = zlib.crc32(block, found)
    return found


def gzipped(head: bytes, size: int) -> bytes:
    """The same as gzip."""
    trailer = struct.pack("<II", checksum(head, size), (len(head) + size) & 0xFFFFFFFF)
    return b"\x1f\x8b\x08\0\0\0\0\0\x02\xff" + deflated(head, size) + trailer


def zlibbed(head: bytes, size: int) -> bytes:
    """The same as zlib."""
    found, block = zlib.adler32(head), bytes(_BLOCK)
    for _ in range(size // _BLOCK):
        found = zlib.adler32(block, found)
    return b"\x78\xda" + deflated(head, size) + struct.pack(">I", found)


def shared_zip(head: bytes, size: int, names: list[str], claimed: int | None = None) -> bytes:
    """A zip archive whose entries are all the same bytes of the file, a head and zeros (Fifield 2019).

    Args:
        head: Beginning of every entry.
        size: Zeros behind it.
        names: Of the entries.
        claimed: Size that the directory claims instead of the true one.
    """
    packed, total = deflated(head, size), len(head) + size
    sizes = struct.pack("<III", checksum(head, size), len(packed), total if claimed is None else claimed)
    first = names[0].encode()
    local = b"PK\x03\x04" + struct.pack("<HHHHH", 20, 0, 8, 0, 0) + sizes + struct.pack("<HH", len(first), 0)
    start = local + first + packed
    directory = b"".join(
        b"PK\x01\x02" + struct.pack("<HHHHHH", 20, 20, 0, 8, 0, 0) + sizes
        + struct.pack("<HHHHHII", len(name.encode()), 0, 0, 0, 0, 0, 0) + name.encode()
        for name in names
    )  # fmt: skip
    end = struct.pack("<HHHHIIH", 0, 0, len(names), len(names), len(directory), len(start), 0)
    return start + directory + b"PK\x05\x06" + end
