"""Drives and cameras from arrays agree with those of a capture, and gradients reach every array (float64)."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import numpy as np
import pytest
import torch

from ggavatar.data.capture import Capture
from ggavatar.data.frames import drives_and_cameras
from ggavatar.geometry.transforms import project
from ggavatar.head.head_pose import HeadPoses
from preprocess.refinement.drawing import Leaves, camera_of, drive_of
from tests.support.synthetic_clip import as_tracking, still_camera


@pytest.mark.parametrize("moved_by_joints", [False, True])
def test_they_are_those_of_a_capture(ball, ball_tracking, moved_by_joints):
    tracking = as_tracking(still_camera(6, (96, 96), 300.0)) if moved_by_joints else ball_tracking
    capture = Capture(Path("."), "ball", 96, 96, 25.0, tuple(range(6)), {}, tracking.rows(slice(6)), ball.version)
    drives, cameras = drives_and_cameras(capture, ball, "cpu")
    for row in range(6):
        leaves = Leaves.of(tracking, row, wanted=False)
        drive, camera = drive_of(ball, tracking, row, leaves), camera_of(tracking, row, leaves, (96, 96), (48, 48))
        assert not drive.requires_grad
        for name in ("expression", "joint_rotations", "eyelids", "translation", "head_to_camera"):
            torch.testing.assert_close(getattr(drive, name), getattr(drives[row], name))
        torch.testing.assert_close(camera.intrinsics, cameras[row].resized(48, 48).intrinsics)


def test_gradients_against_differences_in_float64(ball, ball_tracking):
    """Projected vertices of a held torso, by every array that refinement changes."""
    tracking = dataclasses.replace(ball_tracking, torso_to_camera=ball_tracking.world_to_camera.copy())
    head = ball.to("cpu", torch.float64)
    weights = torch.rand(len(head.template), 2, generator=torch.Generator().manual_seed(0), dtype=torch.float64)
    row = 3
    still = Leaves.of(tracking, row, wanted=False, dtype=torch.float64)
    poses = HeadPoses.of(head, [dataclasses.replace(head.neutral_drive(), head_to_camera=torch.eye(4).double())])

    def cost(values):
        leaves = Leaves(values)
        drive = drive_of(head, tracking, row, leaves)
        vertices = poses.hold_torso(head.vertices(drive), drive, head)
        camera = camera_of(tracking, row, leaves, (96, 96), (96, 96))
        return (project(vertices, camera.intrinsics, camera.world_to_camera) * weights).sum()

    assert drive_of(head, tracking, row, Leaves.of(tracking, row, True, torch.float64)).requires_grad
    names = list(still.values)
    assert set(names) == {"world_to_camera", "expression", "joint_rotations", "eyelids", "torso_to_camera"}
    inputs = tuple(still.values[name].clone().requires_grad_() for name in names)
    assert torch.autograd.gradcheck(lambda *values: cost(dict(zip(names, values, strict=True))), inputs, atol=1e-4)


def test_gradients_are_zero_where_none_arrived(ball_tracking):
    leaves = Leaves.of(ball_tracking, 0, wanted=True)
    leaves.values["expression"].sum().backward()
    found = leaves.gradients()
    np.testing.assert_array_equal(found["expression"], np.ones(4))
    np.testing.assert_array_equal(found["eyelids"], np.zeros(2))
