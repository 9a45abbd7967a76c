"""Pictures whose texts, profiles or scans are bombs. Reference: what cv2 and Pillow make of the picture without."""

from __future__ import annotations

import io
import struct
import time
import zlib
from pathlib import Path

import cv2
import numpy as np
import pytest
from PIL import Image

from ggavatar.errors import InputError
from ggavatar.io.images import read_gray, read_rgb, write_png
from ggavatar.io.picture_bytes import pixels_only, png_chunks

BOMB = b"a\0\0" + zlib.compress(bytes(8_000_000), 9)


def chunk(kind: bytes, body: bytes) -> bytes:
    return struct.pack(">I", len(body)) + kind + body + struct.pack(">I", zlib.crc32(kind + body))


def with_chunks(path: Path, chunks: bytes) -> np.ndarray:
    """Write a small picture with further chunks before its pixels; returns the picture."""
    image = np.random.default_rng(0).integers(0, 255, (12, 16, 3), dtype=np.uint8)
    write_png(path, image)
    data = path.read_bytes()
    path.write_bytes(data[:33] + chunks + data[33:])
    return image


@pytest.mark.parametrize(
    ("kind", "body"),
    [
        (b"zTXt", BOMB),
        (b"iTXt", b"a\0\1\0\0\0" + zlib.compress(bytes(8_000_000), 9)),
        (b"iCCP", BOMB),
        (b"acTL", struct.pack(">II", 100_000, 0)),
    ],
)
def test_texts_and_profiles_are_not_unpacked(kind: bytes, body: bytes, tmp_path: Path) -> None:
    """Three hundred of 8 MB each: 27 s in libpng."""
    path = tmp_path / "bomb.png"
    image = with_chunks(path, chunk(kind, body) * 300)
    began = time.process_time()
    np.testing.assert_array_equal(read_rgb(path), image)
    np.testing.assert_array_equal(read_gray(path), cv2.cvtColor(image, cv2.COLOR_RGB2GRAY))
    assert time.process_time() - began < 3


def test_what_is_kept(tmp_path: Path) -> None:
    """Pixels, palettes and transparency; a picture without anything else stays the same object."""
    path = tmp_path / "palette.png"
    Image.fromarray(np.arange(64, dtype=np.uint8).reshape(8, 8)).convert("P").save(
        path, transparency=bytes(range(0, 256, 4)), pnginfo=None, dpi=(72, 72)
    )
    data = path.read_bytes()
    kept = pixels_only(data)
    assert [kind for kind, _, _ in png_chunks(data)] == [b"IHDR", b"PLTE", b"tRNS", b"pHYs", b"IDAT", b"IEND"]
    assert [kind for kind, _, _ in png_chunks(kept)] == [b"IHDR", b"PLTE", b"tRNS", b"IDAT", b"IEND"]
    decoded = [cv2.imdecode(np.frombuffer(each, np.uint8), cv2.IMREAD_UNCHANGED) for each in (data, kept)]
    np.testing.assert_array_equal(*decoded)
    assert pixels_only(kept) is kept and pixels_only(b"\xff\xd8x") == b"\xff\xd8x"


def test_chunks_without_end(tmp_path: Path) -> None:
    path = tmp_path / "many.png"
    with_chunks(path, chunk(b"tEXt", b"") * 100_000)
    with pytest.raises(InputError, match=r"many\.png: the image is damaged \(more than 100000 chunks\)"):
        read_rgb(path)
    with_chunks(path, struct.pack(">I", 1 << 30) + b"tEXt")
    with pytest.raises(InputError, match="cut off"):
        read_rgb(path)


def progressive(scans: int, thumbnail: bytes = b"") -> bytes:
    """A progressive JPEG of ten scans, the last of them repeated."""
    buffer = io.BytesIO()
    Image.new("RGB", (64, 48), (90, 120, 30)).save(buffer, "JPEG", progressive=True)
    data = buffer.getvalue()
    last = data[data.rfind(b"\xff\xda") : -2]
    segment = b"\xff\xe3" + struct.pack(">H", len(thumbnail) + 2) + thumbnail if thumbnail else b""
    return data[:2] + segment + data[2:-2] + last * (scans - 10) + b"\xff\xd9"


def test_scans_of_a_jpeg_are_counted(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "scans.jpg"
    path.write_bytes(progressive(5000))
    began = time.process_time()
    with pytest.raises(InputError, match=r"scans\.jpg: the image is damaged \(more than 24 scans\)"):
        read_rgb(path)
    assert time.process_time() - began < 1
    for data in (progressive(10), progressive(10, b"\xff\xda\0\3a" * 100)):
        path.write_bytes(data)
        assert read_rgb(path).shape == (48, 64, 3)
    path.write_bytes(progressive(10) + b"\xff\xda\0\3a" * 100)  # behind the end, as in files of several pictures
    assert read_rgb(path).shape == (48, 64, 3)
    capfd.readouterr()
