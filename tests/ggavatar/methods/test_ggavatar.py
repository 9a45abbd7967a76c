"""How GGAvatar's parts are wired: what is optimized how, what changes at the end of the neutral phase, what is lost.

The equations are in `tests/test_paper.py`, the constants in `test_published_constants.py`.
"""

from __future__ import annotations

import dataclasses
from typing import Any

import pytest
import torch
from torch import Tensor

from ggavatar.core import Camera, Frame, Rendering
from ggavatar.data.capture import Capture
from ggavatar.data.frames import drives_and_cameras
from ggavatar.data.scene import Scene
from ggavatar.head.model import HeadModel
from ggavatar.head.region_boxes import RegionBoxes
from ggavatar.losses import vgg_term
from ggavatar.methods import ggavatar, ggavatar_plus
from ggavatar.methods.ggavatar import Config, GGAvatar
from ggavatar.training import registry

C0 = 0.28209479177387814


@pytest.fixture
def scene(toy_capture: Capture, toy_head: HeadModel) -> Scene:
    """A training as long as the paper's, before a gray background."""
    drives, cameras = drives_and_cameras(toy_capture, toy_head, "cpu")
    return Scene(toy_head, tuple(drives), tuple(cameras), torch.full((3,), 0.5), steps=120_000, max_gaussians=400)


def at_step(avatar: Any, step: int) -> Any:
    getattr(avatar, "avatar", avatar).steps_done.fill_(step)
    return avatar


def rendering_of(image: Tensor, alpha: Tensor, count: int) -> Rendering:
    means2d = torch.zeros(count, 2, requires_grad=True)
    means2d.grad = torch.zeros(count, 2)
    return Rendering(image, alpha, alpha, means2d, torch.ones(count))


def frame_of(scene: Scene, image: Tensor, alpha: Tensor) -> Frame:
    return Frame(scene.drives[0], scene.cameras[0], image, alpha)


def test_rates_and_epsilons_belong_to_their_parameters(scene: Scene) -> None:
    """Sec. 3.5 and A31: 3DGS' Adam with ε 1e-15 for rows and tables, torch's 1e-8 for the networks; β (0.9, 0.999)."""
    avatar = ggavatar.build(Config(), scene)
    assert avatar.adjuster is not None
    rows, adjuster = avatar.optimizers()
    assert {group["name"]: group["lr"] for group in rows.param_groups} == pytest.approx(
        {"means": 5e-3, "quats": 1e-3, "log_scales": 5e-3, "opacity_logits": 0.05, "sh": 2.5e-3, "sh_rest": 1.25e-4}
    )
    assert {group["eps"] for group in rows.param_groups} == {1e-15}
    settings = {}
    for group in adjuster.param_groups:
        settings.update({id(parameter): (group["lr"], group["eps"], group["betas"]) for parameter in group["params"]})
    for name, parameter in avatar.adjuster.named_parameters():
        expected = (5e-3, 1e-15, (0.9, 0.999)) if name == "field.tables" else (1e-4, 1e-8, (0.9, 0.999))
        assert settings[id(parameter)] == expected, name


def test_coverage_is_compared_with_the_mask(scene: Scene) -> None:
    """Weight times mean |alpha − mask|, by hand on an image half covered."""
    avatar = at_step(ggavatar.build(Config(alpha_weight=0.1, perceptual_weight=0.0), scene), 0)
    alpha, mask = torch.full((48, 48, 1), 0.2), torch.zeros(48, 48, 1)
    mask[:12] = 1.0
    image = torch.zeros(48, 48, 3)
    terms = avatar.losses(frame_of(scene, image, mask), rendering_of(image, alpha, len(avatar.rows)), 1)
    assert terms["alpha"].item() == pytest.approx(0.1 * (0.25 * 0.8 + 0.75 * 0.2), rel=1e-4)
    paper = ggavatar.build(Config(perceptual_weight=0.0), scene)
    assert "alpha" not in paper.losses(frame_of(scene, image, mask), rendering_of(image, alpha, len(paper.rows)), 1)


class Features(torch.nn.Module):
    """A perceptual loss of 3, whatever it sees."""

    name = "stub"

    def forward(self, image: Tensor, target: Tensor) -> Tensor:
        return torch.tensor(3.0)


@pytest.fixture
def features(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(vgg_term, "perceptual_loss", lambda *_, **__: Features())


@pytest.mark.usefixtures("features")
@pytest.mark.parametrize(
    ("method", "steps", "last_without"),
    [
        ("ggavatar", 120_000, 5_000),
        ("ggavatar_without_initialization", 120_000, 0),
        ("gaussian_avatars", 120_000, 5_000),
        ("gaussian_avatars", 12_000, 500),
        ("flash_avatar", 150_000, 15_000),
    ],
)
def test_perceptual_loss_starts_after_so_many_iterations(
    scene: Scene, method: str, steps: int, last_without: int
) -> None:
    """GGAvatar Sec. 3.5 (5,000 of 120,000), also for Sec. 4.2's baseline; FlashAvatar's code (15,000 of 150,000)."""
    loaded = registry.load(method)
    settings = ["texels=24"] if method == "flash_avatar" else []
    avatar = loaded.build(loaded.config("paper", settings), dataclasses.replace(scene, steps=steps))
    image, alpha = torch.full((48, 48, 3), 0.5), torch.ones(48, 48, 1)

    def terms(step: int) -> Any:
        at_step(avatar, step - 1)
        return avatar.losses(frame_of(scene, image, alpha), rendering_of(image, alpha, len(avatar.rows)), step)

    weight = 0.005 if method == "flash_avatar" else 0.02
    if last_without:
        assert "perceptual" not in terms(1) and "perceptual" not in terms(last_without)
    assert terms(last_without + 1)["perceptual"].item() == pytest.approx(weight * 3)


@pytest.mark.usefixtures("features")
@pytest.mark.parametrize("white", [True, False])
@pytest.mark.parametrize("method", ["ggavatar", "gaussian_avatars"])
def test_opacities_are_reset_at_500_on_white_only(scene: Scene, method: str, white: bool) -> None:
    """3DGS resets at the first iteration of density control if the background is white, then every 3,000."""
    loaded = registry.load(method)
    background = torch.ones(3) if white else torch.full((3,), 0.5)
    avatar = loaded.build(loaded.config("paper"), dataclasses.replace(scene, background=background))
    image, alpha = torch.zeros(48, 48, 3), torch.zeros(48, 48, 1)
    reset = []
    for step in (400, 500, 600, 2_900, 3_000, 3_100, 6_000, 57_000, 60_000):
        with torch.no_grad():
            avatar.rows["opacity_logits"].fill_(2.0)
        avatar.after_backward(rendering_of(image, alpha, len(avatar.rows)), step)
        if avatar.rows["opacity_logits"].sigmoid().max().item() < 0.0101:
            reset.append(step)
    assert reset == ([500] if white else []) + [3_000, 6_000, 57_000]


def test_density_control_counts_in_meters_and_within_the_budget(scene: Scene) -> None:
    """Rows of 1.5 triangles are under 1 cm of the scene's meter on the toy's small triangles, and are split on large.

    All rows have a large gradient; the room is used up, and no more.
    """
    big = dataclasses.replace(scene.head, template=10 * scene.head.template)
    for head, is_split in ((scene.head, False), (big, True)):
        avatar = ggavatar.build(Config(), dataclasses.replace(scene, head=head))
        with torch.no_grad():
            avatar.rows["log_scales"].fill_(-2.0)
            avatar.rows["opacity_logits"].fill_(2.0)
        drawn = rendering_of(torch.zeros(48, 48, 3), torch.zeros(48, 48, 1), len(avatar.rows))
        assert drawn.means2d.grad is not None
        drawn.means2d.grad.fill_(1.0)
        count = len(avatar.rows)
        avatar.after_backward(drawn, 600)
        assert len(avatar.rows) == 2 * count <= 400
        assert bool((avatar.rows["log_scales"] < -2.0).any()) == is_split
        for step in (700, 800):
            drawn = rendering_of(torch.zeros(48, 48, 3), torch.zeros(48, 48, 1), len(avatar.rows))
            assert drawn.means2d.grad is not None
            drawn.means2d.grad.fill_(1.0)
            avatar.after_backward(drawn, step)
        assert len(avatar.rows) == 400


@pytest.mark.parametrize(
    ("method", "length", "half_rate"),
    [
        ("ggavatar", 120_000, (30_000, 5e-4)),
        ("gaussian_avatars", 120_000, (30_000, 5e-4)),
        ("gaussian_blendshapes", 40_000, (15_000, 1.6e-5)),
    ],
)
@pytest.mark.parametrize("shorter", [1, 10])
def test_rates_and_degrees_follow_the_training(
    scene: Scene, method: str, length: int, half_rate: tuple[int, float], shorter: int
) -> None:
    """Rates fall log-linearly to 1 % (here a tenth, half-way); a degree of harmonics more every 1,000 iterations."""
    loaded = registry.load(method)
    avatar = loaded.build(loaded.config("paper"), dataclasses.replace(scene, steps=length // shorter))
    image, alpha = torch.zeros(48, 48, 3), torch.zeros(48, 48, 1)
    degrees = []
    for iteration in (990, 1_000, 2_000, 3_000, 9_000):
        avatar.after_backward(rendering_of(image, alpha, len(avatar.rows)), iteration // shorter)
        degrees.append(avatar.gaussians(scene.drives[0]).sh_degree)
    assert degrees == [0, 1, 2, 3, 3]
    step, rate = half_rate
    avatar.after_backward(rendering_of(image, alpha, len(avatar.rows)), step // shorter)
    assert avatar.rows.rate("means") == pytest.approx(rate)


@pytest.mark.parametrize("method", ["ggavatar", "ggavatar_plus", "gaussian_avatars", "flash_avatar"])
def test_short_trainings_start_in_the_colors_of_the_frames(scene: Scene, method: str) -> None:
    """A red person in all samples: red Gaussians; the published start is gray."""
    from ggavatar.render.reference import rasterize

    red = torch.tensor([1.0, 0.0, 0.0]).expand(48, 48, 3)
    frame = Frame(scene.drives[0], scene.cameras[0], red, torch.ones(48, 48, 1))
    sampled = dataclasses.replace(scene, samples=(frame,), rasterize=rasterize)
    loaded = registry.load(method)
    avatar = loaded.build(loaded.config("fast"), sampled)
    shown = 0.5 + C0 * getattr(avatar, "avatar", avatar).rows["sh"][:, 0]
    assert torch.allclose(shown, torch.tensor([1.0, 0.0, 0.0]).expand_as(shown), atol=1e-4)
    if method != "ggavatar_plus":
        settings = ["texels=24"] if method == "flash_avatar" else []
        gray = loaded.build(loaded.config("paper", settings), sampled).rows["sh"]
        assert (C0 * gray).abs().max() < 0.01


def plus(scene: Scene, **changes: Any) -> ggavatar_plus.GGAvatarPlus:
    config = dataclasses.replace(ggavatar_plus.Config(), perceptual_weight=0.0, **changes)
    return at_step(ggavatar_plus.build(config, scene), 6_000)


def test_regions_weigh_as_much_again_as_in_the_image_loss(scene: Scene, monkeypatch: pytest.MonkeyPatch) -> None:
    """1.0 × (1 − λ1) × L1 summed over the boxes per pixel of the image, in closed form, after the neutral phase."""
    monkeypatch.setattr(RegionBoxes, "of", lambda self, frame: [(10.0, 12.0, 19.0, 17.0)])
    image, target, alpha = torch.full((48, 48, 3), 0.75), torch.full((48, 48, 3), 0.5), torch.ones(48, 48, 1)
    avatar = plus(scene)
    drawn = rendering_of(image, alpha, len(avatar.avatar.rows))
    terms = avatar.losses(frame_of(scene, target, alpha), drawn, 6_001)
    assert terms["regions"].item() == pytest.approx(1.0 * 0.8 * 0.25 * (10 * 6) / (48 * 48))
    assert terms["l1"].item() == pytest.approx(0.8 * 0.25)
    at_step(avatar, 4_999)
    assert "regions" not in avatar.losses(frame_of(scene, target, alpha), drawn, 5_000)
    assert "regions" not in plus(scene, region_weight=0.0).losses(frame_of(scene, target, alpha), drawn, 6_001)


def test_coverage_of_plus_is_a_tenth_of_the_difference(scene: Scene) -> None:
    avatar = plus(scene)
    image, alpha, mask = torch.zeros(48, 48, 3), torch.full((48, 48, 1), 0.2), torch.ones(48, 48, 1)
    drawn = rendering_of(image, alpha, len(avatar.avatar.rows))
    assert avatar.losses(frame_of(scene, image, mask), drawn, 6_001)["alpha"].item() == pytest.approx(0.08, rel=1e-4)


def test_color_rows_count_in_tenths_of_srgb(scene: Scene) -> None:
    """A row of the basis that gives 1 for its color changes sRGB by 0.1, in this channel and no other."""
    avatar = plus(scene)
    adjuster, drive = avatar.avatar.adjuster, scene.drives[3]
    assert adjuster is not None
    with torch.no_grad():
        latent = adjuster.latent(avatar.avatar._condition(drive))
        before = avatar.gaussians(drive).colors
        adjuster.last_bias[11] = latent / latent.square().sum()
        after = avatar.gaussians(drive).colors
    change = C0 * (after - before)[:, 0]
    assert torch.allclose(change, torch.tensor([0.0, 0.1, 0.0]).expand_as(change), atol=1e-5)


def test_regions_are_boxes_of_mouth_and_eyes_in_the_image(scene: Scene) -> None:
    """The smallest box about the projected vertices of the region, px."""
    from ggavatar.head.region_boxes import region_boxes

    camera = Camera(torch.tensor([[50.0, 0, 24], [0, 60.0, 20], [0, 0, 1]]), torch.eye(4), 48, 48)
    template = scene.head.template.clone()
    template[:, 2] += 1.0
    head = dataclasses.replace(
        scene.head, template=template, regions={"mouth": torch.tensor([3, 20]), "scalp": torch.arange(5)}
    )
    frame = Frame(head.neutral_drive(), camera, torch.zeros(48, 48, 3), torch.ones(48, 48, 1))
    x, y, z = template[[3, 20]].unbind(-1)
    across, down = 50 * x / z + 24, 60 * y / z + 20
    (box,) = region_boxes(head, frame)
    assert box == pytest.approx([float(end) for end in (across.min(), down.min(), across.max(), down.max())], abs=1e-4)


def test_adjuster_looks_at_neutral_positions(scene: Scene) -> None:
    """Eq. 9: the field is asked at the Gaussians' places on the neutral head, whatever the expression."""
    avatar: GGAvatar = at_step(ggavatar.build(Config(), scene), 6_000)
    assert avatar.adjuster is not None
    asked: list[Tensor] = []
    forward = avatar.adjuster.forward
    avatar.adjuster.forward = lambda x, condition: asked.append(x) or forward(x, condition)  # type: ignore[method-assign]
    for drive in scene.drives[3:5]:
        avatar.gaussians(drive)
    assert torch.equal(*asked) and torch.allclose(asked[0], avatar.neutral_local_frames.centers, atol=1e-6)


def test_adjuster_waits_for_the_end_of_the_neutral_phase(scene: Scene) -> None:
    """Sec. 3.5: the adjuster joins after iteration 5,000; before, its offsets move nothing."""
    avatar: GGAvatar = ggavatar.build(Config(), scene)
    assert avatar.adjuster is not None
    with torch.no_grad():
        avatar.adjuster.last_bias.fill_(0.5)
        before, after = (at_step(avatar, step).gaussians(scene.head.neutral_drive()).means for step in (4_999, 5_000))
    assert torch.allclose(before, avatar.neutral_local_frames.centers, atol=1e-6)
    assert (after - before).norm(dim=1).min() > 1e-4


def test_neutral_phase_scales_with_the_training(scene: Scene) -> None:
    avatar = ggavatar.build(Config(), dataclasses.replace(scene, steps=12_000))
    assert [at_step(avatar, step).is_neutral for step in (0, 499, 500, 5_000)] == [True, True, False, False]
