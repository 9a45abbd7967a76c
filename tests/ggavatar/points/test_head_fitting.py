"""Initialization from the head model: initial points, and fitted networks before the first step."""

from __future__ import annotations

import pytest
import torch

from ggavatar.data.capture import Capture
from ggavatar.data.frames import drives_and_cameras
from ggavatar.data.scene import Scene
from ggavatar.head.model import HeadModel
from ggavatar.methods.point_avatar import UNITS_PER_METER, Config, PointAvatar, build
from ggavatar.points.skinning import deform, deformed_normals


def avatar_of(capture: Capture, head: HeadModel, **settings: object) -> PointAvatar:
    drives, cameras = drives_and_cameras(capture, head, "cpu")
    scene = Scene(head, tuple(drives), tuple(cameras), torch.ones(3), steps=620)
    return build(Config(perceptual_weight=0.0, **settings), scene)  # type: ignore[arg-type]


@pytest.fixture
def avatar(toy_capture: Capture, toy_head: HeadModel) -> PointAvatar:
    sizes = {"surface_width": 96, "surface_layers": 5, "normals": "joints"}
    return avatar_of(toy_capture, toy_head, begin="head", fitting_steps=60, **sizes)


def test_points_begin_on_the_mesh(avatar: PointAvatar) -> None:
    vertices = UNITS_PER_METER * avatar.head.vertices(avatar.canonical)
    corners = vertices[avatar.head.faces]
    normals = torch.linalg.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    normals = normals / normals.norm(dim=1, keepdim=True)
    apart = ((avatar.cloud.points[:, None] - corners[:, 0]) * normals).sum(-1).abs().amin(1)
    assert len(avatar.cloud.points) == 400 and apart.max() < 1e-5
    assert avatar.cloud.points.std(0).min() > 0.3 * vertices.std(0).min(), "all over it"


def test_networks_know_the_head_before_the_first_step(avatar: PointAvatar) -> None:
    points = avatar.cloud.points.detach()

    @torch.no_grad()
    def misses() -> tuple[float, float, float]:
        bases = avatar.deformer.bases(points)
        terms = avatar.targets.losses(bases, points)
        return (
            float(terms["skinning"]),
            float(terms["expressions"]),
            float(avatar.surface(points).distance.abs().mean()),
        )

    before = misses()
    avatar.train()
    assert all(after < 0.6 * old for after, old in zip(misses(), before, strict=True))


def test_what_has_begun_is_not_fitted_again(avatar: PointAvatar) -> None:
    avatar.train()
    known = {name: value.clone() for name, value in avatar.named_parameters()}
    avatar.steps_done.fill_(1)
    avatar.eval()
    avatar.train()
    assert all(torch.equal(value, known[name]) for name, value in avatar.named_parameters())


def test_normals_that_turn_with_the_joints(avatar: PointAvatar) -> None:
    """Without derivatives points land where they do with them, and normals see the blended transforms alone."""
    avatar.train()
    drive = avatar.scene.drives[5]
    points, pose = avatar.cloud.points.detach(), avatar.driver.posed_skeleton(drive)
    alone = avatar.deformer.deformation(avatar.deformer.features_without_tangents(points), pose.correctives)
    whole = avatar.deformer.deformation(avatar.deformer.features(points), pose.correctives)
    found, wanted = (deform(points, motion, pose.canonical, pose.posed) for motion in (alone, whole))
    assert torch.allclose(found.points, wanted.points, atol=1e-5)
    to, back = (torch.einsum("nj,jab->nab", alone.weights, bones.rotations) for bones in (pose.posed, pose.canonical))
    normals = torch.nn.functional.normalize(points, dim=1)
    by_hand = torch.linalg.inv(to @ torch.linalg.inv(back)).transpose(1, 2) @ normals[..., None]
    turned = torch.nn.functional.normalize(by_hand[..., 0], dim=1)
    assert torch.allclose(deformed_normals(found.tangents, normals), turned, atol=1e-4)


def test_the_authors_start_is_the_default(toy_capture: Capture, toy_head: HeadModel) -> None:
    plain = avatar_of(toy_capture, toy_head)
    assert torch.allclose(plain.cloud.points.norm(dim=1), torch.tensor(0.5))
    config = plain.config
    assert (config.surface_width, config.surface_layers, config.surface_octaves) == (256, 9, 6)
    assert (config.begin, config.fitting_steps, config.normals) == ("sphere", 0, "jacobian")
