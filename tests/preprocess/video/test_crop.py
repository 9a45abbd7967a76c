"""Crops. Reference: points projected before and after, and images of gradients whose value tells the place."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from ggavatar.errors import InputError
from preprocess.video.crop import Crop, crop_from_json, explicit_crop, square_crop, square_crop_around, whole_frame


def place_image(width, height):
    """Red tells x − 0.5, green y − 0.5, in half px."""
    rows, columns = np.mgrid[:height, :width]
    return np.stack((2 * columns, 2 * rows, 0 * rows), axis=-1).astype(np.uint8)


crops = st.builds(
    lambda x, y, side, out: Crop(x, y, side, side, out, out),
    st.integers(-20, 60),
    st.integers(-20, 40),
    st.integers(40, 90),
    st.integers(16, 120),
)


@given(crops)
def test_intrinsics_follow_the_pixels(crop):
    """What a pixel of the capture shows lies where the new intrinsics say."""
    source = np.array([[120.0, 0, 64], [0, 130, 48], [0, 0, 1]])
    image = crop.image(place_image(128, 96))
    assert image.shape == (crop.out_height, crop.out_width, 3)
    inner = np.s_[4:-4, 4:-4]
    shown = image[inner] / 2 + 0.5
    rows, columns = (axis[inner] + 0.5 for axis in np.mgrid[: crop.out_height, : crop.out_width])
    changed = crop.intrinsics(source)
    rays = np.stack(((columns - changed[0, 2]) / changed[0, 0], (rows - changed[1, 2]) / changed[1, 1]), axis=-1)
    expected = rays * [120, 130] + [64, 48]
    known = ((expected > 9) & (expected < [119, 87])).all(axis=-1)
    error = (shown[..., :2] - expected)[known]
    assert np.abs(error).max(initial=0) < 1.1
    assert len(error) < 50 or np.abs(error.mean(axis=0)).max() < 0.3


def test_outside_is_black():
    image = Crop(-10, -10, 30, 30, 30, 30).image(np.full((40, 40, 3), 200, np.uint8))
    assert not image[:10].any() and not image[:, :10].any() and (image[10:, 10:] == 200).all()
    assert Crop(-10, 0, 20, 20, 20, 20).image(np.full((40, 40), 255, np.uint8))[0, 0] == 0


def test_uncropped_is_untouched():
    image = np.random.default_rng(0).integers(0, 255, (48, 48, 3), dtype=np.uint8)
    np.testing.assert_array_equal(whole_frame(48, 48, 48).image(image), image)
    assert whole_frame(200, 100, 50) == Crop(0, 0, 200, 100, 50, 25)
    assert crop_from_json(whole_frame(200, 100, 50).json()) == whole_frame(200, 100, 50)


@given(st.tuples(st.floats(-50, 250), st.floats(-50, 150)), st.floats(10, 400))
def test_squares_stay_inside(center, side):
    crop = square_crop(center, side, 200, 100, 64)
    assert 0 <= crop.x <= crop.x + crop.width <= 200 and 0 <= crop.y <= crop.y + crop.height <= 100
    assert crop.width == crop.height == min(round(side), 100)


def test_square_crop_around_keeps_heads():
    generator = np.random.default_rng(0)
    centers = generator.uniform([500, 400], [560, 440], (100, 2))
    boxes = np.concatenate((centers - 60, centers + 60), axis=1)
    crop = square_crop_around(boxes, 1080, 1920, 512)
    assert crop.width == crop.height and crop.x < boxes[:, 0].min() and crop.x + crop.width > boxes[:, 2].max()
    assert crop.y < boxes[:, 1].min() and crop.y + crop.height > boxes[:, 3].max() + 40


@pytest.mark.parametrize(
    "text", ["", "1,2,3", "a,b,c,d", "0,0,8,8", "5000,0,100,100", "0,0,99999,100", "-300,0,200,200"]
)
def test_senseless_crops(text):
    with pytest.raises(InputError, match="--crop"):
        explicit_crop(text, 1000, 800, 512)


def test_explicit_crop():
    assert explicit_crop("-10,20,400,200", 1000, 800, 512) == Crop(-10, 20, 400, 200, 512, 256)
