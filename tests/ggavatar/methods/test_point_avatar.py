"""PointAvatar: every printed number, its terms by hand, its motion against the head, and its road through training.

Also covers `ggavatar/points/driving.py`, `ggavatar/points/shading.py`.
"""

from __future__ import annotations

import dataclasses
from pathlib import Path

import pytest
import torch

from ggavatar.core import Drive, Frame
from ggavatar.data.capture import Capture
from ggavatar.data.frames import drives_and_cameras
from ggavatar.data.scene import Scene
from ggavatar.geometry.transforms import axis_angle_to_matrix, rigid
from ggavatar.head.model import HeadModel
from ggavatar.io.json_files import write_json
from ggavatar.losses.terms import l1
from ggavatar.methods.point_avatar import (
    PRESETS,
    UNITS_PER_METER,
    Config,
    PointAvatar,
    build,
    cloud_schedule,
    rasterizer,
)
from ggavatar.render.discs.values import DiscRendering, Discs
from ggavatar.training.checkpoint import load_checkpoint
from ggavatar.training.journal import read_journal
from ggavatar.training.registry import load
from ggavatar.training.run_folder import write_config
from ggavatar.training.session import configure, make_trainer
from ggavatar.training.trainer import StopSignals, Trainer

QUICK = {"perceptual_weight": 0.0}


def scene_of(capture: Capture, head: HeadModel, steps: int = 6_200) -> Scene:
    drives, cameras = drives_and_cameras(capture, head, "cpu")
    return Scene(head, tuple(drives), tuple(cameras), torch.ones(3), steps=steps)


@pytest.fixture
def avatar(toy_capture: Capture, toy_head: HeadModel) -> PointAvatar:
    return build(Config(**QUICK), scene_of(toy_capture, toy_head))


def rendered(avatar: PointAvatar, drive: Drive) -> tuple[Frame, DiscRendering]:
    """A gray frame and its rendering by the avatar."""
    camera = avatar.scene.cameras[0]
    drawn = rasterizer("cpu")(avatar.gaussians(drive), camera, torch.ones(3))
    assert isinstance(drawn, DiscRendering)
    size = camera.height, camera.width
    return Frame(drive, camera, torch.full((*size, 3), 0.5), torch.ones(*size, 1)), drawn


def test_printed_numbers() -> None:
    config = load("point_avatar").config("paper")
    assert config == Config() and PRESETS["paper"] == {}
    assert (config.points, config.sphere, config.max_points, config.epochs) == (400, 0.5, 240_000, 62)
    assert (config.upsampling_epochs, config.pruning_radius, config.jaw) == (5, 0.006, 0.4)
    assert (config.rate, config.tracking_rate, config.tracking_epochs) == (1e-4, 5e-4, 10)
    weights = (config.mask_weight, config.perceptual_weight, config.distance_weight, config.eikonal_weight)
    assert weights == (1.0, 0.1, 1.0, 0.1) and config.head_weight == 10 and config.head_milestones == (10, 20, 30, 40)


def test_epochs_scale_with_the_training(toy_capture: Capture, toy_head: HeadModel) -> None:
    plan = cloud_schedule(Config(), scene_of(toy_capture, toy_head, 62_000))
    assert (plan.steps_per_epoch, plan.upsampling_epochs, plan.pruning_steps, plan.max_points) == (
        1_000,
        5,
        1_000,
        240_000,
    )
    short = cloud_schedule(Config(pruning_frames=100), scene_of(toy_capture, toy_head, 1_500))
    assert short.steps_per_epoch == 24 and short.pruning_steps == 120
    little = dataclasses.replace(scene_of(toy_capture, toy_head, 10), max_gaussians=900)
    assert cloud_schedule(Config(), little).steps_per_epoch == 1 and cloud_schedule(Config(), little).max_points == 900


def test_terms_by_hand(avatar: PointAvatar) -> None:
    frame, drawn = rendered(avatar, avatar.scene.drives[3])
    terms = avatar.losses(frame, drawn, 1)
    assert set(terms) == {"l1", "mask", "distance", "eikonal", "skinning", "correctives", "expressions"}
    assert torch.isclose(terms["l1"], l1(drawn.image, frame.image))
    assert torch.isclose(terms["mask"], (1 - drawn.alpha).mean())
    surface = avatar.surface(avatar.cloud.points)
    assert torch.isclose(terms["distance"], surface.distance.square().mean())
    at_points = (surface.gradient.norm(dim=1) - 1).square().mean()
    assert 0.05 * at_points < terms["eikonal"] < 0.05 * at_points + 0.05
    target = torch.full((6,), 1 / 6) - torch.cat((torch.zeros(1), avatar.head.skinning_weights[0]))
    assert 0.2 * target.square().mean() < terms["skinning"] < 5 * target.square().mean()
    avatar.steps_done.fill_(10 * avatar.schedule.steps_per_epoch)
    rendered(avatar, avatar.scene.drives[3])
    assert torch.isclose(avatar.losses(frame, drawn, 1)["skinning"], terms["skinning"] / 2)
    avatar.steps_done.fill_(45 * avatar.schedule.steps_per_epoch)
    rendered(avatar, avatar.scene.drives[3])
    assert torch.isclose(avatar.losses(frame, drawn, 1)["expressions"], terms["expressions"] / 16)


def test_losses_reach_everything_that_learns(avatar: PointAvatar) -> None:
    with torch.no_grad():
        for parameter in avatar.deformer.parameters():
            parameter += 0.02 * torch.randn(parameter.shape, generator=torch.Generator().manual_seed(1))
    avatar.steps_done.fill_(30 * avatar.schedule.steps_per_epoch)
    frame, drawn = rendered(avatar, avatar.scene.drives[3])
    torch.stack(list(avatar.losses(frame, drawn, 1).values())).sum().backward()
    silent = [name for name, value in avatar.named_parameters() if value.grad is None]
    assert not silent
    assert drawn.means2d.grad is not None and drawn.means2d.grad.any()
    assert avatar.corrections is not None and avatar.corrections.expression.grad.is_sparse


def test_at_the_canonical_pose_points_are_at_home(avatar: PointAvatar) -> None:
    """Equal skinning would mix the joints; in the canonical pose only the still one differs from its home."""
    drive = dataclasses.replace(avatar.driver.canonical, head_to_camera=avatar.driver.poses.reference)
    found = avatar.gaussians(drive)
    assert isinstance(found, Discs) and torch.allclose(found.means, avatar.cloud.points / UNITS_PER_METER, atol=1e-6)
    assert found.radius == pytest.approx(0.16875) and found.colors.min() >= 0 and found.colors.max() <= 1
    assert 0.005 < float(found.scales[0, 0]) < 0.05
    moved = dataclasses.replace(drive, translation=torch.tensor([0.0, 0.1, 0.0]))
    weights = avatar.deformer.bases(avatar.cloud.points).weights
    shift = (1 - weights[:, :1]) * moved.translation
    assert torch.allclose(avatar.gaussians(moved).means, found.means + shift, atol=1e-6)


def test_the_still_joint_stays_before_the_camera(avatar: PointAvatar) -> None:
    with torch.no_grad():
        avatar.deformer.skinning_bias[0] = 10.0  # all weight on it
    rest = dataclasses.replace(avatar.driver.canonical, head_to_camera=avatar.driver.poses.reference)
    turn = rigid(axis_angle_to_matrix(torch.tensor([0.0, 0.4, 0.0])), torch.tensor([0.05, 0.0, 0.02]))
    turned = dataclasses.replace(rest, head_to_camera=turn @ avatar.driver.poses.reference)

    def in_camera(drive: Drive) -> torch.Tensor:
        return avatar.gaussians(drive).means @ drive.head_to_camera[:3, :3].T + drive.head_to_camera[:3, 3]

    assert avatar.driver.poses.in_camera and torch.allclose(in_camera(rest), in_camera(turned), atol=1e-6)
    assert not torch.allclose(avatar.gaussians(rest).means, avatar.gaussians(turned).means, atol=1e-3)


def test_shading_sees_the_normal_as_the_camera_does(avatar: PointAvatar) -> None:
    with torch.no_grad():
        avatar.deformer.skinning_bias[2] = 10.0  # the neck: rigid with the head
    rest = dataclasses.replace(avatar.driver.canonical, head_to_camera=avatar.driver.poses.reference)
    rotation = axis_angle_to_matrix(torch.tensor([0.0, 0.9, 0.0]))
    turned = dataclasses.replace(rest, head_to_camera=rigid(rotation, torch.zeros(3)) @ avatar.driver.poses.reference)
    surface = avatar.surface(avatar.cloud.points)
    for drive in (rest, turned):
        normals = torch.nn.functional.normalize(surface.gradient, dim=1) @ drive.head_to_camera[:3, :3].T
        expected = (2 * avatar.shading(normals) * surface.albedo).clamp(0, 1)
        assert torch.allclose(avatar.gaussians(drive).colors, expected, atol=1e-4)


def test_only_training_frames_are_corrected_and_not_at_first(avatar: PointAvatar) -> None:
    corrections, drive = avatar.corrections, avatar.scene.drives[3]
    assert corrections is not None
    with torch.no_grad():
        corrections.translation[3] = torch.tensor([0.1, 0.0, 0.0])
    new = dataclasses.replace(drive, frame=None)
    apart = (avatar.gaussians(drive).means - avatar.gaussians(new).means).norm(dim=1)
    assert (apart > 0.05).all()
    for epochs, learning in ((10, False), (11, True)):
        avatar.steps_done.fill_(epochs * avatar.schedule.steps_per_epoch)
        assert avatar._corrected(drive).translation.requires_grad == learning
    assert build(Config(tracking_rate=0.0), avatar.scene).corrections is None


def test_evaluation_draws_what_training_draws(avatar: PointAvatar) -> None:
    drive = avatar.scene.drives[5]
    trained = avatar.train().gaussians(drive)
    with torch.no_grad():
        avatar.eval()
        first, second = avatar.gaussians(drive), avatar.gaussians(drive)
    for name in ("means", "colors"):
        assert torch.allclose(getattr(trained, name), getattr(first, name), atol=1e-5)
        assert torch.equal(getattr(first, name), getattr(second, name))


def test_rate_falls_to_its_share(toy_capture: Capture, toy_head: HeadModel) -> None:
    avatar = build(Config(**QUICK, rate_left=0.1), scene_of(toy_capture, toy_head, 100))
    for step, rate in ((50, 1e-4 * 0.1**0.5), (100, 1e-5)):
        _, drawn = rendered(avatar, avatar.scene.drives[0])
        avatar.after_backward(drawn, step)
        rates = [group["lr"] for optimizer in avatar.optimizers()[:2] for group in optimizer.param_groups]
        assert rates == pytest.approx([rate, rate])


SETTINGS = [
    "epochs=8",
    "upsampling_epochs=2",
    "pruning_frames=1",
    "tracking_epochs=2",
    "regularised=40",
    "points=60",
    "perceptual_weight=0",
]


def start(capture: Capture, folder: Path) -> Trainer:
    """Sixteen steps, two an epoch: doublings every 4, prunings every 2, corrections from step 7 on."""
    options = {"method": "point_avatar", "steps": 16, "eval_every": 0, "save_every": 5, "device": "cpu"}
    config, split = configure(capture, {**options, "max_gaussians": 200, "set": SETTINGS})
    config = dataclasses.replace(config, training=dataclasses.replace(config.training, log_every=1))
    folder.mkdir(parents=True, exist_ok=True)
    write_config(folder, config, split)
    write_json(folder / "provenance.json", {})
    return make_trainer(folder, config, capture, split)


class StopAt:
    """Asks to stop after a step."""

    def __init__(self, stop: StopSignals, at: int) -> None:
        self._stop, self._at = stop, at

    def step(self, step: int, loss: float, gaussians: int) -> None:
        if step == self._at:
            self._stop.received = 15

    def evaluated(self, step: int, psnr: float) -> None:
        pass

    def close(self) -> None:
        pass


def test_two_runs_and_a_broken_one_are_bit_identical(toy_capture: Capture, tmp_path: Path) -> None:
    for name, stops in (("straight", ()), ("broken", (4, 7, 13))):
        for at in (*stops, 1_000):
            trainer, stop = start(toy_capture, tmp_path / name), StopSignals()
            trainer.listener = StopAt(stop, at)
            trainer.run(trainer.resume(), stop)
    lines = [
        [
            {key: value for key, value in line.items() if key not in ("seconds", "waited")}
            for line in read_journal(tmp_path / name / "metrics/train.jsonl")
        ]
        for name in ("straight", "broken")
    ]
    counts = [line["gaussians"] for line in lines[0]]
    assert lines[0] == lines[1] and len(counts) == 16 and max(counts) > 60 > min(counts)
    assert len(set(counts)) > 4
    states = [load_checkpoint(tmp_path / name / "checkpoints")[0] for name in ("straight", "broken")]
    assert states[0].keys() == states[1].keys()
    assert all(torch.equal(states[0][name], states[1][name]) for name in states[0])
    assert states[0]["avatar.corrections.expression"].any()


def test_units_are_those_of_the_authors(avatar: PointAvatar) -> None:
    """Their FLAME is four times as large; 5e-4 is the rate of corrections, of translations in that unit."""
    assert UNITS_PER_METER == 4.0
    assert avatar.corrections_optimizer is not None
    rates = [group["lr"] for group in avatar.corrections_optimizer.param_groups]
    assert rates == pytest.approx([5e-4, 5e-4, 5e-4 / 4])
    assert isinstance(avatar.corrections_optimizer, torch.optim.SparseAdam)


def test_perceptual_loss_compares_images_of_224_px(
    toy_capture: Capture, toy_head: HeadModel, monkeypatch: pytest.MonkeyPatch
) -> None:
    """PointAvatar's code resizes both images for VGG; the weight is 0.1."""
    from ggavatar.losses import vgg_term

    class Features(torch.nn.Module):
        name = "stub"

        def forward(self, image: torch.Tensor, target: torch.Tensor) -> torch.Tensor:
            assert image.shape == target.shape == (224, 224, 3)
            return torch.tensor(2.0)

    monkeypatch.setattr(vgg_term, "perceptual_loss", lambda *_, **__: Features())
    avatar = build(Config(), scene_of(toy_capture, toy_head))
    frame, drawn = rendered(avatar, avatar.scene.drives[0])
    assert avatar.losses(frame, drawn, 1)["perceptual"].item() == pytest.approx(0.2)
