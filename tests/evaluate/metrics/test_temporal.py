"""Temporal metrics against closed forms on tiny clips."""

from __future__ import annotations

import numpy as np
import pytest

from evaluate.metrics.temporal import flicker, frame_difference_error, landmark_jitter
from tests.support.image_pairs import pair


def test_a_constant_error_does_not_count_and_a_change_does() -> None:
    first, _ = pair(20, 30, 0)
    second, _ = pair(20, 30, 3)
    first, second = np.clip(first, 0, 240), np.clip(second, 0, 240)
    offset = [image + np.uint8(10) for image in (first, second)]
    assert frame_difference_error((offset[0], first), (offset[1], second)) == 0
    assert frame_difference_error((offset[0], first), (second, second)) == pytest.approx(10 / 255)
    frozen = frame_difference_error((first, first), (first, second))
    assert frozen == pytest.approx(np.abs(first.astype(float) - second).mean() / 255)


def test_flicker_counts_static_pixels_inside_the_mask_only() -> None:
    truth = np.full((4, 6, 3), 100, np.uint8)
    moved = truth.copy()
    moved[:, :2] += np.uint8(50)
    moved[:, 2] += np.uint8(2)
    render, jumped = truth.copy(), truth.copy()
    jumped[:, :2] = 0
    jumped[:, 4] += np.uint8(6)
    now = (jumped, moved)
    assert flicker((render, truth), now) == pytest.approx(6 / 255 / 4)
    mask = np.zeros((4, 6), np.uint8)
    mask[:, 4] = 1
    assert flicker((render, truth), now, mask) == pytest.approx(6 / 255)
    mask[:] = 0
    mask[:, 0] = 1
    assert flicker((render, truth), now, mask) is None
    assert flicker((render, truth), (render, truth)) == 0


def test_jitter_ignores_offsets_and_even_drift_and_needs_three_frames() -> None:
    drifting = [np.full((5, 2), 3 + 0.5 * time) for time in range(3)]
    assert landmark_jitter(drifting) == pytest.approx(0, abs=1e-12)
    shaking = [np.array([[1.0, 0.0], [0.0, 3.0]]) * (-1) ** time for time in range(3)]
    assert landmark_jitter(shaking) == pytest.approx((4 * 1 + 4 * 3) / 2)
    assert landmark_jitter([shaking[0], None, shaking[2]]) is None
