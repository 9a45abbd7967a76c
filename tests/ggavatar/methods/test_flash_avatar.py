"""FlashAvatar's formulas against closed forms and float64, and what its settings change.

Also covers `ggavatar/gaussians/spherical_harmonics.py`.
"""

from __future__ import annotations

import dataclasses
import math
import signal
from pathlib import Path
from typing import Any

import pytest
import torch

from ggavatar.core import Drive, Frame, Rendering
from ggavatar.data.capture import Capture
from ggavatar.data.frames import drives_and_cameras
from ggavatar.data.scene import Scene
from ggavatar.data.splits import Split
from ggavatar.gaussians.initialization import neighbor_distance
from ggavatar.geometry.transforms import project, quaternion_to_matrix
from ggavatar.head.model import HeadModel
from ggavatar.head.procedural.model import procedural_head
from ggavatar.losses.terms import huber
from ggavatar.methods.flash_avatar import (
    PAPER_ITERATIONS,
    Config,
    FlashAvatar,
    apply_offsets,
    build,
    positional_encoding,
)
from ggavatar.optim.schedules import scaled
from ggavatar.training import registry
from ggavatar.training.checkpoint import load_checkpoint
from ggavatar.training.progress import NullListener
from ggavatar.training.run_folder import RunConfig
from ggavatar.training.session import configure, make_trainer
from ggavatar.training.trainer import StopSignals


def drawn(*shape: int) -> torch.Tensor:
    return torch.rand(*shape, dtype=torch.float64, generator=torch.Generator().manual_seed(1)) * 2 - 1


@pytest.fixture
def scene(toy_capture: Capture, toy_head: HeadModel) -> Scene:
    drives, cameras = drives_and_cameras(toy_capture, toy_head, "cpu")
    return Scene(toy_head, tuple(drives), tuple(cameras), torch.ones(3), steps=1_500, max_gaussians=500)


@pytest.fixture
def avatar(scene: Scene) -> FlashAvatar:
    return build(Config(), scene)


def test_authors_numbers_are_the_paper_preset() -> None:
    config = registry.load("flash_avatar").config("paper")
    assert config == Config(texels=256)  # GGAvatar, Sec. 4.1: 256² texels with boundary; 128² in the authors' code
    assert config.boundary == "keep" and Config().texels == 128
    assert (config.texels, config.octaves, config.hidden, config.depth) == (256, 8, 256, 6)
    assert (config.network_rate, config.scale_rate, config.rotation_rate) == (1e-4, 5e-3, 1e-3)
    assert (config.opacity_rate, config.color_rate, config.sh_iterations) == (0.05, 2.5e-3, 500)
    assert (config.huber_delta, config.mouth_weight, config.perceptual_iterations) == (0.1, 40, 15_000)
    assert scaled(15_000, 1_500, PAPER_ITERATIONS) == 150 and scaled(500, 150_000, PAPER_ITERATIONS) == 500


def test_encoding_is_raw_and_sines_of_powers_of_two_without_pi() -> None:
    points = drawn(4, 3)
    found = positional_encoding(points, 8)
    assert found.shape == (4, 51) and torch.equal(found[:, :3], points)
    for octave in range(8):
        for axis in range(3):
            angle = points[:, axis] * 2**octave
            assert torch.allclose(found[:, 3 + 6 * octave + axis], angle.sin(), atol=1e-14)
            assert torch.allclose(found[:, 6 + 6 * octave + axis], angle.cos(), atol=1e-14)


def test_moved_follows_the_formulas_row_by_row() -> None:
    places, quats, logs, offsets = drawn(6, 3), drawn(6, 4), drawn(6, 3) * 3 - 5, drawn(6, 10)
    means, turned, scales = apply_offsets(places, quats, logs, offsets)
    for row in range(6):
        o = offsets[row].tolist()
        assert torch.allclose(means[row], places[row] + torch.tensor(o[:3]).double())
        expected = [math.exp(log * math.exp(factor)) for log, factor in zip(logs[row].tolist(), o[7:], strict=True)]
        assert scales[row].tolist() == pytest.approx(expected, rel=1e-12)
        base, turn = (
            quaternion_to_matrix(quat) for quat in (quats[row], torch.tensor([math.exp(o[3]), *o[4:7]]).double())
        )
        assert torch.allclose(quaternion_to_matrix(turned[row]), base @ turn, atol=1e-12)
    assert torch.allclose(turned.norm(dim=-1), torch.ones(6).double())
    still = apply_offsets(places, turned, logs, torch.zeros(6, 10).double())
    assert torch.equal(still.means, places) and torch.allclose(still.quats, turned)
    assert torch.allclose(still.scales, logs.exp())


def test_spacing_of_a_line_by_hand() -> None:
    found = neighbor_distance(torch.tensor([[0.0, 0, 0], [1, 0, 0], [3, 0, 0], [6, 0, 0]]))
    expected = [(1 + 9 + 36) / 3, (1 + 4 + 25) / 3, (4 + 9 + 9) / 3, (9 + 25 + 36) / 3]
    assert torch.allclose(found, torch.tensor(expected).sqrt())
    assert torch.allclose(neighbor_distance(torch.zeros(5, 3)), torch.tensor(1e-7).sqrt())


def test_first_avatar_is_the_codes(avatar: FlashAvatar, scene: Scene) -> None:
    """Grey, opacity 0.1, unturned; the network is not zero, and scales are the spacing of where it puts the rows."""
    drive, rows = scene.drives[0], avatar.rows
    posed = avatar.gaussians(drive)
    assert torch.allclose(posed.opacities, torch.full_like(posed.opacities, 0.1)) and posed.sh_degree == 0
    assert not posed.colors.any() and posed.colors.shape[1] == 16
    assert torch.equal(rows["quats"], torch.tensor([1.0, 0, 0, 0]).expand(len(rows), 4))
    places = avatar._samples().points(scene.head.vertices(drive), scene.head.faces)
    assert 0.005 < (posed.means - places).norm(dim=-1).mean() < 0.5
    assert torch.allclose(rows["log_scales"], neighbor_distance(posed.means).log()[:, None].expand(-1, 3), atol=1e-5)


def test_gaussians_are_the_networks_outputs_on_the_mesh(avatar: FlashAvatar, scene: Scene) -> None:
    """The whole forward in float64, written out."""
    drive, rows, head = scene.drives[7], avatar.rows, scene.head
    neutral = avatar._samples().points(head.neutral(), head.faces)
    inputs = torch.cat((positional_encoding(neutral, 8), head.condition(drive).expand(len(rows), -1)), dim=1).double()
    for layer in avatar.network.layers[:-1]:
        inputs = torch.relu(inputs @ layer.weight.double().T + layer.bias.double())
    end = avatar.network.layers[-1]
    offsets = torch.tanh(inputs @ end.weight.double().T + end.bias.double())
    places = avatar._samples().points(head.vertices(drive), head.faces).double()
    expected = apply_offsets(places, rows["quats"].double(), rows["log_scales"].double(), offsets)
    posed = avatar.gaussians(drive)
    assert torch.allclose(posed.means.double(), expected.means, atol=1e-6)
    assert torch.allclose(posed.scales.double(), expected.scales, rtol=1e-4)
    assert torch.allclose(posed.quats.double(), expected.quats, atol=1e-5)


def test_short_trainings_begin_on_the_mesh(scene: Scene) -> None:
    avatar = build(registry.load("flash_avatar").config("fast"), scene)
    drive = scene.drives[3]
    held = avatar.poses.hold_torso(scene.head.vertices(drive), drive, scene.head)
    expected = avatar._samples().points(held, scene.head.faces)
    assert torch.allclose(avatar.gaussians(drive).means, expected, atol=1e-7)


def frame_of(avatar: FlashAvatar) -> tuple[Frame, Rendering]:
    generator = torch.Generator().manual_seed(5)
    images = torch.rand(2, 48, 48, 3, generator=generator)
    alpha = torch.ones(48, 48, 1)
    frame = Frame(avatar.scene.drives[2], avatar.scene.cameras[2], images[0], alpha)
    count = len(avatar.rows)
    return frame, Rendering(images[1], alpha, alpha, torch.zeros(count, 2), torch.ones(count))


def test_losses_weigh_the_mouth_forty_times(avatar: FlashAvatar) -> None:
    frame, rendering = frame_of(avatar)
    terms = avatar.losses(frame, rendering, 1)
    assert set(terms) == {"huber", "mouth"}
    difference = (rendering.image - frame.image).double().abs()
    each = torch.where(difference < 0.1, difference.square() / 2, 0.1 * (difference - 0.05))
    assert terms["huber"].item() == pytest.approx(each.mean().item(), rel=1e-5)
    mask = avatar._mouth_mask(frame)
    assert 5 < mask.sum() < 48 * 48 / 4
    assert terms["mouth"].item() == pytest.approx(40 * (each * mask).mean().item(), rel=1e-5)
    assert huber(rendering.image, rendering.image, 0.1) == 0


def test_mouth_is_the_outline_of_the_projected_lips(scene: Scene) -> None:
    """On the procedural head: every lip vertex lies within a pixel of the mask, and the nose outside."""
    head = procedural_head()
    drive = dataclasses.replace(head.neutral_drive(), head_to_camera=scene.cameras[0].world_to_camera)
    avatar = build(Config(texels=16), dataclasses.replace(scene, head=head, drives=(drive,)))
    camera = dataclasses.replace(scene.cameras[0].resized(256, 256))
    frame = Frame(drive, camera, torch.zeros(256, 256, 3), torch.ones(256, 256, 1))
    mask = avatar._mouth_mask(frame)[:, :, 0]
    seen = project(head.template, camera.intrinsics, camera.world_to_camera)
    rows, columns = mask.nonzero().unbind(-1)
    lips, nose = seen[head.regions["lips"]], seen[head.regions["nose"]]
    assert mask.sum() > 30
    for values, side in ((columns, 0), (rows, 1)):
        assert values.min() + 0.5 == pytest.approx(lips[:, side].min().item(), abs=1.5)
        assert values.max() + 0.5 == pytest.approx(lips[:, side].max().item(), abs=1.5)
    assert not mask[nose[:, 1].long(), nose[:, 0].long()].any()


def test_perceptual_term_begins_late(scene: Scene) -> None:
    """After 15,000 of 150,000 iterations: a tenth of the training."""
    avatar = build(Config(), scene)
    frame, rendering = frame_of(avatar)
    assert "perceptual" not in avatar.losses(frame, rendering, 150)
    late = avatar.losses(frame, rendering, 151)
    assert late["perceptual"] > 0 and "perceptual_loss" in avatar.notes()
    outside = dataclasses.replace(frame, alpha=torch.zeros(48, 48, 1))
    assert avatar.losses(outside, rendering, 151)["perceptual"] == 0


def test_harmonics_rise_by_a_degree_every_500_iterations(avatar: FlashAvatar, scene: Scene) -> None:
    _, rendering = frame_of(avatar)
    degrees = {}
    for step in (4, 5, 10, 15, 1_500):
        avatar.after_backward(rendering, step)
        degrees[step] = avatar.gaussians(scene.drives[0]).sh_degree
    assert degrees == {4: 0, 5: 1, 10: 2, 15: 3, 1_500: 3}
    assert "steps_done" in avatar.state_dict() and len(avatar.rows) == 500


def test_rates_and_moments_are_the_codes(avatar: FlashAvatar) -> None:
    rows, network = avatar.optimizers()
    rates = {group["name"]: group["lr"] for group in rows.param_groups}
    expected = {"quats": 1e-3, "log_scales": 5e-3, "opacity_logits": 0.05, "sh": 2.5e-3, "sh_rest": 2.5e-3 / 20}
    assert rates == pytest.approx(expected) and rows.param_groups[0]["eps"] == 1e-15
    assert network.param_groups[0]["lr"] == 1e-4 and network.param_groups[0]["betas"] == (0.9, 0.999)


def test_number_of_texels_and_the_limit(scene: Scene, toy_head: HeadModel) -> None:
    roomy = dataclasses.replace(scene, max_gaussians=100_000)
    assert len(build(Config(texels=32), roomy).rows) == round(32**2 * 14_734 / 128**2)
    uv = torch.tensor([[0.0, 0.0], [1.0, 0.0], [0.0, 1.0]]).expand(len(toy_head.faces), 3, 2)
    laid = dataclasses.replace(roomy, head=dataclasses.replace(toy_head, uv=uv))
    own = build(Config(texels=32, layout="head"), laid)
    assert len(own.rows) == 32 * 33 // 2 and not own.rows["face"].any()
    assert own.notes()["texture_layout"] == "head, 528 texels"
    assert len(build(Config(texels=32), laid).rows["face"].unique()) > 100
    small = build(Config(texels=32, layout="head"), dataclasses.replace(laid, max_gaussians=100))
    assert 60 < len(small.rows) <= 100


def test_boundary_is_kept_or_dropped(scene: Scene) -> None:
    head = procedural_head()
    drive = head.neutral_drive()
    still = dataclasses.replace(scene, head=head, drives=(drive,), cameras=scene.cameras[:1], max_gaussians=10_000)
    lowest = {}
    for choice in ("keep", "drop"):
        avatar = build(Config(texels=64, boundary=choice, first_offsets="none"), still)
        lowest[choice] = avatar.gaussians(drive).means[:, 1].min()
    assert lowest["drop"] > lowest["keep"]
    named = dataclasses.replace(still, head=dataclasses.replace(head, regions={"boundary": head.faces[7]}))
    rows = build(Config(texels=64, boundary="drop"), named).rows
    assert not torch.isin(head.faces[rows["face"]], head.faces[7]).any()


def test_unseen_skin_takes_less_room(scene: Scene) -> None:
    """The egg turns to ±0.5 rad only: its back is sampled at `unseen_room` of the density of its front."""
    roomy = dataclasses.replace(scene, max_gaussians=100_000)
    share = {}
    for room in (0.25, 1.0):
        avatar = build(Config(texels=64, unseen_room=room), roomy)
        points = avatar._samples().points(scene.head.neutral(), scene.head.faces)
        share[room] = (points[:, 2] < -0.05).sum() / (points[:, 2] > 0.05).sum()
    assert share[1.0] == pytest.approx(1.0, abs=0.05) and share[0.25] == pytest.approx(0.25, abs=0.03)


def test_state_brings_back_the_places(scene: Scene) -> None:
    """A run opened with other frames, hence other places at first, is the one that was saved."""
    saved = build(Config(), scene)
    opened = build(Config(), dataclasses.replace(scene, drives=(), cameras=(), seed=7))
    drive: Drive = scene.drives[5]
    assert not torch.equal(saved.gaussians(drive).means, opened.gaussians(drive).means)
    opened.load_state_dict(saved.state_dict())
    for field in ("means", "quats", "scales"):
        assert torch.equal(getattr(saved.gaussians(drive), field), getattr(opened.gaussians(drive), field))


class Brake(NullListener):
    """A listener that asks to stop after a step, as a signal would."""

    def __init__(self, stop: StopSignals, last: int) -> None:
        self.stop, self.last = stop, last

    def step(self, step: int, loss: float, gaussians: int) -> None:
        if step == self.last:
            self.stop.received = signal.SIGTERM


def test_two_runs_and_a_broken_one_are_bit_identical(toy_capture: Capture, tmp_path: Path) -> None:
    """Broken off before and after the perceptual term begins (step 2 of 20)."""
    options = {"method": "flash_avatar", "steps": 20, "eval_every": 0, "max_gaussians": 200, "device": "cpu"}
    states = []
    for name, stops in (("straight", ()), ("again", ()), ("broken", (1, 2, 11))):
        (tmp_path / name).mkdir()
        for last in (*stops, 20):
            stop = StopSignals()
            trainer = make_trainer(tmp_path / name, *_configured(toy_capture, {**options, "set": ["crop_side=16"]}))
            trainer.listener = Brake(stop, last)
            assert trainer.run(trainer.resume(), stop) == last
        states.append(load_checkpoint(tmp_path / name / "checkpoints")[0])
    assert len(states[0]["avatar.rows.learnable.sh"]) == 200
    for other in states[1:]:
        assert other.keys() == states[0].keys()
        assert all(torch.equal(values, states[0][name]) for name, values in other.items())


def _configured(capture: Capture, options: dict[str, Any]) -> tuple[RunConfig, Capture, Split]:
    config, split = configure(capture, options)
    return config, capture, split
