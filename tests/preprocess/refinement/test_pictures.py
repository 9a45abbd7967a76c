"""Pictures are composited, shrunk by area and kept in order."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
import torch

from preprocess.refinement.pictures import face_points, read_pictures
from preprocess.tracking.geometry.projection import posed_vertices, project


def frame(row):
    image = np.full((40, 60, 3), 10 * row, np.uint8)
    mask = np.zeros((40, 60), np.uint8)
    mask[:, :30] = 255
    return image, mask


def corners(row):
    """A face in the left upper quarter."""
    return np.array([[0.0, 0.0], [20.0, 0.0], [0.0, 20.0], [20.0, 20.0], [10.0, 10.0]])


def test_pictures_are_on_white_and_small():
    found = read_pictures([1, 4, 7], frame, 30, corners)
    assert found.rows == (1, 4, 7) and found.full_size == (60, 40) and found.size == (30, 20)
    colors, coverage, weights = found.picture(1)
    assert colors.shape == (20, 30, 3) and coverage.shape == (20, 30, 1)
    torch.testing.assert_close(colors[:, :14], torch.full((20, 14, 3), 40 / 255))
    torch.testing.assert_close(colors[:, 16:], torch.ones(20, 14, 3))
    assert weights[3, 3] == 1 and weights[15, 3] == 1 and weights[3, 25] == pytest.approx(0.2)
    assert found.face[1].mean() == pytest.approx(1 / 6, abs=0.05)
    assert bool((coverage[:, :15] == 1).all()) and bool((coverage[:, 15:] == 0).all())


def test_pictures_are_never_enlarged_and_the_background_can_be_chosen():
    found = read_pictures([0], frame, 500, corners, background=(0.0, 1.0, 0.0))
    assert found.size == (60, 40)
    assert found.colors[0, 0, -1].tolist() == [0, 255, 0]


def test_half_covered_pixels_are_blended_before_they_shrink():
    """A pixel of half coverage over white: 0.5 · 100 + 0.5 · 255."""

    def half(row):
        return np.full((8, 8, 3), 100, np.uint8), np.full((8, 8), 128, np.uint8)

    expected = round(100 * 128 / 255 + 255 * (1 - 128 / 255))
    assert set(np.unique(read_pictures([0], half, 8, corners).colors)) == {expected}


def test_points_of_the_face_are_in_front_of_the_head_and_never_the_torso(ball, ball_tracking):
    """Projected vertices of the ball within 7 cm of its nose; a torso in front of them does not count."""
    front = (ball.template[:, 2] > ball.template[:, 2].max() - 0.07).numpy()
    vertices = posed_vertices(ball, ball_tracking, 3)[front]
    seen, _ = project(vertices, ball_tracking.intrinsics[3], ball_tracking.world_to_camera[3])
    np.testing.assert_allclose(face_points(ball, ball_tracking, 3), seen)
    weights = ball.skinning_weights.clone()
    nose = int(ball.template[:, 2].argmax())
    weights[nose] = torch.tensor([1.0, 0, 0, 0, 0])
    chest = dataclasses.replace(ball, skinning_weights=weights)
    assert len(face_points(chest, ball_tracking, 3)) > len(seen)  # the nose is torso: counted from the next vertex on
