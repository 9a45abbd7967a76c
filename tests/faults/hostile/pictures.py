"""Pictures that lie about their size, expand without end, or are another format than their name says."""

from __future__ import annotations

import struct
import zlib
from collections.abc import Iterator

import cv2
import numpy as np

from tests.faults.hostile.bases import FILES, FRAMES, PICTURES, RUN
from tests.faults.hostile.fixture import Hostile
from tests.faults.hostile.samples import image
from tests.faults.hostile.zeros import zlibbed

_SIGNATURE = b"\x89PNG\r\n\x1a\n"


def chunk(kind: bytes, data: bytes, length: int | None = None, checksum: int | None = None) -> bytes:
    """A PNG chunk, true unless told otherwise."""
    found = zlib.crc32(kind + data) if checksum is None else checksum
    return struct.pack(">I", len(data) if length is None else length) + kind + data + struct.pack(">I", found)


def ihdr(width: int, height: int, depth: int = 8, color: int = 2, rest: bytes = b"\0\0\0") -> bytes:
    """The header of a PNG."""
    return chunk(b"IHDR", struct.pack(">IIBB", width, height, depth, color) + rest)


def png(*chunks: bytes, size: tuple[int, int] = (8, 8), pixels: bytes | None = None) -> bytes:
    """A PNG with further chunks before its pixels."""
    rows = bytes((3 * size[0] + 1) * size[1]) if pixels is None else pixels
    return _SIGNATURE + ihdr(*size) + b"".join(chunks) + chunk(b"IDAT", zlib.compress(rows)) + chunk(b"IEND", b"")


def _pngs() -> dict[str, bytes]:
    bomb = zlibbed(b"", 48 << 20)
    text = chunk(b"zTXt", b"k\0\0" + bomb)
    deep = chunk(b"eXIf", b"MM\0*\0\0\0\x08" + b"\0\x01\x01\x12\0\x03\0\0\0\x01\0\x06\0\0\0\0\0\x08")
    return {
        "60,000 × 60,000 px": _SIGNATURE + ihdr(60_000, 60_000) + chunk(b"IDAT", zlib.compress(bytes(1000))),
        "2^31 px wide": _SIGNATURE + ihdr((1 << 31) - 1, 1) + chunk(b"IDAT", b""),
        "2^32 − 1 px high": _SIGNATURE + ihdr(1, 0xFFFFFFFF) + chunk(b"IDAT", b""),
        "no width": _SIGNATURE + ihdr(0, 8) + chunk(b"IDAT", b""),
        "34 megapixels from nothing": _SIGNATURE + ihdr(8000, 4200) + chunk(b"IDAT", zlib.compress(bytes(30_000))),
        "34 megapixels of zeros": png(size=(8000, 4200)),
        "16 bits, 34 megapixels": _SIGNATURE + ihdr(8000, 4200, 16, 6) + chunk(b"IDAT", zlibbed(b"", 288 << 20)),
        "7 bits": _SIGNATURE + ihdr(8, 8, 7) + chunk(b"IDAT", zlib.compress(bytes(200))),
        "255 bits": _SIGNATURE + ihdr(8, 8, 255) + chunk(b"IDAT", zlib.compress(bytes(200))),
        "an unknown color type": _SIGNATURE + ihdr(8, 8, 8, 5) + chunk(b"IDAT", zlib.compress(bytes(200))),
        "an unknown interlacing": _SIGNATURE + ihdr(8, 8, rest=b"\0\0\x09") + chunk(b"IDAT", zlib.compress(bytes(200))),
        "interlaced": _SIGNATURE + ihdr(8, 8, rest=b"\0\0\x01") + chunk(b"IDAT", zlib.compress(bytes(200))),
        "a palette that is missing": _SIGNATURE + ihdr(8, 8, 8, 3) + chunk(b"IDAT", zlib.compress(bytes(72))),
        "a palette of 7 bytes": _SIGNATURE
        + ihdr(8, 8, 8, 3)
        + chunk(b"PLTE", bytes(7))
        + chunk(b"IDAT", zlib.compress(bytes(72))),
        "300 bombs of text": png(*[text] * 300),
        "a text of 50 MB": png(text),
        "an international text of 50 MB": png(chunk(b"iTXt", b"k\0\1\0\0\0" + bomb)),
        "a profile of 50 MB": png(chunk(b"iCCP", b"k\0\0" + bomb)),
        "a profile of nothing": png(chunk(b"iCCP", b"k\0\0" + zlib.compress(bytes(200)))),
        "a profile without end": png(chunk(b"iCCP", b"k" * 200)),
        "100,000 empty chunks": png(*[chunk(b"teSt", b"")] * 100_000),
        "a chunk of 2 GB": _SIGNATURE + ihdr(8, 8) + chunk(b"IDAT", b"x", 0x7FFFFFFF),
        "a chunk of 4 GB": _SIGNATURE + ihdr(8, 8) + chunk(b"teSt", b"x", 0xFFFFFFFF),
        "a wrong checksum": png(chunk(b"tEXt", b"k\0v", checksum=1)),
        "a header twice": png(ihdr(60_000, 60_000)),
        "no header": _SIGNATURE + chunk(b"IDAT", zlib.compress(bytes(200))) + chunk(b"IEND", b""),
        "no pixels": _SIGNATURE + ihdr(8, 8) + chunk(b"IEND", b""),
        "no end": png()[:-12],
        "pixels of 2 GB": _SIGNATURE + ihdr(8, 8) + chunk(b"IDAT", zlibbed(b"", 2 << 30)) + chunk(b"IEND", b""),
        "a wrong filter": png(pixels=bytes([9]) * 200),
        "EXIF that points at itself": png(deep),
        "EXIF of 8 MB": png(chunk(b"eXIf", b"II*\0\x08\0\0\0" + b"\xff" * (8 << 20))),
        "gamma 0": png(chunk(b"gAMA", bytes(4))),
        "gamma 2^31": png(chunk(b"gAMA", struct.pack(">I", (1 << 31) - 1))),
        "primaries 0": png(chunk(b"cHRM", bytes(32))),
        "primaries at their limits": png(chunk(b"cHRM", b"\x7f\xff\xff\xff" * 8)),
        "code points of nothing": png(chunk(b"cICP", b"\xff\xff\xff\xff")),
        "a transparent color of one byte": png(chunk(b"tRNS", b"\0")),
        "65,535 frames": png(chunk(b"acTL", struct.pack(">II", 0xFFFFFFFF, 0))),
        "a million frames": png(*[chunk(b"fcTL", bytes(26))] * 50_000),
        "only the signature": _SIGNATURE,
        "half a header": _SIGNATURE + ihdr(8, 8)[:10],
    }


def _segment(marker: int, data: bytes) -> bytes:
    return struct.pack(">BBH", 0xFF, marker, len(data) + 2) + data


def scans(width: int, height: int, count: int) -> bytes:
    """A progressive JPEG of that many scans, each of a few bytes that touch every block: end-of-band runs."""
    quantization = _segment(0xDB, b"\0" + b"\1" * 64)
    frame = _segment(0xC2, struct.pack(">BHHB", 8, height, width, 1) + b"\1\x11\0")
    lengths = bytes([0, 1] + [0] * 14)  # one code of two bits: 00
    dc, ac = _segment(0xC4, b"\0" + lengths + b"\0"), _segment(0xC4, b"\x10" + lengths + b"\xe0")
    blocks = -(-width // 8) * -(-height // 8)
    first = _segment(0xDA, b"\1\1\0\0\0\0") + bytes(-(-blocks * 2 // 8))
    runs = "".join("00" + "1" * 14 for _ in range(-(-blocks // 32767)))
    bits = runs + "1" * (-len(runs) % 8)
    body = bytes(int(bits[place : place + 8], 2) for place in range(0, len(bits), 8)).replace(b"\xff", b"\xff\0")
    ac_scan = _segment(0xDA, b"\1\1\0\1\x3f\0") + body
    return b"\xff\xd8" + quantization + frame + dc + ac + first + ac_scan * count + b"\xff\xd9"


def _jpegs() -> dict[str, bytes]:
    small, large = image(".jpg"), 65_500
    exif = b"Exif\0\0MM\0*\0\0\0\x08" + b"\xff\xff" + b"\x01\x12\0\x03\0\0\0\x01\0\x06\0\0" * 5000
    return {
        "65,500 × 65,500 px as JPEG": _resized(small, large, large),
        "34 megapixels from a kilobyte as JPEG": _resized(small, 8000, 4200),
        "no height as JPEG": _resized(small, 24, 0),
        "20,000 scans of 33 megapixels": scans(8000, 4100, 20_000),
        "1,000 scans": scans(800, 800, 1000),
        "restarts without end": small[:-2] + b"\xff\xd0" * 200_000,
        "fill bytes without end": small[:2] + b"\xff" * 2_000_000 + small[2:],
        "100,000 comments": small[:2] + _segment(0xFE, b"") * 100_000 + small[2:],
        "a segment of no length": small[:2] + b"\xff\xe1\0\0" + small[2:],
        "EXIF of 65,535 entries": small[:2] + _segment(0xE1, exif[:60_000]) + small[2:],
        "255 pieces of a profile": small[:2]
        + b"".join(_segment(0xE2, b"ICC_PROFILE\0" + bytes([n, 255]) + bytes(60_000)) for n in range(1, 256))
        + small[2:],
        "a piece 0 of 0 of a profile": small[:2] + _segment(0xE2, b"ICC_PROFILE\0\0\0") + small[2:],
        "four channels": small.replace(b"\x03\x01\x22\x00", b"\x04\x01\x22\x00"),
        "12 bits": small.replace(b"\xff\xc0\x00\x11\x08", b"\xff\xc0\x00\x11\x0c"),
        "arithmetic coding": small.replace(b"\xff\xc0\x00\x11", b"\xff\xc9\x00\x11"),
        "lossless": small.replace(b"\xff\xc0\x00\x11", b"\xff\xc3\x00\x11"),
        "only a start": b"\xff\xd8",
        "no frame": b"\xff\xd8\xff\xd9",
    }


def _resized(data: bytes, width: int, height: int) -> bytes:
    """A JPEG whose frame header claims another size."""
    place = data.index(b"\xff\xc0") + 5
    return data[:place] + struct.pack(">HH", height, width) + data[place + 4 :]


def _others() -> dict[str, bytes]:
    """Formats that OpenCV or Pillow would decode if they were asked."""
    found = {}
    for suffix in (".webp", ".tiff", ".bmp", ".ppm", ".hdr"):
        pixels = np.zeros((8, 8, 3), np.float32 if suffix == ".hdr" else np.uint8)
        done, data = cv2.imencode(suffix, pixels)
        if done:
            found[f"{suffix[1:]} under another name"] = data.tobytes()
    tiff = struct.pack("<2sHIH", b"II", 42, 8, 3) + b"".join(
        struct.pack("<HHII", tag, 4, 1, value) for tag, value in ((256, 1 << 30), (257, 1 << 30), (259, 1))
    )
    svg = b'<?xml version="1.0"?><!DOCTYPE x [<!ENTITY a SYSTEM "file:///etc/passwd">]><svg>&a;</svg>'
    return found | {
        "a TIFF of 2^60 px": tiff,
        "SVG with an entity": svg,
        "PostScript": b"%!PS-Adobe-3.0 EPSF-3.0\n(canary) (w) file\n",
        "a GIF of 65,535 px": b"GIF89a" + struct.pack("<HH", 65535, 65535) + b"\x00\x00\x00,;",
        "a BMP of 2^31 px": b"BM"
        + struct.pack("<IIIIiiHHIIIIII", 54, 0, 54, 40, 1 << 30, 1 << 30, 1, 24, 0, 0, 0, 0, 0, 0),
        "MVG": b"push graphic-context\nimage over 0,0 0,0 '|touch canary'\npop graphic-context\n",
        "PBM of 10^9 px": b"P4 1000000000 1000000000\n",
        "OpenEXR of 2^31 px": b"v/1\x01\x02\0\0\0" + b"dataWindow\0box2i\0\x10\0\0\0" + b"\xff\xff\xff\x7f" * 4,
        "HTML": b"<html><script>alert(1)</script>",
        "a shell script": b"#!/bin/sh\ntouch canary\n",
    }


def fixtures() -> list[Hostile]:
    """All of them as a picture, and in turn in a folder of frames, of predictions, and in a capture."""
    return list(_fixtures())


def _fixtures() -> Iterator[Hostile]:
    for number, (title, data) in enumerate((_pngs() | _jpegs() | _others()).items()):
        name = "picture.jpg" if title in _jpegs() else "picture.png"
        yield Hostile(title, FILES, "picture", name, {name: data})
        if number % 3 == 0:
            yield Hostile(f"{title} among frames", FRAMES, "frames", ".", {"00001.png": data})
        elif number % 3 == 1:
            yield Hostile(f"{title} among predictions", PICTURES, "pictures", ".", {"pred/00001.png": data})
        else:
            files = {"capture/images/000001.png": data, "capture/masks/000002.png": data}
            yield Hostile(f"{title} in a capture", RUN, "capture", "capture", files)
