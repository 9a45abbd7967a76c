"""SplattingAvatar: its start, objective, schedule, and what the settings and variants change, in closed form.

The formulas of placing, walking and splitting are tested in `tests/ggavatar/gaussians/test_embedding.py`. Also covers
`ggavatar/gaussians/initialization.py`.
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
from ggavatar.geometry.transforms import axis_angle_to_matrix, rigid
from ggavatar.head.model import HeadModel
from ggavatar.methods.splatting_avatar import Config, SplattingAvatar, build, interval
from ggavatar.optim.seeding import seeded
from ggavatar.render.reference import rasterize
from ggavatar.training import registry

RATES = {
    "distances": 4e-5,
    "slides": 1.6e-4,
    "quats": 1e-3,
    "log_scales": 5e-3,
    "opacity_logits": 0.05,
    "sh": 2.5e-3,
}


def scene_of(capture: Capture, head: HeadModel, steps: int = 30_000, most: int = 1_000_000) -> Scene:
    drives, cameras = drives_and_cameras(capture, head, "cpu")
    return Scene(head, tuple(drives), tuple(cameras), torch.tensor([1.0, 1.0, 1.0]), steps=steps, max_gaussians=most)


@pytest.fixture
def scene(toy_capture: Capture, toy_head: HeadModel) -> Scene:
    return scene_of(toy_capture, toy_head, most=400)


def make(scene: Scene, **changes: Any) -> SplattingAvatar:
    return build(dataclasses.replace(Config(perceptual_weight=0.0), **changes), scene)


def drawn(avatar: SplattingAvatar, row: int = 4) -> tuple[Frame, Rendering]:
    """A training frame in gray, and the avatar's rendering of it."""
    scene = avatar.scene
    posed = avatar.gaussians(scene.drives[row])
    alpha = torch.rand(48, 48, 1, generator=torch.Generator().manual_seed(0))
    image = (0.3 * alpha + 1 - alpha).expand(48, 48, 3)
    frame = Frame(scene.drives[row], scene.cameras[row], image, alpha)
    return frame, rasterize(posed, frame.camera, scene.background)


def test_start_is_the_authors(toy_capture: Capture, toy_head: HeadModel) -> None:
    """10,000 unrotated gray Gaussians of opacity 0.1 on random triangles, or half of what is allowed."""
    rows = make(scene_of(toy_capture, toy_head)).rows
    assert len(rows) == 10_000 and {name: rows.rate(name) for name in RATES} == RATES
    assert not rows["distances"].any() and not rows["slides"].any() and not rows["sh"].any()
    assert torch.allclose(rows["opacity_logits"].sigmoid(), torch.full((10_000,), 0.1))
    assert rows["sh"].shape == (10_000, 1, 3) and bool((rows["quats"] == torch.tensor([1.0, 0, 0, 0])).all())
    counts = torch.bincount(rows["face"], minlength=len(toy_head.faces)).double()
    expected = 10_000 / len(toy_head.faces)
    assert ((counts - expected).abs() < 5 * expected**0.5).all()  # uniform over triangles, whatever their area
    weights = rows["weights"]
    assert (weights >= 0).all() and torch.allclose(weights.sum(1), torch.ones(10_000), atol=1e-6)
    # b0 ~ U(0, 1), b1 ~ U(0, 1 − b0), shuffled: E b² = (1/3 + 1/9 + 1/9) / 3; uniform in the triangle it is 1/6
    assert float(weights.square().mean()) == pytest.approx(5 / 27, abs=0.002)
    assert torch.allclose(weights.mean(0), torch.full((3,), 1 / 3), atol=0.01)
    assert len(make(scene_of(toy_capture, toy_head, most=400)).rows) == 200


def test_first_places_seen_are_even_by_area_and_in_view(scene: Scene) -> None:
    avatar = make(scene, first_places="seen", first_gaussians=200)
    seen = faces_seen(scene, avatar.poses)
    assert 0 < int(seen.sum()) < len(seen) and seen[avatar.rows["face"]].all()
    areas = avatar.rest.frames.areas * seen
    share = 200 * areas / areas.sum()
    assert ((torch.bincount(avatar.rows["face"], minlength=len(seen)) - share).abs() < 1).all()


def test_objective_by_hand(scene: Scene) -> None:
    """L1 + 10 MSE on a random background + 4 · mean of large and thin scales, in quarter meters (Eq. 9, 10, code)."""
    avatar = make(scene)
    with torch.no_grad():
        avatar.rows["log_scales"].fill_(math.log(0.0005))
        avatar.rows["log_scales"][7] = torch.tensor([0.006, 0.0005, 0.001]).log()
        avatar.rows["log_scales"][8] = torch.tensor([0.006, 0.001, 0.001]).log()
    frame, rendering = drawn(avatar)
    terms = avatar.losses(frame, rendering, 3)
    color = torch.rand(3, generator=seeded(scene.seed, 5, 3))
    other = rasterize(avatar.gaussians(frame.drive), frame.camera, color).image
    target = 0.3 * frame.alpha + color * (1 - frame.alpha)
    assert set(terms) == {"l1", "mse", "scaling"}
    assert torch.allclose(terms["l1"], (other - target).abs().mean(), rtol=1e-4)
    assert torch.allclose(terms["mse"], 10 * (other - target).square().mean(), rtol=1e-4)
    face = avatar.rows["face"][7]
    ratio = (avatar.rest.posed(avatar.head.vertices(frame.drive)).areas[face] + 6.25e-6) / (
        avatar.rest.frames.areas[face] + 6.25e-6
    )
    assert torch.allclose(terms["scaling"], 4 * 0.006 * ratio, rtol=1e-4)
    assert not torch.allclose(terms["l1"], avatar.losses(frame, rendering, 4)["l1"])


def test_the_perceptual_loss_sees_the_foreground_only(scene: Scene) -> None:
    avatar = make(scene, perceptual_weight=1e-3)
    seen: list[torch.Tensor] = []

    def note(image: torch.Tensor, target: torch.Tensor, *_: Any) -> dict[str, torch.Tensor]:
        seen.extend((image, target))
        return {}

    avatar.perceptual = note  # type: ignore[assignment]
    note.crops = None  # type: ignore[attr-defined]
    frame, rendering = drawn(avatar)
    empty = dataclasses.replace(frame, alpha=torch.zeros_like(frame.alpha))
    avatar.losses(empty, rendering, 1)
    assert not seen[0].any() and not seen[1].any()


def test_gradients_reach_slides_only_where_they_are_lifted(scene: Scene) -> None:
    for walking, expected in (("lifted", True), ("off", False)):
        avatar = make(scene, walking=walking)
        frame, rendering = drawn(avatar)
        sum(avatar.losses(frame, rendering, 1).values(), torch.zeros(())).backward()
        gradient = avatar.rows["slides"].grad
        assert (gradient is not None and bool(gradient.any())) == expected
        assert avatar.rows["distances"].grad.any()


def trained_step(avatar: SplattingAvatar, step: int) -> None:
    frame, rendering = drawn(avatar)
    sum(avatar.losses(frame, rendering, step).values(), torch.zeros(())).backward()
    avatar.rows.optimizer.step()
    avatar.after_backward(rendering, step)
    avatar.rows.optimizer.zero_grad(set_to_none=True)


def test_walks_every_hundred_iterations_and_in_the_end_not_without_lifting(scene: Scene) -> None:
    avatar = make(scene)
    assert avatar.walk_interval == 100
    weights = avatar.rows["weights"].clone()
    trained_step(avatar, 99)
    assert avatar.rows["slides"].any() and torch.equal(avatar.rows["weights"], weights)
    trained_step(avatar, 100)
    assert not avatar.rows["slides"].any() and not torch.equal(avatar.rows["weights"], weights)
    off = make(scene, walking="off")
    for step in (99, 100):
        trained_step(off, step)
    assert torch.equal(off.rows["weights"], weights) and not off.rows["slides"].any()


def test_schedule_scales_and_short_trainings_keep_thirty_walks(toy_capture: Capture, toy_head: HeadModel) -> None:
    control = make(scene_of(toy_capture, toy_head)).density
    assert (control.start, control.stop, control.interval, control.reset_interval) == (600, 29_000, 100, 3_000)
    assert control.resetting and not control.keep_last and control.gradient == 2e-4
    assert control.grow_scale * control.extent == pytest.approx(0.005)  # 0.02 in the authors' unit
    assert control.prune_scale * control.extent == pytest.approx(0.05) and control.prune_opacity == 0.005
    short = make(scene_of(toy_capture, toy_head, 1_500)).density
    assert (short.start, short.stop, short.resetting) == (30, 1_450, False)
    scenes = {steps: scene_of(toy_capture, toy_head, steps) for steps in (300, 1_500, 6_000, 60_000)}
    assert [interval(100, Config(), one) for one in scenes.values()] == [10, 20, 20, 200]


def test_rates_of_places_fall_to_a_hundredth(scene: Scene) -> None:
    avatar = make(scene)
    _, rendering = drawn(avatar)
    for step, factor in ((0, 1.0), (15_000, 0.1), (30_000, 0.01)):
        avatar.after_backward(rendering, step)
        assert avatar.rows.rate("distances") == pytest.approx(4e-5 * factor)
        assert avatar.rows.rate("slides") == pytest.approx(1.6e-4 * factor)
        assert avatar.rows.rate("log_scales") == 5e-3 and int(avatar.steps_done) == step


def test_variants_are_the_public_code_and_two_ablations() -> None:
    code = registry.load("splatting_avatar_code").config("paper")
    assert (code.walking, code.scale_by, code.canonical) == ("off", "log", "first")
    assert registry.load("splatting_avatar_without_walk").config("fast").walking == "off"
    assert registry.load("splatting_avatar_without_area").config("fast").scale_by == "none"
    own = registry.load("splatting_avatar").config("fast")
    assert (own.walking, own.scale_by, own.canonical) == ("lifted", "area", "neutral")


def test_rest_is_the_neutral_head_or_the_first_frame(scene: Scene) -> None:
    assert torch.equal(make(scene).rest.vertices, scene.head.neutral())
    first = make(scene, canonical="first")
    assert torch.equal(first.rest.vertices, scene.head.vertices(scene.drives[0]))
    found = first.gaussians(scene.drives[0])
    assert torch.allclose(found.scales, first.rows["log_scales"].exp(), rtol=1e-4)


def test_moving_the_camera_or_the_head_is_the_same(scene: Scene) -> None:
    """All Gaussians moved by G look as from a camera moved by the inverse: Eq. 4 forward, not as printed."""
    avatar = make(scene)
    with torch.no_grad():
        avatar.rows["opacity_logits"].fill_(3.0)
        avatar.rows["log_scales"].add_(torch.randn(200, 3, generator=torch.Generator().manual_seed(0)) * 0.5)
        avatar.rows["sh"].copy_(torch.randn(200, 1, 3, generator=torch.Generator().manual_seed(1)))
    motion = rigid(axis_angle_to_matrix(torch.tensor([0.2, -0.4, 0.3])), torch.tensor([0.01, 0.02, -0.03]))
    drive, camera = scene.drives[4], scene.cameras[4]
    with torch.no_grad():
        still = rasterize(
            avatar.gaussians(drive),
            dataclasses.replace(camera, world_to_camera=camera.world_to_camera @ motion),
            scene.background,
        ).image
        vertices = scene.head.vertices(drive)
        avatar._vertices = lambda _: vertices @ motion[:3, :3].T + motion[:3, 3]  # type: ignore[method-assign]
        moved = rasterize(avatar.gaussians(drive), camera, scene.background).image
    assert torch.allclose(still, moved, atol=1e-4)


def test_a_head_whose_triangles_are_all_apart_trains(scene: Scene) -> None:
    """Every edge is a wall."""
    head = scene.head
    names = ("template", "expression_basis", "pose_basis", "eyelid_basis", "skinning_weights")
    corners = head.faces.flatten()
    apart = dataclasses.replace(
        head,
        **{name: getattr(head, name)[corners] for name in names},
        joint_regressor=head.joint_regressor[:, corners] / head.joint_regressor[:, corners].sum(1, keepdim=True),
        faces=torch.arange(len(corners)).view(-1, 3),
        regions={},
    )
    avatar = make(dataclasses.replace(scene, head=apart, steps=300), walk_rate=0.05, density_gradient=1e-7)
    for step in range(1, 25):
        trained_step(avatar, step)
    rows = avatar.rows
    assert (rows["weights"] >= 0).all() and all(bool(values.isfinite().all()) for values in rows.columns().values())
    assert (rows["weights"] == 0).any() and len(rows) > 200
