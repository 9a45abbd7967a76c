"""GGAvatar's equations by number, each against its printed form written out here (docs/paper.md has the map).

Also covers `ggavatar/gaussians/initialization.py`.
"""

from __future__ import annotations

import dataclasses
import math
from typing import Any

import pytest
import torch
from scipy.spatial.transform import Rotation

from ggavatar.core import Camera, Drive, Frame, Gaussians, Rendering
from ggavatar.data.scene import Scene
from ggavatar.gaussians.binding import bind
from ggavatar.gaussians.offsets import Offsets, refine
from ggavatar.geometry.transforms import matrix_to_quaternion, quaternion_to_matrix
from ggavatar.geometry.triangles import triangle_frames
from ggavatar.head.model import HeadModel
from ggavatar.losses.dssim import dssim
from ggavatar.losses.terms import l1, log_scale_regularizer, position_regularizer
from ggavatar.methods.ggavatar import Config, GGAvatar, build, density_control, position_rate
from ggavatar.networks.fields import Box, HashTriplane, HashTriplaneConfig
from ggavatar.networks.morph_adjuster import AdjusterConfig, BasisAdjuster
from ggavatar.optim.schedules import PAPER_STEPS
from ggavatar.render.reference import rasterize
from ggavatar.training import registry
from ggavatar.training.plan import preset

WHITE = torch.ones(3)


def draw(*shape: int, seed: int = 0) -> torch.Tensor:
    return torch.randn(*shape, generator=torch.Generator().manual_seed(seed), dtype=torch.float64)


def small_head() -> HeadModel:
    """An octahedron with three expressions and FLAME's joints."""
    points = torch.tensor([[1.0, 0, 0], [-1, 0, 0], [0, 1, 0], [0, -1, 0], [0, 0, 1], [0, 0, -1]]) * 0.1
    faces = torch.tensor([[0, 2, 4], [2, 1, 4], [1, 3, 4], [3, 0, 4], [2, 0, 5], [1, 2, 5], [3, 1, 5], [0, 3, 5]])
    weights = torch.zeros(6, 5)
    weights[:, 1] = 1.0
    return HeadModel(
        template=points, faces=faces, expression_basis=0.01 * draw(6, 3, 3).float(), pose_basis=torch.zeros(6, 3, 0),
        eyelid_basis=torch.zeros(6, 3, 2), joint_regressor=torch.full((5, 6), 1 / 6), skinning_weights=weights,
        parents=(-1, 0, 1, 1, 1), joint_names=("root", "neck", "jaw", "left_eye", "right_eye"), version="octahedron",
    )  # fmt: skip


def small_scene(steps: int = PAPER_STEPS) -> Scene:
    return Scene(small_head(), (), (), WHITE, steps)


def camera(size: int = 24) -> Camera:
    view = torch.diag(torch.tensor([1.0, -1, -1, 1]))
    view[2, 3] = 0.7
    return Camera(torch.tensor([[2.0 * size, 0, size / 2], [0, 2.0 * size, size / 2], [0, 0, 1]]), view, size, size)


def drive_of(avatar: GGAvatar, seed: int = 1) -> Drive:
    neutral = avatar.head.neutral_drive()
    return dataclasses.replace(neutral, expression=draw(3, seed=seed).float())


def at_step(avatar: GGAvatar, step: int) -> GGAvatar:
    avatar.steps_done.fill_(step)
    return avatar


def stirred(avatar: GGAvatar) -> GGAvatar:
    """The avatar with random rows and a last layer that is not zero, so that nothing holds by accident."""
    with torch.no_grad():
        for number, name in enumerate(("means", "quats", "log_scales", "opacity_logits", "sh")):
            avatar.rows[name].add_(0.3 * draw(*avatar.rows[name].shape, seed=number).float())
        if avatar.adjuster is not None:
            avatar.adjuster.last_weight.copy_(0.1 * draw(*avatar.adjuster.last_weight.shape, seed=9))
            avatar.adjuster.last_bias.copy_(0.1 * draw(*avatar.adjuster.last_bias.shape, seed=10))
    return avatar


def test_eq_1_2_3_splatting_of_two_gaussians_by_hand() -> None:
    """G(x) = exp(−½ dᵀ Σ⁻¹ d), Σ = R S Sᵀ Rᵀ, C = Σ c α Π (1 − α), at the pixel where both are centered."""
    size, depth = 25, 1.0
    eye = Camera(torch.tensor([[40.0, 0, 12.5], [0, 40.0, 12.5], [0, 0, 1]]), torch.eye(4), size, size)
    means = torch.tensor([[0.0, 0, depth], [0.0, 0, 2 * depth]])
    scales = torch.tensor([[0.05, 0.02, 0.01], [0.1, 0.1, 0.1]])
    turn = torch.from_numpy(Rotation.from_rotvec([0, 0, 0.5]).as_matrix()).float()
    quats = torch.stack((matrix_to_quaternion(turn), torch.tensor([1.0, 0, 0, 0])))
    opacities, colors = torch.tensor([0.6, 0.9]), torch.tensor([[1.0, 0, 0], [0, 1.0, 0]])
    drawn = rasterize(Gaussians(means, quats, scales, opacities, colors), eye, torch.tensor([0.0, 0, 1]))
    centre = drawn.image[12, 12]
    assert torch.allclose(centre, torch.tensor([0.6, 0.4 * 0.9, 0.4 * 0.1]), atol=1e-5)
    sigma = turn @ torch.diag(scales[0] ** 2) @ turn.T
    spread = 40.0**2 * sigma[:2, :2] + 0.3 * torch.eye(2)
    offset = torch.tensor([3.0, 1.0])
    alpha = 0.6 * torch.exp(-0.5 * offset @ torch.linalg.inv(spread) @ offset)
    assert torch.allclose(drawn.image[13, 15, 0], alpha, atol=1e-5)


def test_eq_4_rotation_has_edge_normal_and_their_product_as_columns() -> None:
    vertices, faces = draw(300, 3), torch.arange(300).view(100, 3)
    frames = triangle_frames(vertices, faces)
    v0, v1, v2 = vertices[faces].unbind(1)
    n0 = torch.nn.functional.normalize(v1 - v0, dim=-1)
    n1 = torch.nn.functional.normalize(torch.linalg.cross(v1 - v0, v2 - v0), dim=-1)
    assert torch.allclose(frames.rotations, torch.stack((n0, n1, torch.linalg.cross(n0, n1)), dim=-1))
    assert torch.allclose(frames.centers, (v0 + v1 + v2) / 3)


def test_eq_5_scale_is_an_edge_and_the_height_over_it() -> None:
    """|n2·a21| = |n2·a20| is the height over a10, hence A1; S = mean(|a10|, 2·area / |a10|)."""
    vertices, faces = draw(300, 3), torch.arange(300).view(100, 3)
    frames = triangle_frames(vertices, faces)
    v0, v1, v2 = vertices[faces].unbind(1)
    n2 = frames.rotations[..., 2]
    assert torch.allclose((n2 * (v2 - v1)).sum(-1).abs(), (n2 * (v2 - v0)).sum(-1).abs())
    edge, area = (v1 - v0).norm(dim=-1), torch.linalg.cross(v1 - v0, v2 - v0).norm(dim=-1) / 2
    assert torch.allclose(frames.scales, (edge + 2 * area / edge) / 2)


def test_eq_6_7_8_local_to_global() -> None:
    """r' = R r0, μ' = S R μ0 + M, s' = S s0; equation 6 as rotation matrices (A3)."""
    vertices, faces = draw(30, 3), torch.arange(30).view(10, 3)
    frames, face = triangle_frames(vertices, faces), torch.tensor([3, 3, 0, 9])
    means, quats, logs = draw(4, 3, seed=1), draw(4, 4, seed=2), draw(4, 3, seed=3)
    placed = bind(means, quats, logs, face, frames)
    turned = torch.stack([frames.rotations[f] @ mean for f, mean in zip(face, means, strict=True)])
    assert torch.allclose(placed.means, frames.scales[face, None] * turned + frames.centers[face])
    assert torch.allclose(quaternion_to_matrix(placed.quats), frames.rotations[face] @ quaternion_to_matrix(quats))
    assert torch.allclose(placed.scales, frames.scales[face, None] * logs.exp())


def make_adjuster() -> BasisAdjuster:
    generator = torch.Generator().manual_seed(0)
    field = HashTriplane(HashTriplaneConfig(levels=4, log2_size=8, finest=64), Box((0.0, 0.0, 0.0), 0.4), generator)
    adjuster = BasisAdjuster(field, 7, AdjusterConfig(latent=5, hidden=16), generator)
    with torch.no_grad():
        adjuster.last_weight.copy_(draw(*adjuster.last_weight.shape))
        adjuster.last_bias.copy_(draw(*adjuster.last_bias.shape, seed=1))
    return adjuster


def test_eq_9_10_11_contraction_equals_the_explicit_product() -> None:
    """Δμ, Δr, Δs = W·f with W = F_H(H³(x)) built in full and f = F_ψθ(ψ, θ)."""
    adjuster, x, condition = make_adjuster(), 0.1 * draw(50, 3).float(), draw(7).float()
    basis, latent = adjuster.basis(x), adjuster.latent(condition)
    assert basis.shape == (50, 10, 5) and latent.shape == (5,)
    explicit = basis @ latent
    found = adjuster(x, condition)
    assert torch.allclose(found.rows, explicit, atol=1e-5) and found.colors is None
    assert torch.equal(torch.cat((found.means, found.rotations, found.log_scales), dim=-1), found.rows)


def test_eq_9_cached_equals_direct() -> None:
    adjuster, x, condition = make_adjuster(), 0.1 * draw(50, 3).float(), draw(7).float()
    kept = adjuster.offsets(adjuster.cache(x), adjuster.latent(condition))
    assert torch.allclose(kept.means, adjuster(x, condition).means, atol=1e-6)


def offsets(count: int, seed: int = 0) -> Offsets:
    return Offsets(draw(count, 10, seed=seed))


def test_eq_12_refined_plus() -> None:
    """μ' + 0.01 Δμ, unit((1,0,0,0) + Δr) r', s'·exp(Δs) (A4–A6)."""
    means, quats, scales = (
        draw(9, 3),
        torch.nn.functional.normalize(draw(9, 4, seed=2), dim=-1),
        draw(9, 3, seed=3).exp(),
    )
    change = offsets(9, seed=4)
    refined = refine(means, quats, scales, change)
    identity = torch.tensor([1.0, 0, 0, 0], dtype=torch.float64)
    turn = quaternion_to_matrix(identity + change.rotations)
    assert torch.allclose(refined.means, means + 0.01 * change.means)
    assert torch.allclose(quaternion_to_matrix(refined.quats), turn @ quaternion_to_matrix(quats))
    assert torch.allclose(refined.scales, scales * change.log_scales.exp())


def test_eq_12_does_not_depend_on_the_sign_of_the_quaternion() -> None:
    """Matrix to quaternion flips signs at branch borders; the product is immune, addition is not (A4)."""
    means, quats, scales, change = draw(9, 3), draw(9, 4, seed=2), draw(9, 3).exp(), offsets(9)

    def turned(sign: int, rotation: Any) -> torch.Tensor:
        unit = sign * torch.nn.functional.normalize(quats, dim=-1)
        return quaternion_to_matrix(refine(means, unit, scales, change, rotation=rotation).quats)

    assert torch.allclose(turned(1, "product"), turned(-1, "product"))
    assert not torch.allclose(turned(1, "add"), turned(-1, "add"), atol=1e-2)


def test_eq_13_to_16_every_term_with_its_weight() -> None:
    avatar = at_step(stirred(build(dataclasses.replace(Config(), perceptual_weight=0.0), small_scene())), 6_000)
    image, target = torch.rand(24, 24, 3), torch.rand(24, 24, 3)
    radii = torch.tensor([1.0, 0, 2, 3, 0, 1, 1, 1])
    drawn = Rendering(image, image[..., :1], image[..., :1], torch.zeros(8, 2), radii)
    frame = Frame(drive_of(avatar), camera(), target, image[..., :1])
    terms = avatar.losses(frame, drawn, 6_001)
    seen, means, scales = radii > 0, avatar.rows["means"], avatar.rows["log_scales"].exp()
    assert torch.allclose(terms["l1"], 0.8 * (image - target).abs().mean())
    assert torch.allclose(terms["dssim"], 0.2 * dssim(image, target))
    position = torch.relu(means.norm(dim=-1) - 1.0)[seen].mean()
    scale = torch.relu(scales - 0.6).norm(dim=-1)[seen].mean()
    assert torch.allclose(terms["position"], 0.01 * position) and torch.allclose(terms["scale"], 1.0 * scale)
    assert scale > 0 and set(terms) == {"l1", "dssim", "position", "scale"}
    assert float(l1(image, target)) > 0 and float(dssim(target, target)) == pytest.approx(0, abs=1e-6)
    assert torch.allclose(position_regularizer(means, seen), position)
    assert torch.allclose(log_scale_regularizer(avatar.rows["log_scales"], seen), scale)


def test_eq_16_perceptual_loss_joins_after_the_neutral_phase_on_the_whole_image(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    from ggavatar.losses import vgg_term

    class Stub(torch.nn.Module):
        name = "stub"

        def forward(self, image: torch.Tensor, target: torch.Tensor) -> torch.Tensor:
            assert image.shape == (24, 24, 3)
            return torch.tensor(5.0)

    monkeypatch.setattr(vgg_term, "perceptual_loss", lambda features: Stub())
    avatar = build(Config(), small_scene())
    image = torch.rand(24, 24, 3)
    drawn = Rendering(image, image[..., :1], image[..., :1], torch.zeros(8, 2), torch.ones(8))
    frame = Frame(drive_of(avatar), camera(), image, image[..., :1])
    assert "perceptual" not in at_step(avatar, 4_999).losses(frame, drawn, 5_000)
    assert float(at_step(avatar, 5_000).losses(frame, drawn, 5_001)["perceptual"]) == pytest.approx(0.02 * 5.0)


def test_first_rows_are_one_gaussian_per_triangle_at_its_centroid() -> None:
    avatar = build(Config(), small_scene())
    gaussians, frames = avatar.gaussians(drive_of(avatar)), avatar.neutral_local_frames
    assert torch.allclose(gaussians.means, frames.centers)
    assert torch.allclose(gaussians.scales, frames.scales[:, None].expand(8, 3))
    assert torch.allclose(gaussians.opacities, torch.full((8,), 0.1)) and gaussians.sh_degree == 0
    assert avatar.rows["face"].tolist() == list(range(8))


def test_neutral_phase_ignores_the_expression_and_ends_after_5000() -> None:
    avatar = build(Config(), small_scene())
    smile, frown = drive_of(avatar, 1), drive_of(avatar, 2)
    at_step(avatar, 4_999)
    assert torch.equal(avatar.gaussians(smile).means, avatar.gaussians(frown).means)
    at_step(avatar, 5_000)
    assert not torch.allclose(avatar.gaussians(smile).means, avatar.gaussians(frown).means, atol=1e-4)


def test_neutral_positions_are_those_of_the_neutral_mesh() -> None:
    """ψ = 0, identity rotations: x of Eq. 9 equals μ' of Eq. 7."""
    avatar = at_step(stirred(build(dataclasses.replace(Config(), adjuster=False), small_scene())), 6_000)
    assert torch.allclose(avatar.gaussians(avatar.head.neutral_drive()).means, avatar._neutral_positions(), atol=1e-7)


def test_adjuster_starts_as_the_identity() -> None:
    """Right after iteration 5000 the adjuster changes nothing; only the mesh moves (A7)."""
    scene, drive = small_scene(), None
    with_it = at_step(build(Config(), scene), 5_000)
    without = at_step(build(dataclasses.replace(Config(), adjuster=False), scene), 5_000)
    drive = drive_of(with_it)
    for field in ("means", "scales", "opacities"):
        assert torch.allclose(
            getattr(with_it.gaussians(drive), field), getattr(without.gaussians(drive), field), atol=1e-7
        )
    turns = [quaternion_to_matrix(avatar.gaussians(drive).quats) for avatar in (with_it, without)]
    assert torch.allclose(turns[0], turns[1], atol=1e-6)


def test_similarity_of_the_mesh_scales_the_avatar() -> None:
    """Twice the head: μ' − M and s' double."""
    scene = small_scene()
    head = dataclasses.replace(scene.head, template=2 * scene.head.template)
    one, two = (
        stirred(build(dataclasses.replace(Config(), adjuster=False), dataclasses.replace(scene, head=h)))
        for h in (scene.head, head)
    )
    drive = drive_of(one)
    assert torch.allclose(two.gaussians(drive).means, 2 * one.gaussians(drive).means, atol=1e-6)
    assert torch.allclose(two.gaussians(drive).scales, 2 * one.gaussians(drive).scales, atol=1e-6)


def test_rigid_motion_of_the_mesh_is_inverse_camera_motion() -> None:
    scene = small_scene()
    avatar = stirred(build(dataclasses.replace(Config(), adjuster=False, sh_degree=0), scene))
    turn = torch.from_numpy(Rotation.from_rotvec([0.1, 0.3, -0.2]).as_matrix()).float()
    turned_head = dataclasses.replace(scene.head, template=scene.head.template @ turn.T)
    turned = stirred(build(avatar.config, dataclasses.replace(scene, head=turned_head)))
    eye, drive = camera(), drive_of(avatar)
    motion = torch.eye(4)
    motion[:3, :3] = turn
    moved_eye = dataclasses.replace(eye, world_to_camera=eye.world_to_camera @ motion)
    still = rasterize(avatar.gaussians(drive), moved_eye, WHITE)
    moving = rasterize(turned.gaussians(drive), eye, WHITE)
    assert torch.allclose(still.image, moving.image, atol=1e-4) and still.alpha.max().item() > 0.05


def test_printed_schedule() -> None:
    """Sec. 3.5: rates 5e-3, ×0.01 by 60,000; density from 500 to 60,000 every 100; resets every 3,000; degree to 3."""
    config, scene = Config(), small_scene()
    plan = density_control(config, scene)
    assert (plan.start, plan.stop, plan.interval, plan.reset_interval, plan.resetting) == (
        500,
        60_000,
        100,
        3_000,
        True,
    )
    rates = [position_rate(config, scene, step) for step in (0, 60_000, 120_000)]
    assert rates == pytest.approx([5e-3, 5e-5, 5e-5])
    avatar = build(config, scene)
    assert avatar.rows.rate("log_scales") == 5e-3
    assert [at_step(avatar, step)._sh_degree() for step in (999, 1_000, 2_000, 3_000, 90_000)] == [0, 1, 2, 3, 3]
    groups = [(group["lr"], group["betas"]) for group in avatar.optimizers()[1].param_groups]
    assert groups == [(1e-4, (0.9, 0.999)), (5e-3, (0.9, 0.999))]
    assert preset("paper", "cpu").steps == 120_000 and registry.load("ggavatar").config("paper") == config


def test_short_trainings_keep_rounds_and_drop_resets() -> None:
    for steps in (1_000, 3_000, 6_000, 30_000):
        plan = density_control(Config(), small_scene(steps))
        assert plan.interval >= 10 and plan.reset_interval >= 10 * plan.interval
        assert plan.resetting == (steps >= 12_000)
    assert (plan.stop - plan.start) // plan.interval >= 30


def test_table_2_ablations() -> None:
    """Each variant lacks what it is named after and nothing else."""
    scene = small_scene()
    methods = {
        name: registry.load(f"ggavatar_{name}")
        for name in ("without_adjuster", "without_triplane", "without_lbs", "without_initialization")
    }
    avatars = {name: stirred(method.build(method.config("paper"), scene)) for name, method in methods.items()}
    drive, neutral = drive_of(avatars["without_lbs"]), avatars["without_lbs"].head.neutral_drive()
    assert avatars["without_adjuster"].adjuster is None and len(avatars["without_adjuster"].optimizers()) == 1
    assert avatars["without_triplane"].adjuster is not None and avatars["without_triplane"].adjuster.field.width == 63
    assert not at_step(avatars["without_initialization"], 0).is_neutral
    still = at_step(avatars["without_lbs"], 6_000)
    faces = [still._local_frames(which).centers for which in (drive, neutral)]
    assert torch.equal(*faces)
    assert not torch.allclose(still.gaussians(drive).means, still.gaussians(neutral).means, atol=1e-5)


def test_opacity_reset_is_in_the_avatar_at_3000() -> None:
    avatar = build(Config(), small_scene())
    with torch.no_grad():
        avatar.rows["opacity_logits"].fill_(2.0)
    means2d = torch.zeros(8, 2, requires_grad=True)
    means2d.grad = torch.zeros(8, 2)
    drawn = Rendering(torch.zeros(4, 4, 3), torch.zeros(4, 4, 1), torch.zeros(4, 4, 1), means2d, torch.ones(8))
    avatar.after_backward(drawn, 2_999)
    assert avatar.rows["opacity_logits"].min().item() == 2.0
    avatar.after_backward(drawn, 3_000)
    assert avatar.rows["opacity_logits"].sigmoid().max().item() <= 0.01 + 1e-7
    assert math.isclose(avatar.rows.rate("means"), position_rate(avatar.config, avatar.scene, 3_000))
