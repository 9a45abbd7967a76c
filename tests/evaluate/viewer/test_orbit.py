"""From a browser's camera to ours. Reference: `evaluate.motion.orbit.orbit_camera`, and closed forms."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
import torch
from scipy.spatial.transform import Rotation

from evaluate.motion.orbit import orbit_camera
from evaluate.viewer.orbit import FLIP, Bounds, Place, added_view, bounded, filling, moved_camera, resting_place
from ggavatar.core import Camera

PIVOT = np.array([0.03, -0.05, 0.9])
CENTER = torch.tensor([0.1, 0.2, -0.1], dtype=torch.float64)


def camera() -> Camera:
    view = torch.eye(4, dtype=torch.float64)
    view[:3, :3] = torch.from_numpy(Rotation.from_rotvec([3.0, 0.2, 0.1]).as_matrix())
    view[:3, 3] = torch.from_numpy(PIVOT) - view[:3, :3] @ CENTER
    return Camera(torch.tensor([[90.0, 0, 33], [0, 90, 31], [0, 0, 1]], dtype=torch.float64), view, 64, 64)


def orbiting(yaw: float, pitch: float, distance: float) -> Place:
    """The place of a browser that has orbited: its camera looks at the origin, with +y up."""
    turn = Rotation.from_rotvec([pitch, 0, 0]) * Rotation.from_rotvec([0, yaw, 0])
    to_camera = turn.as_matrix() @ FLIP
    position = -to_camera.T @ [0, 0, distance]
    x, y, z, w = Rotation.from_matrix(to_camera.T).as_quat()
    return Place(640, 480, (w, x, y, z), tuple(position.tolist()))


def test_at_rest_nothing_is_added() -> None:
    np.testing.assert_allclose(added_view(resting_place(PIVOT, 640, 480), PIVOT), np.eye(4), atol=1e-12)


@pytest.mark.parametrize(("yaw", "pitch"), [(0.4, 0.0), (0.0, -0.3), (-0.7, 0.25)])
def test_orbits_are_those_of_our_renders(yaw: float, pitch: float) -> None:
    expected = orbit_camera(camera(), CENTER, yaw, pitch)
    found = moved_camera(camera(), added_view(orbiting(yaw, pitch, float(PIVOT[2])), PIVOT))
    torch.testing.assert_close(found.world_to_camera, expected.world_to_camera, atol=1e-9, rtol=0)


def test_coming_nearer_keeps_the_pivot_where_it_is_seen() -> None:
    added = added_view(orbiting(0.0, 0.0, 0.45), PIVOT)
    np.testing.assert_allclose(added @ [*PIVOT, 1], [0.03, -0.05, 0.45, 1], atol=1e-12)


def test_views_stop_at_what_training_saw() -> None:
    bounds = Bounds((-0.2, 0.5), (-0.1, 0.1))
    found = added_view(orbiting(0.9, -0.4, float(PIVOT[2])), PIVOT, bounds)
    expected = added_view(orbiting(0.5, -0.1, float(PIVOT[2])), PIVOT)
    np.testing.assert_allclose(found, expected, atol=1e-9)
    inside = (Rotation.from_rotvec([0.05, 0, 0]) * Rotation.from_rotvec([0, 0.3, 0])).as_matrix()
    np.testing.assert_allclose(bounded(inside, bounds), inside, atol=1e-12)


@pytest.mark.parametrize("size", [(128, 64), (64, 128), (32, 32), (200, 64)])
def test_other_sizes_show_all_that_the_camera_sees(size: tuple[int, int]) -> None:
    seen = filling(camera(), *size)
    assert (seen.width, seen.height) == size
    corners = torch.tensor([[0.0, 0, 1], [64, 0, 1], [0, 64, 1], [64, 64, 1]], dtype=torch.float64).T
    pixels = (seen.intrinsics @ torch.linalg.inv(camera().intrinsics) @ corners)[:2]
    low, high = pixels.amin(1).numpy(), pixels.amax(1).numpy()
    np.testing.assert_allclose(low + high, size, atol=1e-9)  # in the middle
    np.testing.assert_allclose(high - low, min(size), atol=1e-9)  # as large as possible
    assert torch.equal(seen.world_to_camera, camera().world_to_camera)
    assert torch.equal(dataclasses.replace(camera()).intrinsics, camera().intrinsics)
