"""PSAvatar: its start, two stages, objective and schedule, and what the settings and variants change, in closed form.

The formulas of placing and moving points are tested in `tests/ggavatar/points/test_shell.py` and
`tests/ggavatar/points/test_morphable_shape.py`.
"""

from __future__ import annotations

import dataclasses
import math
from typing import Any

import pytest
import torch

from ggavatar.core import Frame, Rendering
from ggavatar.data.capture import Capture
from ggavatar.data.frames import drives_and_cameras
from ggavatar.data.scene import Scene
from ggavatar.gaussians.initialization import faces_seen
from ggavatar.geometry.transforms import axis_angle_to_matrix, quaternion_multiply, rigid
from ggavatar.head.model import HeadModel
from ggavatar.losses.dssim import DssimTarget, dssim_in_torch
from ggavatar.methods.ps_avatar import Config, PSAvatar, build
from ggavatar.points.morphable_shape import pose_points, skinned_mesh
from ggavatar.render.reference import rasterize
from ggavatar.training import registry

RATES = {
    "displacements": 1.6e-4,
    "quats": 1e-3,
    "log_scales": 5e-3,
    "opacity_logits": 0.05,
    "sh": 2.5e-3,
    "sh_rest": 2.5e-3 / 20,
}


def scene_of(capture: Capture, head: HeadModel, steps: int = 1_000, most: int = 300) -> Scene:
    drives, cameras = drives_and_cameras(capture, head, "cpu")
    return Scene(head, tuple(drives), tuple(cameras), torch.tensor([1.0, 1.0, 1.0]), steps=steps, max_gaussians=most)


@pytest.fixture
def scene(toy_capture: Capture, toy_head: HeadModel) -> Scene:
    return scene_of(toy_capture, toy_head)


def make(scene: Scene, **changes: Any) -> PSAvatar:
    return build(dataclasses.replace(Config(perceptual_weight=0.0), **changes), scene)


def drawn(avatar: PSAvatar, row: int = 4) -> tuple[Frame, Rendering]:
    """A training frame in gray, and the avatar's rendering of it."""
    scene = avatar.scene
    alpha = torch.rand(48, 48, 1, generator=torch.Generator().manual_seed(0))
    frame = Frame(scene.drives[row], scene.cameras[row], (0.3 * alpha + 1 - alpha).expand(48, 48, 3), alpha)
    return frame, rasterize(avatar.gaussians(frame.drive), frame.camera, scene.background)


def trained_step(avatar: PSAvatar, step: int) -> None:
    frame, rendering = drawn(avatar)
    sum(avatar.losses(frame, rendering, step).values(), torch.zeros(())).backward()
    for optimizer in avatar.optimizers():
        optimizer.step()
    avatar.after_backward(rendering, step)
    for optimizer in avatar.optimizers():
        optimizer.zero_grad(set_to_none=True)


def test_start_is_a_translucent_cloud_half_on_and_half_off_the_skin(scene: Scene) -> None:
    avatar = make(scene)
    rows = avatar.rows
    assert len(rows) == 300 and {name: rows.rate(name) for name in RATES} == RATES
    off = rows["offsets"] != 0
    assert int(off.sum()) == 150 and not off[:150].any()
    assert torch.allclose(rows["opacity_logits"].sigmoid(), torch.full((300,), 0.2))
    assert not rows["displacements"].any() and not rows["sh"].any() and not rows["sh_rest"].any()
    distance = torch.cdist(rows["rest"].double(), rows["rest"].double()).topk(4, largest=False).values[:, 1:]
    size = distance.square().mean(1).sqrt().float()
    assert torch.allclose(rows["log_scales"].exp(), size[:, None].expand(-1, 3), rtol=1e-3)
    posed = avatar.gaussians(scene.head.neutral_drive())
    assert torch.allclose(posed.means, rows["rest"], atol=1e-6)
    assert torch.allclose(posed.scales, 1.0 * rows["log_scales"].exp()) and posed.sh_degree == 0
    assert len(make(scene, points=100, off_share=0.2).rows) == 100
    assert not make(scene, off_share=0.0).rows["offsets"].any()


def test_first_places_seen_can_be_seen(scene: Scene) -> None:
    avatar = make(scene, first_places="seen")
    seen = faces_seen(scene, avatar.poses)
    assert 0 < int(seen.sum()) < len(seen) and seen[avatar.rows["face"]].all()
    assert not seen[make(scene).rows["face"]].all()


def test_off_the_face_offsets_are_small(toy_capture: Capture, toy_head: HeadModel) -> None:
    head = dataclasses.replace(toy_head, regions={"face": (toy_head.template[:, 2] > 0).nonzero().squeeze(-1)})
    rows = make(scene_of(toy_capture, head)).rows
    in_face = (head.template[head.faces[rows["face"]]][:, :, 2] > 0).all(1) & (rows["offsets"] != 0)
    assert in_face.any() and float(rows["offsets"][in_face].min()) >= -0.005
    assert float(rows["offsets"][in_face].max()) <= 0.015 and 0.05 < float(rows["offsets"].max()) <= 0.06


def test_objective_of_both_stages_by_hand(scene: Scene) -> None:
    """L1 + |mask| in the alignment; 0.8 L1 + 0.2 D-SSIM + 0.1 |mask| for Gaussians."""
    avatar = make(scene)
    frame, rendering = drawn(avatar)
    off, uncovered = (rendering.image - frame.image).abs().mean(), (rendering.alpha - frame.alpha).abs().mean()
    terms = avatar.losses(frame, rendering, 250)
    assert set(terms) == {"l1", "mask"}
    assert torch.allclose(terms["l1"], off) and torch.allclose(terms["mask"], uncovered)
    terms = avatar.losses(frame, rendering, 251)
    assert set(terms) == {"l1", "dssim", "mask"}
    assert torch.allclose(terms["l1"], 0.8 * off) and torch.allclose(terms["mask"], 0.1 * uncovered)
    similar = dssim_in_torch(rendering.image, DssimTarget.of(frame.image))
    assert torch.allclose(terms["dssim"], 0.2 * similar, rtol=1e-4)


def test_the_alignment_trains_round_points_and_gaussians_have_sizes_and_turns(scene: Scene) -> None:
    avatar = make(scene)

    def learning(step: int) -> set[str]:
        frame, rendering = drawn(avatar)
        sum(avatar.losses(frame, rendering, step).values(), torch.zeros(())).backward()
        found = {name for name, values in avatar.named_parameters() if values.grad is not None and values.grad.any()}
        avatar.zero_grad(set_to_none=True)
        return {name.rpartition(".")[2] for name in found}

    aligned = {"displacements", "opacity_logits", "sh", "basis"}
    assert learning(1) == aligned
    avatar.steps_done.fill_(250)
    with torch.no_grad():
        avatar.rows["log_scales"][:, 0] += 0.5
    assert learning(251) == {*aligned, "log_scales", "quats"}
    avatar.steps_done.fill_(500)
    assert "sh_rest" in learning(501)


def test_round_points_shrink_to_half_and_the_switch_changes_nothing_but_faint_ones(scene: Scene) -> None:
    avatar = make(scene, least_share=0.0)
    drive = scene.drives[3]
    with torch.no_grad():
        avatar.rows["opacity_logits"].copy_(torch.linspace(-1.9, 3.0, 300))
    sizes = avatar.rows["log_scales"].exp()
    for done, share in ((0, 1.0), (125, 0.5**0.5), (249, 0.5)):
        avatar.steps_done.fill_(done)
        assert torch.allclose(avatar.gaussians(drive).scales, share * sizes, rtol=4e-3)
    frame, rendering = drawn(avatar)
    before = rasterize(dataclasses.replace(avatar.gaussians(drive), scales=0.5 * sizes), frame.camera, torch.ones(3))
    avatar.after_backward(rendering, 250)
    assert not avatar.is_aligning and len(avatar.rows) == 300
    after = rasterize(avatar.gaussians(drive), frame.camera, torch.ones(3))
    assert torch.allclose(after.image, before.image, atol=1e-5)
    assert avatar.gaussians(drive).sh_degree == 0


def test_pruning_removes_the_faint_but_not_the_last_fifth(scene: Scene) -> None:
    avatar = make(scene, prune_iterations=600, iterations=30_000)
    assert avatar.prune_interval == 20
    _, rendering = drawn(avatar)
    names = [name for name in avatar.rows.columns() if name != "opacity_logits"]
    order = torch.randperm(300, generator=torch.Generator().manual_seed(1))
    opacity = torch.linspace(0.0005, 0.9, 300)
    before = {name: avatar.rows[name].clone() for name in names}

    def after(step: int, values: torch.Tensor) -> int:
        with torch.no_grad():
            avatar.rows["opacity_logits"].copy_(values.logit())
        avatar.after_backward(rendering, step)
        return len(avatar.rows)

    assert after(20, opacity[order]) == 300 and after(39, opacity[order]) == 300
    kept = opacity[order] >= 0.1
    assert after(40, opacity[order]) == int(kept.sum()) < 300
    for name in names:
        assert torch.equal(avatar.rows[name], before[name][kept]), name
    count = len(avatar.rows)
    assert after(60, torch.full((count,), 0.09)) == count  # equal to the most opaque fifth
    assert after(80, torch.linspace(0.01, 0.09, count)) == 60
    assert after(250, torch.linspace(0.01, 0.3, 60)) == 60
    assert float(avatar.rows["opacity_logits"].detach().sigmoid().min()) == pytest.approx(0.1, rel=1e-5)
    avatar.least = 0
    assert after(260, torch.linspace(0.0041, 0.2, 60)) == 59 and after(1_000, torch.linspace(0.001, 0.2, 59)) == 59


def test_points_are_where_they_were_drawn_but_for_their_displacement(scene: Scene) -> None:
    avatar = make(dataclasses.replace(scene, steps=80))
    fixed = {name: avatar.rows[name].clone() for name in ("face", "weights", "offsets", "rest")}
    for step in range(1, 25):
        trained_step(avatar, step)
    kept = torch.tensor([int((fixed["rest"] == rest).all(1).nonzero()[0]) for rest in avatar.rows["rest"]])
    assert all(torch.equal(avatar.rows[name], values[kept]) for name, values in fixed.items())
    assert avatar.rows["displacements"].any() and all(bool(v.isfinite().all()) for v in avatar.rows.columns().values())
    assert avatar.corrections is not None and avatar.corrections.basis.any()
    pinned = make(scene, free=False, corrections=False)
    trained_step(pinned, 1)
    assert not pinned.rows["displacements"].any() and len(pinned.optimizers()) == 1


def test_displacements_are_skinned(scene: Scene) -> None:
    """A displacement at rest turns with its point."""
    avatar, drive = make(scene), scene.drives[4]
    drive = dataclasses.replace(drive, joint_rotations=drive.joint_rotations.clone())
    drive.joint_rotations[0] = torch.tensor([0.0, 0.5, 0.0])
    before = avatar.gaussians(drive).means
    shift = torch.tensor([0.01, 0.02, -0.01])
    with torch.no_grad():
        avatar.rows["displacements"].add_(shift)
    moved = avatar.gaussians(drive).means - before
    turned = axis_angle_to_matrix(drive.joint_rotations[0])
    still = (avatar.head.skinning_weights[avatar.head.faces[avatar.rows["face"]]][:, :, 2] < 1e-3).all(1)
    assert still.any() and torch.allclose(moved[still], (turned @ shift).expand_as(moved[still]), atol=1e-4)


def test_rotations_are_those_of_the_points_after_their_own(scene: Scene) -> None:
    avatar = make(scene)
    avatar.steps_done.fill_(250)
    own = torch.nn.functional.normalize(torch.randn(300, 4, generator=torch.Generator().manual_seed(0)), dim=1)
    with torch.no_grad():
        avatar.rows["quats"].copy_(3 * own)
    drive = dataclasses.replace(scene.drives[4], joint_rotations=torch.zeros(5, 3))
    drive.joint_rotations[0] = torch.tensor([0.0, 0.5, 0.0])
    turn = torch.tensor([math.cos(0.25), 0.0, math.sin(0.25), 0.0]).expand(300, 4)
    assert torch.allclose(avatar.gaussians(drive).quats, quaternion_multiply(turn, own), atol=1e-5)


def test_corrections_act_on_points_off_the_skin_and_not_at_rest(scene: Scene) -> None:
    avatar = make(scene)
    assert avatar.corrections is not None
    before = avatar.gaussians(scene.drives[4]).means
    with torch.no_grad():
        avatar.corrections.basis.fill_(0.01)
    assert torch.allclose(avatar.gaussians(scene.head.neutral_drive()).means, avatar.rows["rest"], atol=1e-6)
    moved = (avatar.gaussians(scene.drives[4]).means - before).norm(dim=1)
    assert (moved > 1e-4).all()


def test_rates_fall_in_each_stage(scene: Scene) -> None:
    avatar = make(scene)
    assert avatar.corrections is not None
    _, rendering = drawn(avatar)
    expected = {
        1: (1.6e-4 * 0.01 ** (1 / 250), 1e-4 * 0.1 ** (1 / 250)),
        125: (1.6e-5, 10**-4.5),
        249: (1.6e-4 * 0.01 ** (249 / 250), 1e-4 * 0.1 ** (249 / 250)),
        250: (1.6e-5, 1e-5),
        625: (1.6e-6, 1e-5),
        1_000: (1.6e-7, 1e-5),
    }
    for step, (position, basis) in expected.items():
        avatar.after_backward(rendering, step)
        assert avatar.rows.rate("displacements") == pytest.approx(position)
        assert avatar.corrections.optimizer.param_groups[0]["lr"] == pytest.approx(basis)
        assert avatar.rows.rate("opacity_logits") == 0.05 and int(avatar.steps_done) == step


def test_schedule_scales_with_the_training(toy_capture: Capture, toy_head: HeadModel) -> None:
    avatar = make(scene_of(toy_capture, toy_head, 30_000))
    assert (avatar.aligned_after, avatar.prune_interval, avatar.least) == (7_500, 500, 60)
    for done, degree in ((7_500, 0), (8_499, 0), (8_500, 1), (10_500, 3), (30_000, 3)):
        avatar.steps_done.fill_(done)
        assert avatar._sh_degree() == degree
    assert make(scene_of(toy_capture, toy_head, 300)).prune_interval == 10


def test_off_the_skin_points_follow_skinning_or_the_posed_normal(scene: Scene) -> None:
    """Both agree at rest and on the skin; off it they part where the mesh bends."""
    skin, normal = make(scene), make(scene, follow="normal")
    still = scene.head.neutral_drive()
    assert torch.allclose(skin.gaussians(still).means, normal.gaussians(still).means, atol=1e-6)
    drive = scene.drives[4]
    apart = (skin.gaussians(drive).means - normal.gaussians(drive).means).detach().norm(dim=1)
    rows, head = skin.rows, scene.head
    mesh = skinned_mesh(head, drive)
    skinned = pose_points(mesh, head.faces[rows["face"]], rows["weights"], rows["rest"]).means
    assert torch.allclose(skin.gaussians(drive).means, skinned, atol=1e-6)
    on = rows["offsets"] == 0
    assert 3 * float(apart[on].mean()) < float(apart[~on].mean()) and float(apart[~on].max()) > 5e-3


def test_moving_the_camera_or_the_head_is_the_same(scene: Scene) -> None:
    avatar = make(scene)
    avatar.steps_done.fill_(250)
    with torch.no_grad():
        avatar.rows["opacity_logits"].fill_(3.0)
        avatar.rows["log_scales"].add_(torch.randn(300, 3, generator=torch.Generator().manual_seed(0)) * 0.5)
        avatar.rows["sh"].copy_(torch.randn(300, 1, 3, generator=torch.Generator().manual_seed(1)))
    axis, root = torch.tensor([0.2, -0.4, 0.3]), scene.head.joint_regressor[0] @ scene.head.template
    drive, camera = scene.drives[4], scene.cameras[4]
    drive = dataclasses.replace(drive, expression=0 * drive.expression)
    turned = dataclasses.replace(drive, joint_rotations=drive.joint_rotations.clone())
    turned.joint_rotations[0] = axis
    rotation = axis_angle_to_matrix(axis)
    motion = rigid(rotation, root - rotation @ root)
    moved = dataclasses.replace(camera, world_to_camera=camera.world_to_camera @ motion)
    with torch.no_grad():
        still = rasterize(avatar.gaussians(drive), moved, scene.background).image
        other = rasterize(avatar.gaussians(turned), camera, scene.background).image
    assert torch.allclose(still, other, atol=1e-4) and float((1 - still).max()) > 0.3


def test_variants_and_notes(scene: Scene) -> None:
    changes = {"normal": ("follow", "normal"), "onsurface": ("off_share", 0.0), "pinned": ("free", False)}
    for name, (field, value) in (changes | {"without_corrections": ("corrections", False)}).items():
        assert getattr(registry.load(f"ps_avatar_{name}").config("fast"), field) == value
    assert make(scene).notes()["points"] == "150 on the skin, 150 off it"
    assert "never published" in make(scene).notes()["reconstruction"]
    assert registry.load("ps_avatar").least_gaussians(scene.head) == 8
    assert len(make(dataclasses.replace(scene, max_gaussians=8)).rows) == 8
