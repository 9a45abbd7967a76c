"""What mask values mean. Reference: the coverage that each encoding was made from."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from ggavatar.errors import InputError
from ggavatar.io.images import read_unchanged
from preprocess.masks.levels import find_levels

SIZE = 96


def soft(x=48, radius=30):
    """A disc with a soft edge, 0 to 255."""
    rows, columns = np.mgrid[:SIZE, :SIZE]
    distance = radius - np.hypot(rows - 60, columns - x)
    return np.round(255 * np.clip(distance / 4 + 0.5, 0, 1)).astype(np.uint8)


def hard(x=48):
    return np.where(soft(x) > 127, 255, 0).astype(np.uint8)


def classes(x=48):
    """Face parsing: 0 background, 1 skin, 17 hair, 16 clothes."""
    person, rows = hard(x) > 0, np.mgrid[:SIZE, :SIZE][0]
    return np.where(person, np.select([rows < 45, rows < 70], [17, 1], 16), 0).astype(np.uint8)


def rgba(color, alpha):
    return np.dstack((np.broadcast_to(color, (*alpha.shape, 3)), alpha)).astype(np.uint8)


def read_back(tmp_path, stored, suffix=".png"):
    """The values after a round trip through a file written by OpenCV (BGR)."""
    path = tmp_path / f"mask{suffix}"
    flipped = stored if stored.ndim == 2 else stored[..., [2, 1, 0, *range(3, stored.shape[2])]]
    assert cv2.imwrite(str(path), np.ascontiguousarray(flipped))
    return read_unchanged(path)


def palette_png(path, indices, palette):
    """A PNG of color type 3 (palette), from the PNG specification."""
    import struct
    import zlib

    def chunk(kind, data):
        return struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))

    height, width = indices.shape
    rows = b"".join(b"\0" + row.tobytes() for row in indices)
    parts = (
        chunk(b"IHDR", struct.pack(">IIBBBBB", width, height, 8, 3, 0, 0, 0)),
        chunk(b"PLTE", bytes(np.asarray(palette, np.uint8).ravel())),
        chunk(b"IDAT", zlib.compress(rows)),
        chunk(b"IEND", b""),
    )
    path.write_bytes(b"\x89PNG\r\n\x1a\n" + b"".join(parts))


FACE = np.array([200, 150, 120])
VOC = [(0, 0, 0), (128, 0, 0), (0, 128, 0), (128, 128, 0)] + [(64, 0, 128)] * 12 + [(192, 128, 128)]

READ = {
    "0 and 255": (hard, hard, ""),
    "soft": (soft, soft, ""),
    "0 and 1": (lambda: hard() // 255, hard, "0 (background) and 1 (person)"),
    "0 and 128": (lambda: hard() // 255 * 128, hard, "0 (background) and 128 (person)"),
    "Cityscapes' index of persons": (lambda: hard() // 255 * 24, hard, "24 (person)"),
    "16 bits": (lambda: hard().astype(np.uint16) * 257, hard, ""),
    "soft in 16 bits": (lambda: soft().astype(np.uint16) * 257, soft, "16-bit"),
    "0 to 255 in 16 bits": (lambda: soft().astype(np.uint16), soft, ""),
    "percent": (lambda: np.round(soft() / 2.55).astype(np.uint8), soft, "100 (person)"),
    "video levels": (lambda: np.round(16 + soft() * (219 / 255)).astype(np.uint8), soft, "16 (background) and 235"),
    "face parsing": (classes, hard, "class indices 0, 1, 16, 17"),
    "face parsing in three channels": (lambda: np.dstack([classes()] * 3), hard, "class indices 0, 1, 16, 17"),
    "classes spread over the grays": (
        lambda: np.select([classes() == 1, classes() == 16, classes() == 17], [85, 170, 255], 0).astype(np.uint8),
        hard, "levels 0, 85, 170, 255",
    ),
    "classes in color": (lambda: np.asarray(VOC, np.uint8)[np.minimum(classes(), 16)], hard, "colors"),
    "coverage in red": (lambda: np.dstack((soft(), 0 * soft(), 0 * soft())), soft, "shades of one color"),
    "gray in three channels": (lambda: np.dstack([soft()] * 3), soft, ""),
    "straight alpha": (lambda: rgba(FACE, soft()), soft, "alpha channel is the mask"),
    "premultiplied alpha": (
        lambda: rgba(FACE[None, None] * (soft()[..., None] / 255), soft()), soft, "alpha channel is the mask",
    ),
    "alpha of 0 and 1": (lambda: rgba(FACE, hard() // 255), hard, "alpha channel is the mask"),
    "gray with opaque alpha": (lambda: np.dstack((*[soft()] * 3, np.full_like(soft(), 255))), soft, ""),
}  # fmt: skip


@pytest.mark.parametrize("name", READ)
def test_read_as_coverage(tmp_path, name):
    make, expected, note = READ[name]
    stored = read_back(tmp_path, make())
    empty = np.full_like(stored, stored.min())
    levels = find_levels([stored, empty] if stored.ndim == 2 else [stored], "masks")
    found = levels.coverage(stored)
    assert found.dtype == np.uint8 and np.abs(found.astype(int) - expected()).max() <= 3
    assert note in levels.note and bool(note) == bool(levels.note)
    if stored.ndim == 2:
        assert not levels.coverage(empty).any()


def test_usual_masks_keep_every_value(tmp_path):
    np.testing.assert_array_equal(find_levels([soft()], "masks").coverage(soft()), soft())
    jpeg = read_back(tmp_path, soft(), ".jpg")
    np.testing.assert_array_equal(find_levels([jpeg], "masks").coverage(jpeg), jpeg)


@pytest.mark.parametrize("highest", [1, 16])
def test_palettes_are_read_as_colors(tmp_path, highest):
    """DAVIS and Pascal VOC: index 0 is black, and the person's color is dark."""
    indices = (hard() // 255 * highest).astype(np.uint8)
    palette_png(tmp_path / "p.png", indices, VOC)
    stored = read_unchanged(tmp_path / "p.png")
    levels = find_levels([stored], "masks")
    np.testing.assert_array_equal(levels.coverage(stored), hard())
    assert "black is the background" in levels.note


def photograph():
    generator = np.random.default_rng(0)
    return cv2.GaussianBlur(generator.integers(0, 256, (SIZE, SIZE, 3), dtype=np.uint8), (0, 0), 3)


def stretched(image):
    return cv2.normalize(image, None, 0, 255, cv2.NORM_MINMAX)


REFUSED = {
    "white": (lambda: np.full((SIZE, SIZE), 255, np.uint8), "255 .white. everywhere"),
    "ones": (lambda: np.ones((SIZE, SIZE), np.uint8), "1 everywhere"),
    "black": (lambda: np.zeros((SIZE, SIZE), np.uint8), "are empty: every pixel of 1 of them is 0 .black."),
    "a trimap": (
        lambda: np.where((soft(radius=36) > 0) & (soft(radius=22) == 0), 128, hard()).astype(np.uint8), "trimap",
    ),
    "indices without background": (lambda: classes() + 1, "class indices 1, 2, 17, 18 without a 0"),
    "grays without background": (
        lambda: np.select([classes() == 1, classes() == 16, classes() == 17], [85, 170, 255], 40).astype(np.uint8),
        "without a 0",
    ),
    "colors without black": (
        lambda: (np.asarray(VOC, np.uint8)[np.minimum(classes(), 16)] + np.uint8(20)), "none of them black",
    ),
    "a photograph": (photograph, "found color images;"),
    "a cut-out with opaque alpha": (
        lambda: np.dstack((photograph() * (hard()[..., None] > 0), np.full((SIZE, SIZE), 255, np.uint8))),
        "color images with an opaque alpha channel; .* export the alpha channel",
    ),
    "a gray photograph": (lambda: stretched(photograph()[..., 0]), "gray images"),
}  # fmt: skip


@pytest.mark.parametrize("name", REFUSED)
def test_refused_by_name(tmp_path, name):
    make, message = REFUSED[name]
    with pytest.raises(InputError, match=f"masks: .*{message}.*leave --masks out"):
        find_levels([read_back(tmp_path, make())], "masks")


def test_one_empty_mask_decides_nothing():
    levels = find_levels([np.zeros((SIZE, SIZE), np.uint8), hard() // 255, np.zeros((SIZE, SIZE), np.uint8)], "masks")
    np.testing.assert_array_equal(levels.coverage(hard() // 255), hard())
