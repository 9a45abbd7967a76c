"""GaussianAvatars' formulas in closed form: posing, objective, schedule, who is fine-tuned, and the split quirk."""

from __future__ import annotations

import dataclasses
from typing import Any

import pytest
import torch
from scipy.spatial.transform import Rotation

from ggavatar.core import Drive, Frame, Rendering
from ggavatar.data.capture import Capture
from ggavatar.data.frames import drives_and_cameras
from ggavatar.data.scene import Scene
from ggavatar.gaussians.density_control import split
from ggavatar.head.model import HeadModel
from ggavatar.methods.gaussian_avatars import (
    GGAVATAR_PAPER_SCHEDULE,
    OWN_SCHEDULE,
    Config,
    GaussianAvatars,
    build,
    density_control,
    position_rate,
)
from ggavatar.training import registry

OWN_RATES = {"means": 5e-3, "quats": 1e-3, "log_scales": 0.017, "opacity_logits": 0.05, "sh": 2.5e-3}


def scene_of(capture: Capture, head: HeadModel, steps: int = 600_000) -> Scene:
    drives, cameras = drives_and_cameras(capture, head, "cpu")
    return Scene(head, tuple(drives), tuple(cameras), torch.ones(3), steps=steps)


def make(capture: Capture, head: HeadModel, **changes: Any) -> GaussianAvatars:
    return build(Config(**changes), scene_of(capture, head))


def triangle_by_hand(corners: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor, float]:
    """Centroid, axes as columns and size of one triangle, as the paper words them: float64."""
    a, b, c = corners.double()
    edge = (b - a) / (b - a).norm()
    normal = torch.linalg.cross(edge, c - a)
    normal = normal / normal.norm()
    third = torch.linalg.cross(edge, normal)
    size = ((b - a).norm() + (third @ (c - a)).abs()) / 2
    return (a + b + c) / 3, torch.stack((edge, normal, third), dim=1), float(size)


def test_gaussians_ride_on_their_triangle(toy_capture: Capture, toy_head: HeadModel) -> None:
    """μ = S R μ0 + T, r = R r0, s = S exp(log s0), for a frame's mesh (Sec. 3.2), with scipy's rotations."""
    avatar = make(toy_capture, toy_head, finetuning=False)
    generator = torch.Generator().manual_seed(0)
    with torch.no_grad():
        for name in ("means", "quats", "log_scales"):
            avatar.rows[name].copy_(torch.randn(avatar.rows[name].shape, generator=generator))
    drive = avatar.scene.drives[5]
    drawn, vertices = avatar.gaussians(drive), toy_head.vertices(drive)
    for face in (0, 17, 60):
        center, axes, size = triangle_by_hand(vertices[toy_head.faces[face]])
        mean, local = avatar.rows["means"][face].detach().double(), avatar.rows["quats"][face].detach().double()
        assert torch.allclose(drawn.means[face].double(), size * axes @ mean + center, atol=1e-6)
        assert torch.allclose(
            drawn.scales[face].double(), size * avatar.rows["log_scales"][face].double().exp(), rtol=1e-4
        )
        turned = Rotation.from_matrix(axes.numpy()) * Rotation.from_quat(local.numpy(), scalar_first=True)
        got = Rotation.from_quat(drawn.quats[face].detach().double().numpy(), scalar_first=True)
        assert (turned * got.inv()).magnitude() < 1e-3


def test_start_is_one_gaussian_a_triangle_with_the_stated_rates(toy_capture: Capture, toy_head: HeadModel) -> None:
    avatar = make(toy_capture, toy_head)
    rows = avatar.rows
    assert rows["face"].tolist() == list(range(len(toy_head.faces)))
    assert not rows["means"].any() and not rows["log_scales"].any()
    assert torch.allclose(rows["opacity_logits"].sigmoid(), torch.full((len(rows),), 0.1))
    assert {name: rows.rate(name) for name in OWN_RATES} == OWN_RATES
    assert rows.rate("sh_rest") == pytest.approx(2.5e-3 / 20) and rows["sh_rest"].shape[1] == 15
    assert avatar.corrections is not None
    assert [group["lr"] for group in avatar.corrections.optimizer.param_groups] == [1e-3, 1e-5, 1e-6]


def test_objective_by_hand(toy_capture: Capture, toy_head: HeadModel) -> None:
    """0.8 L1 + 0.2 (1 − SSIM) + 0.01 max(‖μ‖ − 1, 0) + ‖max(s − 0.6, 0)‖ over what is visible (Sec. 3.4)."""
    avatar = make(toy_capture, toy_head)
    count = len(avatar.rows)
    with torch.no_grad():
        avatar.rows["means"][0] = torch.tensor([3.0, 0.0, 4.0])
        avatar.rows["means"][1] = torch.tensor([9.0, 9.0, 9.0])
        avatar.rows["log_scales"].fill_(-5.0)
        avatar.rows["log_scales"][2] = torch.tensor([0.9, 0.6, 1.0]).log()
    visible = torch.zeros(count)
    visible[[0, 2, 3, 4]] = 2.0
    image, alpha = torch.full((48, 48, 3), 0.75), torch.ones(48, 48, 1)
    drawn = Rendering(image, alpha, alpha, torch.zeros(count, 2), visible)
    frame = Frame(avatar.scene.drives[0], avatar.scene.cameras[0], torch.full((48, 48, 3), 0.25), alpha)
    terms = avatar.losses(frame, drawn, 1)
    assert set(terms) == {"l1", "dssim", "position", "scale"}
    assert torch.allclose(terms["l1"], torch.tensor(0.8 * 0.5))
    assert torch.allclose(terms["position"], torch.tensor(0.01 * 4.0 / 4))
    assert torch.allclose(terms["scale"], torch.tensor(0.5 / 4))


def test_own_schedule_is_the_default_and_scales(toy_capture: Capture, toy_head: HeadModel) -> None:
    assert all(getattr(Config(), name) == value for name, value in OWN_SCHEDULE.items())
    full = density_control(Config(), scene_of(toy_capture, toy_head))
    assert (full.start, full.stop, full.interval, full.reset_interval) == (10_000, 600_000, 2_000, 60_000)
    assert full.resetting and full.gradient == 2e-4 and full.split_in == "local"
    tenth = density_control(Config(), scene_of(toy_capture, toy_head, 60_000))
    assert (tenth.start, tenth.stop, tenth.interval, tenth.reset_interval) == (1_000, 60_000, 200, 6_000)
    last = density_control(Config(), scene_of(toy_capture, toy_head, 12_345))
    assert last.reset_interval == 1_234 and max(filter(last.resets, range(12_346))) == 9 * 1_234 < 12_345 - 1_234
    for share, rate in ((0, 5e-3), (0.5, 5e-4), (1, 5e-5)):
        got = position_rate(Config(), scene_of(toy_capture, toy_head), round(share * 600_000))
        assert got == pytest.approx(rate)


def test_paper_preset_is_the_seed_papers_schedule(toy_capture: Capture, toy_head: HeadModel) -> None:
    config = registry.load("gaussian_avatars").config("paper")
    assert config.perceptual_weight == 0.02 and config.finetuning and config.sh_degree == 3
    control = density_control(config, scene_of(toy_capture, toy_head, 120_000))
    assert (control.start, control.stop, control.interval, control.reset_interval) == (500, 60_000, 100, 3_000)
    assert config.perceptual_share * 120_000 == pytest.approx(5_000)
    assert registry.load("gaussian_avatars_without_perceptual").config("fast").perceptual_weight == 0
    for name, preset, wanted in (
        ("", "default", OWN_SCHEDULE),
        ("_own_schedule", "paper", OWN_SCHEDULE),
        ("_seed_schedule", "fast", GGAVATAR_PAPER_SCHEDULE),
    ):
        config = registry.load(f"gaussian_avatars{name}").config(preset)
        assert {field: getattr(config, field) for field in wanted} == wanted


def test_gradients_reach_corrections_of_training_frames_only(toy_capture: Capture, toy_head: HeadModel) -> None:
    avatar = make(toy_capture, toy_head)
    assert avatar.corrections is not None and len(avatar.optimizers()) == 2
    drive = avatar.scene.drives[3]
    avatar.gaussians(drive).means[:, 1].sum().backward()
    for parameter in avatar.corrections.parameters():
        assert parameter.grad is not None and parameter.grad[3].any()
        assert not parameter.grad[:3].any() and not parameter.grad[4:].any()
    with torch.no_grad():
        avatar.corrections.expression.fill_(0.7)
    moved, still = avatar.gaussians(drive).means, avatar.gaussians(dataclasses.replace(drive, frame=None)).means
    assert not torch.allclose(moved, still)
    plain = make(toy_capture, toy_head, finetuning=False)
    assert torch.equal(still, plain.gaussians(drive).means)
    assert plain.corrections is None and len(plain.optimizers()) == 1


def test_corrections_recover_a_known_expression(toy_capture: Capture, toy_head: HeadModel) -> None:
    """With the right mesh as target, gradient descent on the corrections finds the coefficients that were withheld."""
    avatar = make(toy_capture, toy_head, expression_rate=0.05, joint_rate=0.0, translation_rate=0.0)
    true = avatar.scene.drives[6]
    wrong = dataclasses.replace(true, expression=torch.zeros(3))
    with torch.no_grad():
        target = avatar.gaussians(dataclasses.replace(true, frame=None)).means
    assert avatar.corrections is not None
    for _ in range(120):
        avatar.corrections.optimizer.zero_grad()
        (avatar.gaussians(wrong).means - target).square().sum().backward()
        avatar.corrections.optimizer.step()
    assert torch.allclose(avatar.corrections.expression[6], true.expression, atol=0.05)


def test_world_split_draws_children_too_close_by_the_size_of_the_triangle(
    toy_capture: Capture, toy_head: HeadModel
) -> None:
    avatars = [make(toy_capture, toy_head) for _ in range(2)]
    chosen = torch.zeros(len(avatars[0].rows), dtype=torch.bool)
    chosen[12] = True
    size = avatars[0].face_scales
    split(avatars[0].rows, chosen, torch.Generator().manual_seed(3))
    split(avatars[1].rows, chosen, torch.Generator().manual_seed(3), size)
    local, world = (avatar.rows["means"][-2:] for avatar in avatars)
    assert local.abs().max() > 0.1
    assert torch.allclose(world, local * size[12], rtol=1e-5)
    assert density_control(Config(split_in="world"), avatars[0].scene).split_in == "world"


def test_pose_on_the_neck_holds_the_torso(toy_capture: Capture, toy_head: HeadModel) -> None:
    """A head that hangs on the root alone stays where the mean pose puts it, whatever the camera does."""
    rigid_head = dataclasses.replace(toy_head, skinning_weights=torch.eye(5)[0].expand(len(toy_head.template), 5))
    avatar = make(toy_capture, rigid_head, pose_on="neck", finetuning=False)

    def seen(drive: Drive) -> torch.Tensor:
        pose = drive.head_to_camera
        return (
            avatar.gaussians(dataclasses.replace(drive, expression=torch.zeros(3))).means @ pose[:3, :3].T + pose[:3, 3]
        )

    first, other = (dataclasses.replace(avatar.scene.drives[row], joint_rotations=torch.zeros(5, 3)) for row in (0, 9))
    assert torch.allclose(seen(first), seen(other), atol=1e-5)
