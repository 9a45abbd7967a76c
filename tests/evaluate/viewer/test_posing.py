"""What sliders do to a drive. Reference: the web page's own modules, run by node, and the head at rest."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import numpy as np
import pytest
import torch

from evaluate.viewer.posing import Controls, Turn, value_of, with_value
from ggavatar.formats.web.controls import Slider
from ggavatar.head.arkit_map import Target
from ggavatar.head.procedural.model import procedural_head
from tests.support.page_modules import run_modules
from tests.support.toy_run import camera, head
from tests.support.untrained_avatars import random_drives, with_everything


@pytest.mark.parametrize("root_still", [True, False])
def test_heads_turn_as_on_the_web_page(tmp_path: Path, root_still: bool) -> None:
    model = with_everything(head())
    drives = random_drives(model, 4, root_still)
    controls = Controls.of(model, drives, camera())
    assert controls.poses.in_camera == root_still
    seen = dataclasses.replace(camera(), world_to_camera=drives[1].head_to_camera)
    turn = Turn(0.3, -0.2, 0.1)
    drive, moved = controls.turned(drives[1], seen, turn)
    neck = (model.joint_regressor @ model.template)[model.joint_index("neck")]
    script = """
    const { drive, description, neck, pose } = values;
    return turnedHead(drive, pose, description, neck);
    """
    given = {
        "drive": {
            "joint_rotations": drives[1].joint_rotations.flatten().tolist(),
            "head_to_camera": drives[1].head_to_camera[:3].flatten().tolist(),
            "world_to_camera": seen.world_to_camera[:3].flatten().tolist(),
        },
        "description": {"head": {"joint_names": list(model.joint_names)}, "moves_camera": root_still},
        "neck": neck.tolist(),
        "pose": dataclasses.asdict(turn),
    }
    page = run_modules(script, "drives", "algebra", folder=tmp_path, values=given)
    np.testing.assert_allclose(drive.head_to_camera[:3].flatten(), page["head_to_camera"], atol=1e-5)
    np.testing.assert_allclose(drive.joint_rotations.flatten(), page["joint_rotations"], atol=1e-5)
    np.testing.assert_allclose(moved.world_to_camera[:3].flatten(), page["world_to_camera"], atol=1e-5)


def test_no_turn_changes_nothing() -> None:
    controls = Controls.of(head(), [], camera())
    drive, seen = controls.turned(controls.rest, controls.camera, Turn())
    assert drive is controls.rest and seen is controls.camera


def test_sliders_move_all_their_numbers_and_show_the_first() -> None:
    drive = dataclasses.replace(head().neutral_drive(), frame=5)
    slider = Slider("Face", "both", "", -1.0, 1.0, (Target("joint_rotations", 7, 2.0), Target("eyelids", 1, -1.0)))
    moved = with_value(drive, slider, 0.25)
    assert moved.joint_rotations[2, 1] == 0.5 and moved.eyelids.tolist() == [0.0, -0.25]
    assert moved.frame is None and value_of(moved, slider) == 0.25
    assert not drive.joint_rotations.any() and drive.frame == 5  # the one before is as it was


def test_names_and_limits_are_those_of_the_head() -> None:
    controls = Controls.of(procedural_head(), [], camera())
    labels = [slider.label for slider in controls.sliders]
    assert {"jaw open", "gaze sideways", "left lid", "right lid"} <= set(labels)
    assert len(labels) == len(set(labels)) == 6 + procedural_head().expression_basis.shape[2]
    low, high = controls.turns()["yaw"]
    assert (low, high) == (-controls.bounds.yaw[1], -controls.bounds.yaw[0])


def test_the_view_turns_about_the_middle_of_the_head() -> None:
    controls = Controls.of(head(), [], camera())
    middle = (head().template.amin(0) + head().template.amax(0)) / 2
    view = controls.rest.head_to_camera
    np.testing.assert_allclose(controls.pivot, (view[:3, :3] @ middle + view[:3, 3]).numpy(), atol=1e-6)
    torch.testing.assert_close(controls.camera.world_to_camera, view)
