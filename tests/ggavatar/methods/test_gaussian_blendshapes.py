"""Gaussian Blendshapes' formulas in closed form: transfer, linear differences, consistency, skinning, objective."""

from __future__ import annotations

import dataclasses
from typing import Any

import pytest
import torch

from ggavatar.core import Drive, Frame, Rendering
from ggavatar.data.capture import Capture
from ggavatar.data.frames import drives_and_cameras
from ggavatar.data.scene import Scene
from ggavatar.geometry.triangles import triangle_frames
from ggavatar.head.model import HeadModel
from ggavatar.methods.gaussian_blendshapes import (
    Config,
    GaussianBlendshapes,
    blend,
    build,
    coefficient_spreads,
    density_control,
    position_rate,
    strongest_blendshapes,
)


def make(capture: Capture, head: HeadModel, **changes: Any) -> GaussianBlendshapes:
    drives, cameras = drives_and_cameras(capture, head, "cpu")
    scene = Scene(head, tuple(drives), tuple(cameras), torch.ones(3), steps=40_000, max_gaussians=500)
    return build(Config(**changes), scene)


def toothless(head: HeadModel) -> HeadModel:
    """The head without a mouth to put Gaussians into."""
    return dataclasses.replace(head, regions={})


def expressed(avatar: GaussianBlendshapes, expression: list[float]) -> Drive:
    return dataclasses.replace(avatar.head.neutral_drive(), expression=torch.tensor(expression))


def at_centroids(avatar: GaussianBlendshapes) -> None:
    """Put every Gaussian on the centroid of its triangle."""
    centers = triangle_frames(avatar.head.template, avatar.head.faces).centers
    with torch.no_grad():
        avatar.rows["means"].copy_(centers[avatar.rows["face"]])


def test_neutral_is_what_the_rows_say(toy_capture: Capture, toy_head: HeadModel) -> None:
    avatar = make(toy_capture, toothless(toy_head))
    drawn, rows = avatar.gaussians(toy_head.neutral_drive()), avatar.rows
    assert torch.allclose(drawn.means, rows["means"], atol=1e-7)
    assert torch.allclose(drawn.scales, rows["log_scales"].exp())
    assert torch.allclose(drawn.opacities, torch.full((300,), 0.1))
    assert torch.allclose(drawn.quats, torch.tensor([1.0, 0, 0, 0]).expand(300, 4), atol=1e-6)


def test_without_differences_gaussians_follow_the_mesh(toy_capture: Capture, toy_head: HeadModel) -> None:
    """On a centroid the transferred blendshapes and the skinning are the mesh's own, up to the weights' mean."""
    avatar = make(toy_capture, toothless(toy_head))
    at_centroids(avatar)
    drive = avatar.scene.drives[8]
    wanted = triangle_frames(toy_head.vertices(drive), toy_head.faces).centers[avatar.rows["face"]]
    assert torch.allclose(avatar.gaussians(drive).means, wanted, atol=1e-4)
    only = dataclasses.replace(drive, joint_rotations=torch.zeros(5, 3))
    wanted = triangle_frames(toy_head.vertices(only), toy_head.faces).centers[avatar.rows["face"]]
    assert torch.allclose(avatar.gaussians(only).means, wanted, atol=1e-6)


def test_differences_are_linear_in_the_coefficients(toy_capture: Capture, toy_head: HeadModel) -> None:
    """x = x0 + Σ ψ_k / σ_k (mesh_k + strength_k Δ_k) for every property, Σ by hand; logarithms and logits for two."""
    avatar = make(toy_capture, toothless(toy_head), difference_sh_degree=1, sh_degree=1)
    at_centroids(avatar)
    generator, rows = torch.Generator().manual_seed(0), avatar.rows
    with torch.no_grad():
        noise = torch.randn(rows["differences"].shape, generator=generator)
        rows["differences"].copy_(0.01 * noise / avatar.units[:, None])
    drive = expressed(avatar, [0.5, -0.3, 0.8])
    drawn = avatar.gaussians(drive)
    row = int(avatar.strengths[rows["face"]].sum(1).argmax())
    face = int(rows["face"][row])
    units = torch.cat((drive.expression, drive.eyelids)) / avatar.spreads
    weights = [
        float(units[slot] * strength) for slot, strength in zip(avatar.slots[face], avatar.strengths[face], strict=True)
    ]
    assert sum(weight != 0 for weight in weights) == 3

    stored = rows["differences"][row].detach()
    added = avatar.units * sum(weight * stored[:, slot] for slot, weight in enumerate(weights))
    center = toy_head.vertices(drive)[toy_head.faces[face]].mean(0)
    assert torch.allclose(drawn.means[row], center + added[:3], atol=1e-6)
    assert torch.allclose(drawn.scales[row].log(), rows["log_scales"][row] + added[7:10], atol=1e-5)
    assert torch.allclose(drawn.opacities[row].logit(), rows["opacity_logits"][row] + added[10], atol=1e-5)
    sh = torch.cat((rows["sh"], rows["sh_rest"]), dim=1)[row]
    assert torch.allclose(drawn.colors[row], sh + added[11:].view(4, 3), atol=1e-6)


def test_blend_against_float64_autograd() -> None:
    generator = torch.Generator().manual_seed(1)
    differences = torch.randn(6, 3, 4, generator=generator).requires_grad_()
    weights, upstream = torch.randn(6, 4, generator=generator), torch.randn(6, 3, generator=generator)
    (blend(differences, weights) * upstream).sum().backward()
    exact = differences.detach().double().requires_grad_()
    result = torch.einsum("ndm,nm->nd", exact, weights.double())
    (result * upstream.double()).sum().backward()
    assert torch.allclose(blend(differences, weights).double(), result, atol=1e-6)
    assert differences.grad is not None and exact.grad is not None
    assert torch.allclose(differences.grad.double(), exact.grad, atol=1e-6)


def test_evaluation_leaves_out_resting_rows_and_nothing_else(toy_capture: Capture, toy_head: HeadModel) -> None:
    avatar, drive = make(toy_capture, toy_head), drives_and_cameras(toy_capture, toy_head, "cpu")[0][7]
    with torch.no_grad():
        avatar.rows["differences"].normal_(generator=torch.Generator().manual_seed(0))
        trained, evaluated = avatar.gaussians(drive), avatar.eval().gaussians(drive)
        assert avatar._cached is not None and 0 < len(avatar._cached[0]) < len(avatar.rows)
        for field in ("means", "quats", "scales", "opacities", "colors"):
            assert torch.allclose(getattr(trained, field), getattr(evaluated, field), atol=1e-6), field
        avatar.train().rows["differences"].zero_()
        assert not torch.equal(avatar.eval().gaussians(drive).scales, trained.scales)


def test_differences_step_by_their_rates(toy_capture: Capture, toy_head: HeadModel) -> None:
    """Adam's first step moves every property by its own rate per unit of weight, whatever the gradient's size."""
    avatar = make(toy_capture, toy_head)
    weights = torch.zeros(len(avatar.rows), avatar.slots.shape[1])
    weights[:, 0] = 1.0
    sum(
        part.sum() * size for part, size in zip(avatar._differences(weights), (1, 3, 50, 0.1, 7), strict=True)
    ).backward()  # type: ignore[union-attr]
    avatar.rows.optimizer.step()
    assert torch.allclose(
        torch.cat(avatar._differences(weights), dim=1), -avatar.units.expand(len(weights), -1), rtol=1e-4
    )


def test_strengths_follow_the_displacement_of_the_mesh() -> None:
    """max(d − t, 0) / (d_max − t), the strongest first, as few slots as there are moving blendshapes."""
    displacement = torch.tensor([[0.0, 1e-3, 0.0, 4e-3], [1e-6, 0.0, 0.0, 0.0], [0.0, 2e-3, 0.0, 0.0]])
    slots, strengths = strongest_blendshapes(displacement, Config(consistency_threshold=0.01))
    threshold = 0.01 * 4e-3
    assert slots.shape == (3, 2) and slots[0].tolist() == [3, 1] and slots[2, 0] == 1
    assert torch.allclose(strengths[0], torch.tensor([1.0, (1e-3 - threshold) / (4e-3 - threshold)]))
    assert not strengths[1].any() and strengths[2, 1] == 0
    assert strongest_blendshapes(displacement, Config(blendshapes=1))[0].shape == (3, 1)
    everything = strongest_blendshapes(displacement, Config(consistency=False))
    assert everything[1].shape == (3, 4) and bool((everything[1] == 1).all())


def test_where_the_mesh_rests_differences_do_nothing_and_learn_nothing(
    toy_capture: Capture, toy_head: HeadModel
) -> None:
    avatar = make(toy_capture, toy_head)
    resting = avatar.strengths[avatar.rows["face"]].sum(1) == 0
    assert 10 < int(resting.sum()) < len(avatar.rows) - 10
    with torch.no_grad():
        avatar.rows["differences"][:, :3] = 1.0 / avatar.units[:3, None]
    drive = expressed(avatar, [1.0, 1.0, 1.0])
    means = avatar.gaussians(drive).means
    apart = (means - avatar.rows["means"]).norm(dim=1)
    assert apart[resting].max() < 1e-3 < apart[~resting].max()
    means.sum().backward()
    gradient = avatar.rows["differences"].grad
    assert gradient is not None and not gradient[resting].any() and gradient[~resting].any()


def test_coefficients_are_counted_in_their_spread(toy_capture: Capture, toy_head: HeadModel) -> None:
    """Ten times the basis and a tenth of the coefficients are the same avatar."""
    drives, _ = drives_and_cameras(toy_capture, toy_head, "cpu")
    spreads = coefficient_spreads(toy_head, tuple(drives))
    wanted = torch.stack([drive.expression for drive in drives]).square().mean(0).sqrt()
    assert torch.allclose(spreads[:3], wanted) and spreads[3:].tolist() == [0.0, 0.0]
    avatar = make(toy_capture, toy_head)
    scaled_head = dataclasses.replace(toy_head, expression_basis=10 * toy_head.expression_basis)
    scaled_drives = tuple(dataclasses.replace(drive, expression=drive.expression / 10) for drive in drives)
    other = build(Config(), dataclasses.replace(avatar.scene, head=scaled_head, drives=scaled_drives))
    assert torch.equal(other.slots, avatar.slots) and torch.allclose(other.strengths, avatar.strengths, atol=1e-5)
    with torch.no_grad():
        for one in (avatar, other):
            one.rows["differences"][:, :3] = 1e-3 / one.units[:3, None]
    got, same = other.gaussians(scaled_drives[4]).means, avatar.gaussians(drives[4]).means
    assert torch.allclose(got, same, atol=1e-5)


def test_what_never_moved_follows_the_mesh_and_learns_nothing(toy_capture: Capture, toy_head: HeadModel) -> None:
    """Lids that no training frame closes move as the mesh does, and do not weaken the others' strengths."""
    lids = torch.zeros(len(toy_head.template), 3, 2)
    lids[:, 1] = 0.05 * torch.rand(len(lids), 2, generator=torch.Generator().manual_seed(0))
    head = dataclasses.replace(toothless(toy_head), eyelid_basis=lids)
    avatar, plain = make(toy_capture, head), make(toy_capture, toothless(toy_head))
    assert torch.equal(avatar.strengths, plain.strengths)
    at_centroids(avatar)
    drive = dataclasses.replace(head.neutral_drive(), eyelids=torch.tensor([1.0, 0.5]))
    wanted = triangle_frames(head.vertices(drive), head.faces).centers[avatar.rows["face"]]
    assert torch.allclose(avatar.gaussians(drive).means, wanted, atol=1e-6)


def test_objective_by_hand(toy_capture: Capture, toy_head: HeadModel) -> None:
    """0.8 L1 + 0.2 (1 − SSIM) + 10 (α − mask)², mean over pixels (Sec. 3.4 and public code)."""
    avatar = make(toy_capture, toy_head)
    assert avatar.mouth is not None
    count = len(avatar.rows)
    image, mask = torch.full((48, 48, 3), 0.75), torch.ones(48, 48, 1)
    drawn = Rendering(image, 0.6 * mask, mask, torch.zeros(count, 2), torch.ones(count))
    frame = Frame(avatar.scene.drives[0], avatar.scene.cameras[0], torch.full((48, 48, 3), 0.25), mask)
    terms = avatar.losses(frame, drawn, 1)
    assert set(terms) == {"l1", "dssim", "alpha", "mouth"} and terms["mouth"] == 0
    assert torch.allclose(terms["l1"], torch.tensor(0.4))
    assert torch.allclose(terms["alpha"], torch.tensor(10 * 0.16))
    upper = (avatar.rows["face"] == len(toy_head.faces)).nonzero().squeeze(1)
    with torch.no_grad():
        avatar.rows["means"][upper[0]] = avatar.mouth.center + torch.tensor([0.0, avatar.mouth.half_height + 0.03, 0.0])
    pushed = avatar.losses(frame, drawn, 1)["mouth"]
    assert torch.allclose(pushed, torch.tensor(100 * 0.03**2 / len(upper)), rtol=1e-4)


def test_teeth_follow_head_and_jaw_rigidly(toy_capture: Capture, toy_head: HeadModel) -> None:
    avatar = make(toy_capture, toy_head)
    joints = avatar.scene.drives[2].joint_rotations.clone()  # the capture is everybody's
    joints[1] = torch.tensor([0.0, 0.2, 0.1])
    expression = torch.tensor([1.0, 0.5, -0.5])
    drive = dataclasses.replace(avatar.scene.drives[2], expression=expression, joint_rotations=joints)
    turns, shifts = toy_head.joint_transforms(drive)
    means = avatar.gaussians(drive).means
    for which, joint in enumerate(("neck", "jaw")):
        teeth = avatar.rows["face"] == len(toy_head.faces) + which
        index = toy_head.joint_index(joint)
        wanted = avatar.rows["means"][teeth] @ turns[index].T + shifts[index]
        assert int(teeth.sum()) == 30 and torch.allclose(means[teeth], wanted, atol=1e-6)


def test_rates_and_schedule_are_the_authors(toy_capture: Capture, toy_head: HeadModel) -> None:
    avatar = make(toy_capture, toy_head)
    rates = {
        "means": 1.6e-4,
        "quats": 1e-3,
        "log_scales": 5e-3,
        "opacity_logits": 0.05,
        "sh": 2.5e-3,
        "sh_rest": 1.25e-4,
        "differences": 1.0,
    }
    assert {name: avatar.rows.rate(name) for name in rates} == pytest.approx(rates)
    units = [3.2e-7] * 3 + [1e-4] * 4 + [5e-4] * 3 + [5e-5] + [1.25e-3] * 48
    assert avatar.units.tolist() == pytest.approx(units)
    control = density_control(Config(), avatar.scene)
    assert (control.start, control.stop, control.interval, control.resetting) == (500, 15_000, 100, False)
    assert control.gradient == pytest.approx(1e-3)
    for step, rate in ((0, 1.6e-4), (15_000, 1.6e-5), (30_000, 1.6e-6), (40_000, 1.6e-6)):
        assert position_rate(Config(), avatar.scene, step) == pytest.approx(rate)
