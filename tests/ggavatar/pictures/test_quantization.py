"""Computed images as 8 bits, against the definition: every level comes back, halves go to the nearest."""

from __future__ import annotations

import numpy as np

from ggavatar.pictures.quantization import to_8_bit


def test_every_level_comes_back_and_what_is_between_goes_to_the_nearest() -> None:
    levels = np.arange(256)
    np.testing.assert_array_equal(to_8_bit(levels.astype(np.float32) / 255), levels)
    np.testing.assert_array_equal(to_8_bit((levels[:-1] + 0.49) / 255), levels[:-1])
    np.testing.assert_array_equal(to_8_bit((levels[:-1] + 0.51) / 255), levels[1:])


def test_values_beyond_the_range_are_clamped() -> None:
    found = to_8_bit(np.array([-0.2, 1.7, np.inf]))
    assert found.dtype == np.uint8 and found.tolist() == [0, 255, 255]
