"""What the head pose does in each method: the torso it does not turn, and the condition vector it is part of.

References: a torso that stands still before the camera, and the closed form of the bounded pose
(`tests/ggavatar/head/test_head_pose.py`).
"""

from __future__ import annotations

import dataclasses
import math
from typing import Any

import pytest
import torch
from torch import Tensor

from ggavatar.core import Camera, Drive
from ggavatar.data.scene import Scene
from ggavatar.geometry.transforms import axis_angle_to_matrix, rigid
from ggavatar.head.model import HeadModel
from ggavatar.training import registry

ANGLE, SHIFT = 0.4, 0.02
"""Largest turn (rad) and shift (m) of the head in training."""


def pose(share: float) -> Tensor:
    """A head that looks at a camera 1 m away, turned and shifted by a share of the largest."""
    turn = axis_angle_to_matrix(torch.tensor([0.0, share * ANGLE, 0.0]))
    return rigid(torch.diag(torch.tensor([1.0, -1.0, -1.0])) @ turn, torch.tensor([share * SHIFT, 0.0, 1.0]))


def drive_at(head: HeadModel, share: float, frame: int | None = None) -> Drive:
    expression = torch.full((head.expression_basis.shape[2],), 0.1)
    return dataclasses.replace(head.neutral_drive(), expression=expression, head_to_camera=pose(share), frame=frame)


@pytest.fixture
def scene(toy_head: HeadModel) -> Scene:
    """The egg with its lower rows on the root, as a torso, which turned to both sides in training."""
    weights = torch.zeros_like(toy_head.skinning_weights)
    low = toy_head.template[:, 1] < -0.03
    weights[low, 0], weights[~low, 1] = 1.0, 1.0
    head = dataclasses.replace(toy_head, skinning_weights=weights)
    drives = tuple(drive_at(head, share, frame) for frame, share in enumerate((1.0, -1.0)))
    intrinsics = torch.tensor([[120.0, 0, 24], [0, 120.0, 24], [0, 0, 1]])
    cameras = tuple(Camera(intrinsics, drive.head_to_camera, 48, 48) for drive in drives)
    return Scene(head, drives, cameras, torch.ones(3), steps=6_000, max_gaussians=400)


def made(scene: Scene, method: str, **settings: Any) -> Any:
    """An avatar after its neutral phase, if it has one."""
    loaded = registry.load(method)
    avatar = loaded.build(loaded.config("paper", [f"{name}={value}" for name, value in settings.items()]), scene)
    getattr(avatar, "avatar", avatar).steps_done.fill_(2_000)
    return avatar


def seen(avatar: Any, drive: Drive) -> tuple[Tensor, Tensor]:
    """Centers of the Gaussians on the torso and on the head, as the camera sees them, m."""
    with torch.no_grad():
        means = avatar.gaussians(drive).means
    rows = getattr(avatar, "avatar", avatar).rows
    count = len(avatar_head(avatar).faces)
    on_mesh = rows["face"] < count
    weight = avatar_head(avatar).skinning_weights[:, 0][avatar_head(avatar).faces]
    torso, head = (weight == 1).all(1), (weight == 0).all(1)
    face = rows["face"].clamp_max(count - 1)
    placed = means @ drive.head_to_camera[:3, :3].T + drive.head_to_camera[:3, 3]
    return placed[on_mesh & torso[face]], placed[on_mesh & head[face]]


def avatar_head(avatar: Any) -> HeadModel:
    return getattr(avatar, "avatar", avatar).head


ON_THE_NECK = {
    "ggavatar": {"pose_on": "neck"},
    "ggavatar_plus": {"torso": "true"},
    "gaussian_avatars": {"pose_on": "neck", "finetuning": "false"},
    "flash_avatar": {"pose_on": "neck", "first_offsets": "none", "texels": "24"},
    "gaussian_blendshapes": {"pose_on": "neck"},
    "splatting_avatar": {"pose_on": "neck"},
    "ps_avatar": {"pose_on": "neck"},
}
ON_THE_CAMERA = {
    method: {**settings, **({"torso": "false"} if method == "ggavatar_plus" else {"pose_on": "camera"})}
    for method, settings in ON_THE_NECK.items()
}


@pytest.mark.parametrize("method", ON_THE_NECK)
def test_the_torso_does_not_turn_with_the_head(scene: Scene, method: str) -> None:
    """In the camera, a held torso stands where the mean pose has it, while the head turns; else both turn."""
    held, free = made(scene, method, **ON_THE_NECK[method]), made(scene, method, **ON_THE_CAMERA[method])
    turned, straight = drive_at(scene.head, 0.8), drive_at(scene.head, 0.0)
    (torso, head), (torso_at_rest, head_at_rest) = seen(held, turned), seen(held, straight)
    assert len(torso) > 10 and len(head) > 10
    assert torch.allclose(torso, torso_at_rest, atol=1e-5)
    assert (head - head_at_rest).norm(dim=1).mean() > 0.01
    assert (seen(free, turned)[0] - torso_at_rest).norm(dim=1).mean() > 0.01


def test_the_torso_is_held_in_the_neutral_phase_too(scene: Scene) -> None:
    avatar = made(scene, "ggavatar", pose_on="neck")
    avatar.steps_done.fill_(0)
    assert avatar.is_neutral
    torso, torso_at_rest = (seen(avatar, drive_at(scene.head, share))[0] for share in (0.8, 0.0))
    assert torch.allclose(torso, torso_at_rest, atol=1e-5)


WITH_POSE = {
    "ggavatar": {"condition": "face_and_pose"},
    "ggavatar_plus": {"pose_condition": "true"},
    "flash_avatar": {"condition": "face_and_pose", "texels": "24"},
}
WITHOUT_POSE = {
    "ggavatar": {"condition": "face"},
    "ggavatar_plus": {"pose_condition": "false"},
    "flash_avatar": {"condition": "face", "texels": "24"},
}


def conditions(avatar: Any, drive: Drive) -> Tensor:
    """What the method's network receives."""
    inner, found = getattr(avatar, "avatar", avatar), []
    with pytest.MonkeyPatch.context() as patch, torch.no_grad():
        if hasattr(inner, "adjuster"):
            latent = inner.adjuster.latent
            patch.setattr(inner.adjuster, "latent", lambda given: (found.append(given), latent(given))[1])
        else:
            network = inner.network
            patch.setattr(
                network, "forward", lambda x, given: (found.append(given), type(network).forward(network, x, given))[1]
            )
        avatar.gaussians(drive)
    (condition,) = found
    return condition


@pytest.mark.parametrize("method", WITH_POSE)
def test_networks_receive_the_face_and_the_pose_in_its_training_range(scene: Scene, method: str) -> None:
    drive = drive_at(scene.head, 0.5)
    condition = conditions(made(scene, method, **WITH_POSE[method]), drive)
    face = scene.head.condition(drive)
    assert torch.equal(condition[: len(face)], face) and len(condition) == len(face) + 9
    expected = torch.zeros(9)
    expected[0] = 1.0  # the cosine, constant in training, here beyond its range
    expected[2], expected[6] = -math.sin(0.5 * ANGLE) / math.sin(ANGLE), 0.5
    assert torch.allclose(condition[len(face) :], expected, atol=1e-3)
    plain = conditions(made(scene, method, **WITHOUT_POSE[method]), drive)
    assert torch.equal(plain, face)
