"""What ggavatar_plus adds: region and coverage terms by hand, color rows that start as nothing."""

from __future__ import annotations

import dataclasses

import pytest
import torch

from ggavatar.core import Frame, Rendering
from ggavatar.data.capture import Capture
from ggavatar.data.frames import drives_and_cameras
from ggavatar.data.scene import Scene
from ggavatar.head.model import HeadModel
from ggavatar.methods.ggavatar_plus import Config, GGAvatarPlus, build, regions_l1


@pytest.fixture
def avatar(toy_capture: Capture, toy_head: HeadModel) -> GGAvatarPlus:
    drives, cameras = drives_and_cameras(toy_capture, toy_head, "cpu")
    scene = Scene(toy_head, tuple(drives), tuple(cameras), torch.ones(3), steps=6_000)
    built = build(dataclasses.replace(Config(), perceptual_weight=0.0), scene)
    built.avatar.steps_done.fill_(1_000)
    return built


def test_regions_are_summed_over_their_boxes_per_pixel_of_the_image() -> None:
    image, target = torch.zeros(10, 20, 3), torch.zeros(10, 20, 3)
    image[2:5, 4:8] = 0.5
    image[9, 19] = 1.0
    inside = regions_l1(image, target, [(4.0, 2.0, 7.0, 4.0)])
    assert torch.allclose(inside, torch.tensor(0.5 * 12 / 200))
    clipped = regions_l1(image, target, [(18.5, 8.0, 99.0, 99.0), (-9.0, -9.0, -1.0, -1.0)])
    assert torch.allclose(clipped, torch.tensor(1.0 / 200))
    assert regions_l1(image, target, []) == 0


def test_terms_beside_the_papers(avatar: GGAvatarPlus, toy_capture: Capture) -> None:
    count = len(avatar.avatar.rows)
    image, target, alpha = torch.full((48, 48, 3), 0.25), torch.zeros(48, 48, 3), torch.ones(48, 48, 1)
    drawn = Rendering(image, 0.5 * alpha, alpha, torch.zeros(count, 2), torch.ones(count))
    frame = Frame(avatar.avatar.scene.drives[0], avatar.avatar.scene.cameras[0], target, alpha)
    terms = avatar.losses(frame, drawn, 1_001)
    assert set(terms) == {"l1", "dssim", "position", "scale", "alpha", "regions"}
    assert torch.allclose(terms["alpha"], torch.tensor(0.1 * 0.5))
    assert 0 < terms["regions"].item() < terms["l1"].item()


def test_colour_rows_start_as_nothing_and_then_move_colours(avatar: GGAvatarPlus) -> None:
    drive = avatar.avatar.scene.drives[0]
    before = avatar.gaussians(drive).colors
    assert torch.equal(before[:, :1], avatar.avatar.rows["sh"])
    adjuster = avatar.avatar.adjuster
    assert adjuster is not None and adjuster.last_bias.shape[0] == 13
    with torch.no_grad():
        adjuster.last_bias[10] = 1.0
    after = avatar.gaussians(drive).colors
    assert not torch.allclose(before[:, 0, 0], after[:, 0, 0]) and torch.equal(before[:, 0, 1:], after[:, 0, 1:])
