"""Orbits: the center keeps its pixel, the camera its distance, the signs are as documented."""

from __future__ import annotations

import math

import pytest
import torch

from evaluate.figures.novel_views import PITCHES, YAWS, novel_views, views_at
from evaluate.motion.orbit import head_center, orbit_angles, orbit_camera
from ggavatar.geometry.transforms import invert_rigid, project
from ggavatar.render.reference import rasterize
from tests.support.toy_run import ToyAvatar, camera, head


@pytest.mark.parametrize(("yaw", "pitch"), [(0.7, 0.0), (-0.3, 0.4), (0.0, -1.0), (3.0, 0.2)])
def test_the_center_stays_and_the_distance_too(yaw: float, pitch: float) -> None:
    start, center = camera(), torch.tensor([0.03, -0.02, 0.05])
    moved = orbit_camera(start, center, yaw, pitch)
    before = project(center[None], start.intrinsics, start.world_to_camera)
    torch.testing.assert_close(project(center[None], moved.intrinsics, moved.world_to_camera), before)
    eyes = [invert_rigid(view.world_to_camera)[:3, 3] for view in (start, moved)]
    torch.testing.assert_close(*((eye - center).norm() for eye in eyes))
    rotation = moved.world_to_camera[:3, :3]
    torch.testing.assert_close(rotation @ rotation.T, torch.eye(3), atol=1e-6, rtol=0)


def test_signs_are_as_documented() -> None:
    start, center = camera(), torch.zeros(3)
    rest = invert_rigid(start.world_to_camera)[:3, 3]
    image_right = start.world_to_camera[0, :3]
    image_up = -start.world_to_camera[1, :3]
    right = invert_rigid(orbit_camera(start, center, 0.3, 0.0).world_to_camera)[:3, 3]
    above = invert_rigid(orbit_camera(start, center, 0.0, 0.3).world_to_camera)[:3, 3]
    assert (right - rest) @ image_right > 0.2 and abs((right - rest) @ image_up) < 1e-6
    assert (above - rest) @ image_up > 0.2 and abs((above - rest) @ image_right) < 1e-6


def test_sweep_begins_and_ends_at_the_front() -> None:
    angles = list(orbit_angles(80, 40.0, 20.0))
    assert angles[0] == (0.0, 0.0) and len(angles) == 80
    assert max(yaw for yaw, _ in angles) == pytest.approx(40) and min(pitch for _, pitch in angles) == pytest.approx(
        -20
    )
    steps = [math.dist(one, two) for one, two in zip(angles, [*angles[1:], angles[0]], strict=True)]
    assert max(steps) < 40 * 4 * math.pi / 80 * 1.01, "no jump, not even at the end"


def test_head_center_looks_at_the_skull_only() -> None:
    model = head()
    drive = model.neutral_drive()
    torch.testing.assert_close(head_center(model, drive), torch.tensor([0.0, 0.0, 0.05]))
    model.regions["face"] = torch.tensor([2, 3])  # type: ignore[index]
    torch.testing.assert_close(head_center(model, drive), torch.tensor([0.0, 0.05, 0.05]))


def test_novel_views_show_the_frame_in_the_middle() -> None:
    model = head()
    avatar, drive = ToyAvatar(model), model.neutral_drive()
    pose = (drive, camera(), head_center(model, drive))
    front, side = views_at(avatar, rasterize, pose, [(0.0, 0.0), (40.0, 0.0)], (1.0, 1.0, 1.0))
    with torch.no_grad():
        frame = rasterize(avatar.gaussians(drive), camera(), torch.ones(3)).image
    assert abs(front / 255 - frame.numpy()).max() < 0.01 and (front != side).any()
    figure = novel_views(avatar, rasterize, pose, width=48)
    assert figure.shape[1] > 7 * 48 and len(YAWS) == len(PITCHES) == 7 and YAWS[3] == PITCHES[3] == 0
