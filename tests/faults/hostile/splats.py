"""Files of Gaussians whose headers lie, that expand without end, or that name files elsewhere."""

from __future__ import annotations

import gzip
import json
import struct
from collections.abc import Iterator

import numpy as np
import zstandard

from tests.faults.hostile.archives import zipped
from tests.faults.hostile.bases import FILES
from tests.faults.hostile.fixture import Hostile
from tests.faults.hostile.zeros import gzipped
from tests.support.splat_files import sog, sog_2
from tests.support.splat_samples import SPLATS

_HEAD = b"ply\nformat binary_little_endian 1.0\n"


def _plys() -> dict[str, bytes]:
    valid = SPLATS["little.ply"]()
    end = valid.index(b"end_header\n")
    ascii_ply = SPLATS["ascii.ply"]()
    rows = ascii_ply.index(b"end_header\n") + 11

    def counted(count: bytes) -> bytes:
        return valid.replace(b"element vertex 20", b"element vertex " + count)

    return {
        "4 billion rows": counted(b"4000000000"),
        "10^30 rows": counted(b"9" * 30),
        "a negative number of rows": counted(b"-1"),
        "no rows": counted(b"0"),
        "rows in Arabic digits": counted("٣".encode()),
        "two billion lists": _HEAD + b"element face 2000000000\nproperty list uint uint i\nend_header\n",
        "a list of 4 billion": _HEAD + b"element vertex 1\nproperty list uint double x\nend_header\n\xff\xff\xff\xff",
        "10,000 properties": _HEAD
        + b"element vertex 1\n"
        + b"".join(b"property float p%d\n" % n for n in range(10_000))
        + b"end_header\n",
        "10,000 elements": _HEAD + b"".join(b"element e%d 0\n" % n for n in range(10_000)) + b"end_header\n",
        "50 million rows of nothing": _HEAD
        + b"element empty 50000000\nelement vertex 1\nproperty float x\nend_header\n",
        "a header of 20 MB": b"ply\n" + b"comment x\n" * 2_000_000 + b"end_header\n",
        "a line of 20 MB": b"ply\ncomment " + b"x" * 20_000_000,
        "a row of 20 MB": ascii_ply[:rows] + b"1 " * 10_000_000,
        "a number of a megabyte": ascii_ply[:rows] + b"9" * 1_000_000 + ascii_ply[rows:],
        "numbers in hexadecimal": ascii_ply[:rows] + ascii_ply[rows:].replace(b"0.", b"0x1p"),
        "numbers of words": ascii_ply[:rows] + b"nan inf -inf 1e999 " * 200,
        "control characters in a comment": valid[:end] + b"comment \x1b[2J\n::error::x\n" + valid[end:],
        "the same element twice": valid[:end] + b"element vertex 20\nproperty float x\n" + valid[end:],
        "an unknown type": valid.replace(b"property float x", b"property quad x"),
        "doubles of NaN": valid[: end + 11] + b"\xff" * (len(valid) - end - 11),
        "no end of the header": valid[:end],
        "no Gaussians": _HEAD + b"element vertex 1\nproperty float x\nend_header\n\0\0\0\0",
    }


def _spzs() -> dict[str, bytes]:
    head = struct.pack("<4sIIBBB", b"NGSP", 2, 3, 0, 12, 0) + b"\0"
    many = struct.pack("<4sIIBBB", b"NGSP", 2, 0xFFFFFFFF, 0, 12, 0) + b"\0"
    packed = zstandard.ZstdCompressor().compress(bytes(64 << 20))
    table = struct.pack("<QQ", len(packed), 64 << 20)
    new = struct.pack("<4sIIBBBBI12x", b"NGSP", 4, 3, 0, 12, 0, 1, 32)
    window = zstandard.ZstdCompressor(compression_params=zstandard.ZstdCompressionParameters(window_log=27)).compress(
        b"x" * 1000
    )
    return {
        "gzip of 1 GB": gzipped(head, 1 << 30),
        "4 billion Gaussians": gzip.compress(many + bytes(1000)),
        "4 billion Gaussians in 1 GB": gzipped(many, 1 << 30),
        "version 99": gzip.compress(struct.pack("<4sIIBBB", b"NGSP", 99, 3, 0, 12, 0) + bytes(100)),
        "degree 255": gzip.compress(struct.pack("<4sIIBBB", b"NGSP", 2, 3, 255, 12, 0) + bytes(10_000)),
        "255 fraction bits": gzip.compress(struct.pack("<4sIIBBB", b"NGSP", 2, 3, 0, 255, 0) + bytes(100)),
        "a thousand gzip members": gzip.compress(head) * 1000,
        "gzip cut off": gzip.compress(head + bytes(1000))[:20],
        "zstd of 64 MB": new + table + packed,
        "a zstd block that claims 2^60": new + struct.pack("<QQ", len(packed), 1 << 60) + packed,
        "a zstd block longer than the file": new + struct.pack("<QQ", 1 << 60, 100) + packed[:100],
        "a zstd window of 128 MB": new + struct.pack("<QQ", len(window), 1000) + window,
        "255 zstd blocks": struct.pack("<4sIIBBBBI12x", b"NGSP", 4, 3, 0, 12, 0, 255, 32) + bytes(16 * 255),
        "blocks beyond the file": struct.pack("<4sIIBBBBI12x", b"NGSP", 4, 3, 0, 12, 0, 1, 0xFFFFFFFF) + table,
        "extensions without end": struct.pack("<4sIIBBBBI12x", b"NGSP", 4, 3, 0, 12, 2, 1, 40) + b"\xff" * 8 + table,
    }


def _sogs() -> dict[str, bytes]:
    meta, images = sog_2()
    files = sog(meta, images)

    def changed(**parts: object) -> bytes:
        return zipped(files | {"meta.json": json.dumps(meta | parts).encode()})

    huge = files["l.webp"][:21] + b"\xff\xff\xff\x0f" + files["l.webp"][25:]
    outside = ("../../victim.txt", "/etc/passwd", "/dev/zero", "a\0b", "", ".", "x" * 100_000)
    found = {f"a part named {name[:20]!r}": changed(sh0=meta["sh0"] | {"files": [name]}) for name in outside}
    found |= {f"{count} Gaussians": changed(count=count) for count in (0, -1, 1 << 40, 10**30, "5", None, 1.5, True)}
    return found | {
        "a WebP of 16,384 px": zipped(files | {"l.webp": huge}),
        "a WebP of nothing": zipped(files | {"l.webp": b""}),
        "a part that is meta.json": changed(sh0=meta["sh0"] | {"files": ["meta.json"]}),
        "a codebook of text": changed(scales=meta["scales"] | {"codebook": ["x"] * 256}),
        "a codebook of 10^6": changed(scales=meta["scales"] | {"codebook": [0.0] * 1_000_000}),
        "a codebook of lists": changed(scales=meta["scales"] | {"codebook": [[[]]] * 256}),
        "a codebook of 1e308": changed(scales=meta["scales"] | {"codebook": [1e308] * 256}),
        "bands of 10^9": changed(shN=meta["shN"] | {"bands": 10**9}),
        "65,536 palettes": changed(shN=meta["shN"] | {"count": 65_536}),
        "50 directories deep": zipped({"a/" * 50 + name: content for name, content in files.items()}),
        "many meta.json": zipped({f"{number}/meta.json": b"{}" for number in range(3000)}),
        "meta.json of 60 MB": zipped({"meta.json": b'{"means": "' + b"x" * (60 << 20) + b'"}'}),
        "levels of detail": zipped({"lod-meta.json": b'{"lodLevels": 1}'}),
    }


def _rest() -> dict[str, bytes]:
    glb = struct.pack("<4sII", b"glTF", 2, 0xFFFFFFFF) + struct.pack("<I4s", 0xFFFFFFFF, b"JSON") + b"{}"
    records = np.zeros((10, 32), np.uint8)
    return {
        "a glTF of 4 GB": glb,
        "a glTF of brackets": struct.pack("<4sIII4s", b"glTF", 2, 100_000, 99_000, b"JSON") + b"[" * 99_000,
        "a .splat of zeros": bytes(3200),
        "a .splat of NaN": b"\xff" * 3200,
        "a .splat of infinities": records.tobytes().replace(bytes(4), b"\0\0\x80\x7f"),
        "a .splat of 31 bytes": bytes(31),
        "a .splat of nothing": b"",
        "text": b"hello\n" * 100,
    }


def fixtures() -> list[Hostile]:
    """All of them, read and by `ggavatar-export`."""
    return list(_fixtures())


def _fixtures() -> Iterator[Hostile]:
    kinds = (("little.ply", _plys()), ("2.spz", _spzs()), ("2.sog", _sogs()), ("a.splat", _rest()))
    for name, found in kinds:
        for number, (title, data) in enumerate(found.items()):
            yield Hostile(f"{title} as {name}", FILES, "gaussians", name, {name: data})
            if number % 5 == 0:
                yield Hostile(f"{title} as {name}", FILES, "export-file", name, {name: data})
