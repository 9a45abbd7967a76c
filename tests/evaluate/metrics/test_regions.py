"""Regions: a band of known area, hulls, and meshes whose hidden parts do not show."""

from __future__ import annotations

import numpy as np
import pytest

from evaluate.metrics.regions import boundary_band, fill_outside, hair_region, mesh_regions


def test_the_band_of_a_half_plane_is_two_radii_wide() -> None:
    mask = np.zeros((100, 120), np.float32)
    mask[:, 60:] = 1
    band = boundary_band(mask)
    assert band[:, 58:62].all()
    assert band.sum() == 100 * 4
    assert set(np.unique(band)) == {0.0, 1.0}


@pytest.mark.parametrize("value", [0.0, 1.0])
def test_a_mask_without_outline_has_no_band(value: float) -> None:
    assert boundary_band(np.full((50, 50), value, np.float32)).sum() == 0


def test_painting_outside_changes_only_the_outside() -> None:
    image = np.full((4, 4, 3), 7, np.uint8)
    inside = np.zeros((4, 4), np.float32)
    inside[1:3, 1:3] = 0.5
    painted = fill_outside(image, inside, (1.0, 0.0, 0.2))
    assert (painted[1:3, 1:3] == 7).all()
    assert painted[0, 0].tolist() == [255, 0, 51]
    assert (image == 7).all()


def squares() -> tuple[np.ndarray, np.ndarray]:
    """Two squares of two triangles each: vertices 0–3 on the left, 4–7 shifted right by 10 px."""
    square = np.array([[10.0, 10.0], [30.0, 10.0], [30.0, 30.0], [10.0, 30.0]])
    points = np.concatenate((square, square + np.array([10.0, 0.0])))
    faces = np.array([[0, 1, 2], [0, 2, 3], [4, 5, 6], [4, 6, 7]])
    return points, faces


def test_nearer_triangles_hide_those_behind() -> None:
    points, faces = squares()
    sets = {"face": np.arange(4), "scalp": np.arange(4, 8)}
    near_face = mesh_regions(points, np.array([1.0] * 4 + [2.0] * 4), faces, sets, (64, 48))
    assert near_face["face"][20, 25] == 255
    assert near_face["scalp"][20, 25] == 0
    assert near_face["scalp"][20, 35] == 255
    near_scalp = mesh_regions(points, np.array([2.0] * 4 + [1.0] * 4), faces, sets, (64, 48))
    assert near_scalp["face"][20, 25] == 0
    assert near_scalp["scalp"][20, 25] == 255


def test_sets_of_one_region_are_joined_and_absent_ones_left_out() -> None:
    points, faces = squares()
    sets = {"lips": np.arange(4), "mouth": np.arange(4, 8)}
    masks = mesh_regions(points, np.ones(8), faces, sets, (64, 48))
    assert set(masks) == {"mouth", "face"}
    assert masks["mouth"][20, 15] == masks["mouth"][20, 35] == 255
    np.testing.assert_array_equal(masks["face"], masks["mouth"])


def test_triangles_behind_the_camera_are_not_drawn() -> None:
    points, faces = squares()
    masks = mesh_regions(points, np.array([1.0] * 4 + [-1.0] * 4), faces, {"face": np.arange(8)}, (64, 48))
    assert masks["face"][20, 15] == 255
    assert masks["face"][20, 35] == 0


def test_hair_is_the_top_of_the_person_without_the_face() -> None:
    person = np.full((40, 40), 200, np.uint8)
    scalp, face = np.zeros((2, 40, 40), np.uint8)
    scalp[5:20, 10:30] = 255
    face[12:35, 12:28] = 255
    hair = hair_region(person, scalp, face)
    assert hair[6, 2] == 200
    assert hair[15, 20] == 0
    assert not hair[20:].any()
    assert not hair_region(person, np.zeros_like(scalp), face)[0:].any()
