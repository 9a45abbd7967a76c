"""Pictures are composited, shrunk by area and kept in order."""

from __future__ import annotations

import numpy as np
import torch

from preprocess.refinement.pictures import read_pictures


def frame(row):
    image = np.full((40, 60, 3), 10 * row, np.uint8)
    mask = np.zeros((40, 60), np.uint8)
    mask[:, :30] = 255
    return image, mask


def test_pictures_are_on_white_and_small():
    found = read_pictures([1, 4, 7], frame, 30)
    assert found.rows == (1, 4, 7) and found.full_size == (60, 40) and found.size == (30, 20)
    colors, coverage = found.picture(1)
    assert colors.shape == (20, 30, 3) and coverage.shape == (20, 30, 1)
    torch.testing.assert_close(colors[:, :14], torch.full((20, 14, 3), 40 / 255))
    torch.testing.assert_close(colors[:, 16:], torch.ones(20, 14, 3))
    assert bool((coverage[:, :15] == 1).all()) and bool((coverage[:, 15:] == 0).all())


def test_pictures_are_never_enlarged_and_the_background_can_be_chosen():
    found = read_pictures([0], frame, 500, background=(0.0, 1.0, 0.0))
    assert found.size == (60, 40)
    assert found.colors[0, 0, -1].tolist() == [0, 255, 0]


def test_half_covered_pixels_are_blended_before_they_shrink():
    """A pixel of half coverage over white: 0.5 · 100 + 0.5 · 255."""

    def half(row):
        return np.full((8, 8, 3), 100, np.uint8), np.full((8, 8), 128, np.uint8)

    expected = round(100 * 128 / 255 + 255 * (1 - 128 / 255))
    assert set(np.unique(read_pictures([0], half, 8).colors)) == {expected}
