"""Pictures of any kind become upright sRGB. References: Pillow, the PNG specification, the formulas of the standards.

Also covers `ggavatar/io/images.py`, `ggavatar/io/image_header.py` and `ggavatar/io/image_colors.py`.
"""

from __future__ import annotations

import io
import struct
import zlib
from pathlib import Path

import cv2
import numpy as np
import pytest
from PIL import Image, ImageCms, ImageOps

from ggavatar.errors import InputError
from ggavatar.io.images import image_header, read_gray, read_rgb, read_unchanged, write_png
from ggavatar.io.picture_decoding import picture_kind, read_picture
from ggavatar.pictures.color import conversion_to_srgb, tagged_color_space
from tests.support.hdr_reference import hdr_to_srgb
from tests.support.pictures import (
    asymmetric,
    display_p3_profile,
    exif_block,
    patch_values,
    patches,
    with_jpeg_segment,
    with_png_chunk,
)


def png(image: np.ndarray, **options: object) -> bytes:
    file = io.BytesIO()
    Image.fromarray(image).save(file, "PNG", **options)
    return file.getvalue()


def jpeg(image: Image.Image, **options: object) -> bytes:
    file = io.BytesIO()
    image.save(file, "JPEG", quality=98, subsampling=0, **options)
    return file.getvalue()


def stored(path: Path, data: bytes) -> Path:
    path.write_bytes(data)
    return path


def icc_chunk(profile: bytes) -> bytes:
    return b"name\0\0" + zlib.compress(profile)


@pytest.mark.parametrize("value", range(1, 9))
@pytest.mark.parametrize("behind_pixels", [False, True])
def test_exif_in_png(tmp_path, value, behind_pixels):
    """Reference: Pillow, for the block at either place."""
    image = asymmetric()
    path = stored(tmp_path / "a.png", with_png_chunk(png(image), b"eXIf", exif_block(value), behind_pixels))
    expected = np.array(
        ImageOps.exif_transpose(
            Image.open(stored(tmp_path / "b.png", png(image, exif=b"Exif\0\0" + exif_block(value))))
        )
    )
    np.testing.assert_array_equal(read_rgb(path), expected)
    assert image_header(path)[:2] == expected.shape[1::-1]
    assert (read_picture(path).notes == ()) == (value == 1)
    mask = cv2.cvtColor(expected, cv2.COLOR_RGB2GRAY)
    np.testing.assert_array_equal(read_gray(path), mask)
    np.testing.assert_array_equal(read_unchanged(path), expected)


@pytest.mark.parametrize("value", range(1, 9))
def test_exif_in_jpeg(tmp_path, value):
    """Reference: OpenCV, which turns images by itself unless it is told not to. An XMP segment lies before EXIF."""
    data = with_jpeg_segment(jpeg(Image.fromarray(asymmetric())), 0xE1, b"Exif\0\0" + exif_block(value, ">"))
    path = stored(tmp_path / "a.jpg", with_jpeg_segment(data, 0xE1, b"http://ns.adobe.com/xap/1.0/\0<x/>"))
    expected = cv2.cvtColor(cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_COLOR), cv2.COLOR_BGR2RGB)
    np.testing.assert_array_equal(read_rgb(path), expected)
    assert image_header(path)[:2] == expected.shape[1::-1]


def test_what_we_write_is_read_unchanged(tmp_path):
    write_png(tmp_path / "a.png", asymmetric())
    np.testing.assert_array_equal(read_rgb(tmp_path / "a.png"), asymmetric())
    assert picture_kind(tmp_path / "a.png").notes == () and not picture_kind(tmp_path / "a.png").has_alpha


@pytest.mark.parametrize("container", ["png", "jpg"])
def test_display_p3_photos(tmp_path, container):
    """Reference: the formula for Display P3."""
    colors = np.random.default_rng(6).integers(20, 236, (3, 4, 3)).astype(np.uint8)
    image, profile = Image.fromarray(patches(colors)), display_p3_profile()
    data = png(np.array(image), icc_profile=profile) if container == "png" else jpeg(image, icc_profile=profile)
    picture = read_picture(stored(tmp_path / f"a.{container}", data))
    expected = conversion_to_srgb(tagged_color_space(12, 13)).apply(colors)
    assert np.abs(patch_values(picture.color).astype(int) - expected).max() <= 3
    assert picture.notes == ("colors converted from the embedded profile 'Display P3 of a test' to sRGB",)
    assert read_gray(tmp_path / f"a.{container}").shape == (48, 64), "profiles do not concern masks"


def test_a_profile_in_several_jpeg_segments(tmp_path):
    """ICC.1, annex B.4: each segment has its number and the count; here the second lies first."""
    profile, data = display_p3_profile(), jpeg(Image.fromarray(asymmetric()))
    for number, part in ((1, profile[:300]), (2, profile[300:])):
        data = with_jpeg_segment(data, 0xE2, b"ICC_PROFILE\0" + bytes([number, 2]) + part)
    assert "Display P3" in read_picture(stored(tmp_path / "a.jpg", data)).notes[0]


def test_srgb_profile_changes_nothing(tmp_path):
    profile = ImageCms.ImageCmsProfile(ImageCms.createProfile("sRGB")).tobytes()
    picture = read_picture(stored(tmp_path / "a.png", png(asymmetric(), icc_profile=profile)))
    np.testing.assert_array_equal(picture.color, asymmetric())
    assert picture.notes == ()


def test_damaged_and_foreign_profiles_are_ignored_and_said(tmp_path):
    damaged = with_png_chunk(png(asymmetric()), b"iCCP", icc_chunk(b"x" * 500))
    foreign = with_png_chunk(png(asymmetric()[..., 0]), b"iCCP", icc_chunk(display_p3_profile()))
    for name, data in (("damaged", damaged), ("foreign", foreign)):
        picture = read_picture(stored(tmp_path / f"{name}.png", data))
        assert any("ignored" in note for note in picture.notes)
        np.testing.assert_array_equal(picture.color[..., 0], asymmetric()[..., 0])
    bomb = with_png_chunk(png(asymmetric()), b"iCCP", icc_chunk(bytes(1 << 24)))
    assert read_picture(stored(tmp_path / "bomb.png", bomb)).notes == ()
    for body in (b"", b"noend", b"a\0\0notdeflate"):
        data = with_png_chunk(png(asymmetric()), b"iCCP", body)
        assert read_picture(stored(tmp_path / "x.png", data)).notes == ()


@pytest.mark.parametrize("transfer", [16, 18])
def test_hdr_png_of_16_bits(tmp_path, transfer):
    """PNG (third edition), section 11.3.2.6: cICP holds primaries, transfer curve, matrix 0 and the range."""
    colors = np.random.default_rng(7).integers(0, 65536, (3, 4, 3)).astype(np.uint16)
    ok, encoded = cv2.imencode(".png", patches(colors)[..., ::-1])
    assert ok
    path = stored(tmp_path / "a.png", with_png_chunk(encoded.tobytes(), b"cICP", bytes([9, transfer, 0, 1])))
    expected = np.array([[hdr_to_srgb(pixel / 65535, transfer) for pixel in row] for row in colors.astype(float)])
    assert np.abs(patch_values(read_rgb(path)) - 255 * expected).max() <= 0.75
    assert "tone-mapped" in read_picture(path).notes[0]


def test_colors_that_cannot_be_converted_are_refused(tmp_path):
    for body, words in ((bytes([9, 16, 0, 0]), "narrow range"), (bytes([1, 10, 0, 1]), "code point 10")):
        path = stored(tmp_path / "a.png", with_png_chunk(png(asymmetric()), b"cICP", body))
        with pytest.raises(InputError, match=rf"a\.png: the image states .*{words}.*save it as sRGB"):
            read_rgb(path)


def test_gamma_and_chromaticities_of_png(tmp_path):
    """ffmpeg writes gamma 1.96 and the primaries of BT.709 into frames that it extracts: these are left alone."""
    image = patches(np.random.default_rng(8).integers(0, 256, (3, 4, 3)).astype(np.uint8))
    bt709 = struct.pack(">8I", 31270, 32900, 64000, 33000, 30000, 60000, 15000, 6000)
    usual = with_png_chunk(with_png_chunk(png(image), b"gAMA", struct.pack(">I", 51000)), b"cHRM", bt709)
    np.testing.assert_array_equal(read_rgb(stored(tmp_path / "usual.png", usual)), image)
    linear = with_png_chunk(png(image), b"gAMA", struct.pack(">I", 100_000))
    light = image / 255
    expected = np.where(light <= 0.0031308, 12.92 * light, 1.055 * light ** (1 / 2.4) - 0.055) * 255
    assert np.abs(read_rgb(stored(tmp_path / "linear.png", linear)) - expected).max() <= 0.6
    p3 = struct.pack(">8I", 31270, 32900, 68000, 32000, 26500, 69000, 15000, 6000)
    wide = read_rgb(stored(tmp_path / "p3.png", with_png_chunk(png(image), b"cHRM", p3)))
    np.testing.assert_array_equal(wide, conversion_to_srgb(tagged_color_space(12, 13)).apply(image))
    said = with_png_chunk(linear, b"sRGB", b"\0")
    np.testing.assert_array_equal(read_rgb(stored(tmp_path / "said.png", said)), image)


def test_cmyk(tmp_path):
    """Without a profile, red = (1 − cyan)(1 − black)."""
    inks = np.random.default_rng(9).integers(30, 226, (3, 4, 4)).astype(np.uint8)
    path = stored(tmp_path / "a.jpg", jpeg(Image.fromarray(patches(inks), "CMYK")))
    expected = 255 * (1 - inks[..., :3] / 255) * (1 - inks[..., 3:] / 255)
    picture = read_picture(path)
    assert np.abs(patch_values(picture.color) - expected).max() <= 4 and picture.alpha is None
    assert picture.notes == ("images in CMYK converted to sRGB",) and not picture_kind(path).has_alpha
    turned = with_jpeg_segment(path.read_bytes(), 0xE1, b"Exif\0\0" + exif_block(6))
    assert read_rgb(stored(tmp_path / "b.jpg", turned)).shape == (64, 48, 3)


def test_palettes_gray_and_depth(tmp_path):
    image = asymmetric()
    palette = Image.fromarray(image).quantize(8)
    file = io.BytesIO()
    palette.save(file, "PNG")
    np.testing.assert_array_equal(
        read_rgb(stored(tmp_path / "p.png", file.getvalue())), np.array(palette.convert("RGB"))
    )
    np.testing.assert_array_equal(
        read_rgb(stored(tmp_path / "g.png", png(image[..., 0]))), np.repeat(image[..., :1], 3, 2)
    )
    deep = np.array([[0, 128, 129, 32896, 65535 - 129, 65535 - 128]], np.uint16)
    ok, encoded = cv2.imencode(".png", deep)
    assert ok
    path = stored(tmp_path / "d.png", encoded.tobytes())
    assert read_rgb(path)[0, :, 0].tolist() == [0, 0, 1, 128, 254, 255] == read_gray(path)[0].tolist()


def test_transparency(tmp_path):
    image, alpha = asymmetric(), np.arange(48 * 64, dtype=np.uint32).reshape(48, 64) % 256
    rgba = np.dstack((image, alpha.astype(np.uint8)))
    data = with_png_chunk(png(rgba), b"eXIf", exif_block(6))
    picture = read_picture(stored(tmp_path / "a.png", data))
    np.testing.assert_array_equal(picture.color, np.rot90(image, -1))
    np.testing.assert_array_equal(picture.alpha, np.rot90(alpha, -1))
    np.testing.assert_array_equal(read_gray(tmp_path / "a.png"), np.rot90(alpha, -1))
    assert picture_kind(tmp_path / "a.png").has_alpha
    indexed = io.BytesIO()
    Image.fromarray(image).quantize(8).save(indexed, "PNG", transparency=0)
    path = stored(tmp_path / "t.png", indexed.getvalue())
    expected = np.array(Image.open(path).convert("RGBA"))[..., 3]
    assert picture_kind(path).has_alpha and 0 < expected.mean() < 255
    np.testing.assert_array_equal(read_picture(path).alpha, expected)


def test_damaged_files_are_refused(tmp_path):
    whole = with_jpeg_segment(jpeg(Image.fromarray(patches(np.zeros((3, 4, 4), np.uint8)), "CMYK")), 0xE1, b"Exif\0\0")
    for name, data in (
        ("cut.jpg", whole[:400]),
        ("cut.png", png(asymmetric())[:60]),
        ("tiny.png", png(asymmetric())[:20]),
    ):
        with pytest.raises(InputError, match=name.replace(".", r"\.")):
            read_rgb(stored(tmp_path / name, data))
