"""Images that are not 8-bit RGB are converted with a note, or refused."""

from __future__ import annotations

import hashlib
import zlib
from pathlib import Path

import cv2
import numpy as np
import pytest

from evaluate.protocols.protocol import protocol_by_name
from evaluate.scoring.frame_pairs import FramePair, require_equal_sizes
from evaluate.scoring.image_decoding import read_scored, read_weights
from evaluate.scoring.score import score_pair
from ggavatar.errors import InputError
from ggavatar.pictures.color import conversion_to_srgb, tagged_color_space
from tests.support.image_pairs import pair, write
from tests.support.pictures import display_p3_profile, exif_block, with_png_chunk


def test_8_bit_rgb_is_read_as_it_is(tmp_path: Path) -> None:
    truth, _ = pair()
    write(tmp_path / "a.png", truth)
    found = read_scored(tmp_path / "a.png", None)
    np.testing.assert_array_equal(found.pixels, truth)
    assert found.notes == ()
    assert found.sha256 == hashlib.sha256((tmp_path / "a.png").read_bytes()).hexdigest()


def test_16_bits_are_rounded_to_the_nearest_of_256_levels(tmp_path: Path) -> None:
    truth, _ = pair()
    deep = truth.astype(np.uint16) * 257
    deep[0, 0] = (128, 129, 65535 - 100)
    write(tmp_path / "a.png", deep)
    found = read_scored(tmp_path / "a.png", None)
    assert found.pixels[0, 0].tolist() == [0, 1, 255]
    np.testing.assert_array_equal(found.pixels[1:], truth[1:])
    assert found.notes == ("16-bit images rounded to 8 bits",)


def test_gray_is_repeated(tmp_path: Path) -> None:
    write(tmp_path / "a.png", pair()[0][..., 0])
    found = read_scored(tmp_path / "a.png", None)
    np.testing.assert_array_equal(found.pixels, np.repeat(pair()[0][..., :1], 3, axis=2))
    assert found.notes == ("grayscale images repeated to RGB",)


@pytest.mark.parametrize(("dtype", "top"), [(np.uint8, 255), (np.uint16, 65535)])
def test_straight_alpha_is_composited_on_the_protocols_background(tmp_path: Path, dtype: type, top: int) -> None:
    image = np.zeros((4, 4, 4), dtype)
    image[..., 0] = top
    image[..., 3] = [0, top // 5, top, top]
    write(tmp_path / "a.png", image)
    found = read_scored(tmp_path / "a.png", (0.0, 1.0, 1.0)).pixels
    assert found[0].tolist() == [[0, 255, 255], [51, 204, 204], [255, 0, 0], [255, 0, 0]]
    with pytest.raises(InputError, match="--background"):
        read_scored(tmp_path / "a.png", None)


def test_an_opaque_alpha_channel_is_dropped_silently(tmp_path: Path) -> None:
    truth, _ = pair()
    write(tmp_path / "a.png", np.dstack((truth, np.full(truth.shape[:2], 255, np.uint8))))
    found = read_scored(tmp_path / "a.png", None)
    np.testing.assert_array_equal(found.pixels, truth)
    assert found.notes == ()


def test_damaged_empty_and_absent_files_are_refused(tmp_path: Path) -> None:
    write(tmp_path / "a.png", pair()[0])
    content = (tmp_path / "a.png").read_bytes()
    (tmp_path / "empty.png").write_bytes(b"")
    (tmp_path / "text.png").write_text("hello")
    (tmp_path / "headless.png").write_bytes(content[:20])
    for name in ("empty", "text", "headless", "absent"):
        with pytest.raises(InputError, match=f"{name}.png"):
            read_scored(tmp_path / f"{name}.png", None)


def test_weights_are_the_alpha_channel_or_the_gray_value(tmp_path: Path) -> None:
    gray = np.array([[0, 51], [255, 102]], np.uint8)
    write(tmp_path / "gray.png", gray)
    write(tmp_path / "alpha.png", np.dstack((np.zeros((2, 2, 3), np.uint8), gray)))
    write(tmp_path / "rgb.png", cv2.cvtColor(gray, cv2.COLOR_GRAY2RGB))
    write(tmp_path / "deep.png", gray.astype(np.uint16) * 257)
    for name in ("gray", "alpha", "rgb", "deep"):
        weights, sha256 = read_weights(tmp_path / f"{name}.png")
        np.testing.assert_allclose(weights, [[0, 0.2], [1, 0.4]], atol=1e-6)
        assert len(sha256) == 64


@pytest.mark.parametrize("value", range(1, 9))
def test_a_turned_ground_truth_scores_as_the_upright_one(tmp_path: Path, value: int) -> None:
    """The same pixels, stored as EXIF allows: ground truth, prediction and mask. Reference: stored upright."""
    truth, prediction = (image[:48, :64] for image in pair())
    mask = np.zeros(truth.shape[:2], np.uint8)
    mask[10:30, 5:50] = 255
    protocol = protocol_by_name("paper-v1")
    scores = []
    for name, kind in (("upright", 1), ("turned", value)):
        files = {}
        for role, image in (("truth", truth), ("prediction", prediction), ("mask", mask)):
            files[role] = tmp_path / f"{name}_{role}.png"
            write(files[role], stored_turned(image, kind))
            files[role].write_bytes(with_png_chunk(files[role].read_bytes(), b"eXIf", exif_block(kind)))
        one = FramePair(0, files["prediction"], files["truth"], {"foreground": files["mask"]})
        require_equal_sizes(one)
        scores.append(score_pair(one, protocol))
    assert scores[0].values == scores[1].values and scores[0].values["psnr"] < 60
    assert scores[0].notes == () and (scores[1].notes == ()) == (value == 1)
    np.testing.assert_array_equal(scores[1].foreground, mask // 255)


def stored_turned(upright: np.ndarray, kind: int) -> np.ndarray:
    """What must be stored so that EXIF's value `kind` shows `upright` (CIPA DC-008: where row 0 and column 0 lie)."""
    stored = {
        1: upright,
        2: upright[:, ::-1],
        3: upright[::-1, ::-1],
        4: upright[::-1],
        5: upright.swapaxes(0, 1),
        6: np.rot90(upright),
        7: upright[::-1, ::-1].swapaxes(0, 1),
        8: np.rot90(upright, -1),
    }[kind]
    return np.ascontiguousarray(stored)


def test_display_p3_is_scored_in_srgb(tmp_path: Path) -> None:
    truth, _ = pair()
    write(tmp_path / "a.png", truth)
    profile = b"p3\0\0" + zlib.compress(display_p3_profile())
    (tmp_path / "a.png").write_bytes(with_png_chunk((tmp_path / "a.png").read_bytes(), b"iCCP", profile))
    found = read_scored(tmp_path / "a.png", None)
    expected = conversion_to_srgb(tagged_color_space(12, 13))
    assert expected is not None
    assert np.abs(found.pixels.astype(int) - expected.apply(truth)).max() <= 2
    assert "Display P3" in found.notes[0]
