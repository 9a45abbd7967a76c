"""Gaussian Blendshapes (Ma et al. 2024): neutral Gaussians and a linear difference per expression coefficient.

S. Ma, Y. Weng, T. Shao and K. Zhou, "3D Gaussian Blendshapes for Head Avatar Animation", SIGGRAPH 2024; implemented
from the paper with the constants of its public code. It is the fourth baseline because linear blendshapes of Gaussians
are the family for real-time use: a frame costs a weighted sum without a network, and animators know the rig.

    1. Neutral Gaussians lie on the neutral mesh; each is assigned to a triangle, but defined in head space.
    2. Every expression (and eyelid) coefficient has a blendshape of all properties: the mesh blendshape by deformation
       transfer, plus learned differences, blended linearly.
    3. Consistency: a learned difference is scaled by the displacement of the triangle in the mesh blendshape, so that
       Gaussians are static where the mesh is.
    4. The joints pose the result by linear blend skinning (Sec. 3.3). For meshes without teeth, upper and lower teeth
       are Gaussians inside a cylinder that follow head and jaw; eyes follow their joints.
    5. The loss has an image term, coverage against the mask, and the distance from the cylinder (Sec. 3.4).

Spherical harmonics are not rotated with the skin: the head pose is in the camera, and the remaining angles are small.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Literal

import torch
from jaxtyping import Float
from torch import Tensor
from torch.nn.functional import mse_loss, normalize

from ggavatar.core import Drive, Frame, Gaussians, Rendering
from ggavatar.data.scene import Scene
from ggavatar.gaussians.density_control import DensityControl, accumulate, scaled_schedule, statistics
from ggavatar.gaussians.spherical_harmonics import color_from_frames, degree_in_use, harmonics
from ggavatar.geometry.deformation_transfer import FaceDeformations, transfer_blendshapes
from ggavatar.geometry.surface_sampling import sample_surface
from ggavatar.geometry.transforms import quaternion_multiply
from ggavatar.head.head_pose import HeadPoses
from ggavatar.head.model import HeadModel
from ggavatar.head.mouth_interior import MouthCylinder
from ggavatar.head.region_boxes import RegionBoxes
from ggavatar.head.triangle_skinning import FaceSkinning, FaceTransforms
from ggavatar.losses.crop_sampler import CropSampler
from ggavatar.losses.dssim import image_terms
from ggavatar.losses.vgg import FeatureChoice
from ggavatar.losses.vgg_term import PerceptualTerm
from ggavatar.optim.parameters import Column, Rows
from ggavatar.optim.schedules import log_linear, scaled
from ggavatar.optim.seeding import seeded
from ggavatar.optim.step_counter import StepCounter

PROPERTIES = (3, 4, 3, 1)
"""Components of position, quaternion, scale and opacity in a difference; those of the harmonics follow."""


@dataclass(frozen=True)
class Config:
    """All settings of the method; the defaults are those of the authors. Iterations refer to `iterations`."""

    iterations: int = 40_000
    """Length of the training that all iteration constants refer to (public code)."""
    pose_on: Literal["camera", "neck"] = "camera"
    """What the head pose moves: the camera, as tracked, or the neck too, so that the torso stays still."""
    consistency: bool = True
    """Whether learned differences are scaled by the displacement of the mesh (Sec. 3.4)."""
    consistency_threshold: float = 0.004
    """Fraction of the largest displacement below which a triangle is static (public code: 0.1 × 0.237 mm of 5.7 mm)."""
    blendshapes: int = 50
    """Maximum number of blendshapes with learned differences per Gaussian, those that move it most (code)."""

    first_gaussians: int = 50_000
    """Initial Gaussians, spread evenly over the mesh; at most 0.6 of the maximum number (Sec. 4)."""
    mouth_gaussians: float = 0.1
    """Gaussians for the upper and for the lower teeth, each as a fraction of `first_gaussians` (public code)."""
    first_colors: Literal["grey", "frames"] = "grey"
    """Initial colors: `grey` (public code), or from a few training `frames`."""

    position_rate: float = 1.6e-4
    """Learning rate of neutral positions at the start, m (public code)."""
    position_decay: float = 0.01
    """Final position rate as a fraction of the initial one, reached at `position_iterations` (public code)."""
    position_iterations: int = 30_000
    """Iterations over which the position rate falls; constant afterwards (public code)."""
    scale_rate: float = 5e-3
    """Learning rate of the logarithms of scales (public code)."""
    rotation_rate: float = 1e-3
    """Learning rate of quaternions (public code)."""
    opacity_rate: float = 0.05
    """Learning rate of opacity logits (public code)."""
    color_rate: float = 2.5e-3
    """Learning rate of the constant spherical harmonic; the rate of the others is 1/20 of it (public code)."""
    difference_rate: float = 1.0
    """Factor on the next five rates, for trainings shorter than the authors' (ours)."""
    position_difference_rate: float = 3.2e-7
    """Learning rate of differences of positions, m (public code: 0.2 × 1.6e-6)."""
    scale_difference_rate: float = 5e-4
    """Learning rate of differences of logarithms of scales (public code: 0.1 of the neutral one's)."""
    rotation_difference_rate: float = 1e-4
    """Learning rate of differences of quaternions (public code: 0.1 of the neutral one's)."""
    opacity_difference_rate: float = 5e-5
    """Learning rate of differences of opacity logits (public code: 0.001 of the neutral one's)."""
    color_difference_rate: float = 1.25e-3
    """Learning rate of differences of all spherical harmonics (public code: 0.5 of the neutral one's)."""
    sh_degree: int = 3
    """Highest degree of the spherical harmonics, 0 to 3 (public code)."""
    sh_iterations: int = 1_000
    """Iterations between increments of the degree in use (public code)."""
    difference_sh_degree: int = 3
    """Highest degree of the spherical harmonics that have differences, at most `sh_degree` (public code)."""

    density_start: int = 500
    """Density control starts after this iteration (public code)."""
    density_stop: int = 15_000
    """Iteration at which density control ends (public code)."""
    density_interval: int = 100
    """Iterations between two rounds (public code); short trainings: 20 steps, or 10 to 20 for 30 rounds."""
    density_gradient: float = 1e-3
    """Mean gradient norm of projected centers from which a Gaussian grows, normalized device coordinates (code)."""
    density_ramp: bool = False
    """Whether the budget becomes available evenly over the rounds (for short trainings) or at once (3DGS)."""
    prune_iterations: int = 3_000
    """Iterations after which Gaussians above a tenth of the extent are removed; opacities are never reset (code)."""
    extent: float = 1.0
    """Extent of the scene, m (public code)."""

    dssim_share: float = 0.2
    """Weight of D-SSIM in the image loss; L1 has the rest (Sec. 3.4)."""
    alpha_weight: float = 10.0
    """Weight of the mean squared difference between coverage and mask (public code)."""
    mouth_weight: float = 100.0
    """Weight of the mean squared distance of teeth Gaussians from the mouth's cylinder, 1/m² (public code)."""
    perceptual_weight: float = 0.0
    """Weight of a VGG loss; the public code adds LPIPS on the data of NeRFBlendShape."""
    perceptual_features: FeatureChoice = "vgg16"
    """Features of the perceptual loss: `vgg16`, an untrained stand-in (`random`), or the `best` that can be had."""
    crop_side: int = 96
    """Side of a crop for the VGG loss, px (ours)."""
    crop_probability: float = 0.1
    """Fraction of the steps with a crop (ours)."""


TABLE_NOTES = (
    "spherical harmonics are not rotated with the skin",
    "no LPIPS loss, as on the authors' own data",
)
"""Deviations from the paper, which tables print as footnotes."""

SHORT_TRAINING: dict[str, Any] = {
    "perceptual_features": "best",
    "first_colors": "frames",
    "color_rate": 1e-2,
    "sh_degree": 1,
    "sh_iterations": 7_000,
    "difference_sh_degree": 0,
    "difference_rate": 5.0,
    "density_start": 1_600,
    "density_stop": 20_000,
    "density_gradient": 2e-4,
    "density_ramp": True,
}
"""Changes for trainings of a few thousand steps on a CPU, like `SHORT_TRAINING` of our method in `ggavatar.py`."""

VARIANTS: dict[str, dict[str, Any]] = {
    "without_consistency": {"consistency": False},
    "with_perceptual": {"perceptual_weight": 0.02},
}

PRESETS: dict[str, dict[str, Any]] = {"default": SHORT_TRAINING, "fast": SHORT_TRAINING, "paper": {}}


def build(config: Config, scene: Scene) -> GaussianBlendshapes:
    """The avatar before its first step."""
    avatar = GaussianBlendshapes(config, scene).to(scene.background.device)
    if config.first_colors == "frames":
        color_from_frames(avatar.rows, avatar.gaussians, scene)
    return avatar


class GaussianBlendshapes(StepCounter):
    """The avatar: rows of neutral Gaussians with their differences, and tables of the motion of each triangle."""

    def __init__(self, config: Config, scene: Scene) -> None:
        super().__init__()
        self.config, self.scene, self.head = config, scene, scene.head
        self.poses = HeadPoses.of(self.head, scene.drives)
        spreads = coefficient_spreads(self.head, scene.drives)
        moving = spreads > 0
        self.spreads = torch.where(moving, spreads, torch.ones_like(spreads))
        self.mouth = MouthCylinder.of(self.head)
        self.changes, self.skin = face_tables(self.head, self.spreads, teeth=self.mouth is not None)
        self.slots, self.strengths = strongest_blendshapes(self.changes.displacement * moving, config)
        self.units = difference_units(config).to(self.spreads)
        self.rows = initial_rows(config, scene, self.mouth, (len(self.units), self.slots.shape[1]))
        self.density = density_control(config, scene)
        crops = CropSampler(config.crop_side, config.crop_probability)
        self.boxes = RegionBoxes(self.head)
        self.perceptual = PerceptualTerm(
            config.perceptual_weight, crops, scene.seed, features=config.perceptual_features
        )
        self._cached: tuple[Tensor, Tensor] | None = None

    @property
    def triangles(self) -> int:
        """Number of triangles that rows may be bound to: those of the head, and two for the teeth."""
        return len(self.slots)

    def gaussians(self, drive: Drive) -> Gaussians:
        """The avatar posed by `drive`, in world space (Sec. 3.1, 3.3)."""
        rows, face = self.rows, self.rows["face"]
        coefficients = torch.cat((drive.expression, drive.eyelids)) / self.spreads
        with torch.no_grad():
            linear, offset, turn = self.changes.at(coefficients)
            skin = self._face_transforms(drive)
            shift = (skin.linear @ offset[:, :, None]).squeeze(-1) + skin.offset
            point, shift, turn = (skin.linear @ linear)[face], shift[face], turn[face]
            weights = (self.strengths * coefficients[self.slots])[face]
        moved, turned, grown, clearer, tinted = self._differences(weights)
        means = (point @ rows["means"][:, :, None] + skin.linear[face] @ moved[:, :, None]).squeeze(-1) + shift
        quats = quaternion_multiply(turn, normalize(rows["quats"], dim=-1)) + turned
        return Gaussians(
            means,
            quaternion_multiply(skin.quats[face], quats),
            (rows["log_scales"] + grown).exp(),
            (rows["opacity_logits"] + clearer.squeeze(-1)).sigmoid(),
            self._colors(tinted.unflatten(1, (-1, 3))),
            self._sh_degree(),
        )

    def losses(self, frame: Frame, rendering: Rendering, step: int) -> Mapping[str, Tensor]:
        """Image loss, coverage and the mouth's cylinder (Sec. 3.4), and the perceptual loss if configured."""
        config = self.config
        terms = {
            **image_terms(rendering.image, frame.image, config.dssim_share)._asdict(),
            "alpha": config.alpha_weight * mse_loss(rendering.alpha, frame.alpha),
        }
        if self.mouth is not None:
            teeth = self.mouth.outside(self.rows["means"])
            sets = [self.rows["face"] == len(self.head.faces) + which for which in (0, 1)]
            apart = torch.stack([(teeth * one).sum() / one.sum().clamp_min(1) for one in sets])
            terms["mouth"] = config.mouth_weight * apart.sum()
        if config.perceptual_weight:
            boxes = self.boxes.of(frame)
            terms.update(self.perceptual(rendering.image, frame.image, step, boxes))
        return terms

    def optimizers(self) -> list[torch.optim.Optimizer]:
        """Adam for the rows."""
        return [self.rows.optimizer]

    @torch.no_grad()
    def after_backward(self, rendering: Rendering, step: int) -> None:
        """Density control after `step`, then rates and degree of `step + 1`."""
        if self.density.is_active(step):
            accumulate(self.rows, rendering)
            unit = torch.ones(len(self.slots), device=self.slots.device)
            self.density.apply(self.rows, step, unit, seeded(self.scene.seed, 2, step))
        self.rows.set_rate("means", position_rate(self.config, self.scene, step))
        self.steps_done.fill_(step)

    def train(self, mode: bool = True) -> GaussianBlendshapes:
        """Switch between training and evaluation, in which rows without differences are skipped."""
        self._cached = None
        return super().train(mode)

    def notes(self) -> dict[str, str]:
        """Notes for provenance.json: the features of the perceptual loss."""
        return self.perceptual.notes()

    def _face_transforms(self, drive: Drive) -> FaceTransforms:
        """Transforms of every triangle; the torso is held still if the head pose moves the neck."""
        transforms = self.skin.transforms(self.head, drive)
        if self.config.pose_on == "camera" or not self.poses.in_camera:
            return transforms
        return self.skin.hold_torso(transforms, self.poses.torso(drive), self.head.joint_index("root"))

    def _differences(self, weights: Float[Tensor, "N M"]) -> tuple[Tensor, ...]:
        """Blended differences of positions, quaternions, log-scales, opacity logits and harmonics."""
        if self.training or torch.is_grad_enabled():
            added = blend(self.rows["differences"], weights) * self.units
        else:
            added = weights.new_zeros(len(weights), len(self.units))
            moving, differences = self._moving_rows()
            added[moving] = blend(differences, weights[moving]) * self.units
        return added.split((*PROPERTIES, added.shape[1] - sum(PROPERTIES)), dim=1)

    def _moving_rows(self) -> tuple[Tensor, Tensor]:
        """Rows whose triangle some blendshape moves, and their differences; cached until training resumes."""
        if self._cached is None:
            moving = (self.strengths[self.rows["face"]] > 0).any(1).nonzero().squeeze(1)
            self._cached = moving, self.rows["differences"][moving]
        return self._cached

    def _colors(self, tinted: Float[Tensor, "N K 3"]) -> Float[Tensor, "N L 3"]:
        """Spherical harmonics plus their differences."""
        rows, count = self.rows, tinted.shape[1]
        sh = harmonics(rows)
        return torch.cat((sh[:, :count] + tinted, sh[:, count:]), dim=1)

    def _sh_degree(self) -> int:
        """Degree of the spherical harmonics in use."""
        return degree_in_use(
            self.steps_done,
            scaled(self.config.sh_iterations, self.scene.steps, self.config.iterations),
            self.config.sh_degree,
        )


def blend(differences: Float[Tensor, "N D M"], weights: Float[Tensor, "N M"]) -> Float[Tensor, "N D"]:
    """Weighted sum Σ_m w_m Δ_m of the learned differences of each Gaussian; no gradient flows into the weights."""
    blended: Tensor = _Blend.apply(differences, weights)
    return blended


class _Blend(torch.autograd.Function):
    """The weighted sum; its backward is one broadcast product, five times as fast as torch's."""

    @staticmethod
    def forward(ctx: Any, differences: Tensor, weights: Tensor) -> Tensor:
        ctx.save_for_backward(weights)
        return (differences @ weights[:, :, None]).squeeze(-1)

    @staticmethod
    def backward(ctx: Any, upstream: Tensor) -> tuple[Tensor, None]:
        (weights,) = ctx.saved_tensors
        return upstream[:, :, None] * weights[:, None, :], None


def coefficient_spreads(head: HeadModel, drives: tuple[Drive, ...]) -> Float[Tensor, " K"]:
    """Root mean square of every expression and eyelid coefficient in training; 0 for coefficients that are always 0.

    They are the units of the blendshapes, so that learning rates have the same effect for FLAME's coefficients, which
    are standard deviations, and for those of other heads. Coefficients that are always 0 get no learned differences.
    """
    seen = [torch.cat((drive.expression, drive.eyelids)) for drive in drives or (head.neutral_drive(),)]
    spreads = torch.stack(seen).square().mean(0).sqrt()
    return torch.where(spreads > 1e-6, spreads, torch.zeros_like(spreads))


def face_tables(head: HeadModel, spreads: Float[Tensor, " K"], teeth: bool) -> tuple[FaceDeformations, FaceSkinning]:
    """Mesh blendshapes and skinning of every triangle; `teeth` adds two triangles that follow head and jaw."""
    displacements = torch.cat((head.expression_basis, head.eyelid_basis), dim=2) * spreads
    changes, skin = transfer_blendshapes(head.template, head.faces, displacements), FaceSkinning.of(head)
    if not teeth:
        return changes, skin
    rigid = [head.joint_index(name if name in head.joint_names else head.joint_names[0]) for name in ("neck", "jaw")]
    return changes.with_static_faces(2), skin.with_rigid_faces(rigid)


def strongest_blendshapes(displacement: Float[Tensor, "F K"], config: Config) -> tuple[Tensor, Tensor]:
    """Indices [F, M] of the blendshapes that move each triangle most, and their strengths in [0, 1] [F, M].

    The strength is max(‖d‖ − t, 0) / (d_max − t) with t = `consistency_threshold` · d_max. M is the largest number of
    nonzero strengths of a triangle, at most `blendshapes`.
    """
    largest = displacement.max().clamp_min(1e-12)
    threshold = config.consistency_threshold * largest
    strengths = (displacement - threshold).clamp_min(0) / (largest - threshold)
    if not config.consistency:
        strengths = torch.ones_like(strengths)
    count = int((strengths > 0).sum(1).max().clamp(1, config.blendshapes))
    ordered = strengths.sort(dim=1, descending=True, stable=True)
    return ordered.indices[:, :count], ordered.values[:, :count]


def difference_units(config: Config) -> Float[Tensor, " D"]:
    """Units of the stored differences: their learning rates, so that one column with rate 1 holds all of them.

    Adam is invariant to the scale of a gradient, so this is exact.
    """
    degree = min(config.difference_sh_degree, config.sh_degree)
    rates = (
        (config.position_difference_rate, 3),
        (config.rotation_difference_rate, 4),
        (config.scale_difference_rate, 3),
        (config.opacity_difference_rate, 1),
        (config.color_difference_rate, 3 * (degree + 1) ** 2),
    )
    return torch.cat([torch.full((count,), rate) for rate, count in rates])


def initial_rows(config: Config, scene: Scene, mouth: MouthCylinder | None, differences: tuple[int, int]) -> Rows:
    """Small gray Gaussians over the mesh and in the mouth, as large as their spacing, with differences of zero."""
    head, generator = scene.head, seeded(scene.seed, 4)
    wanted = min(config.first_gaussians, int(0.6 * scene.max_gaussians))
    means, face, apart = sample_surface(head.neutral(), head.faces, wanted, generator)
    log_scales = torch.full((len(means), 3), apart).log()
    if mouth is not None:
        each = round(config.mouth_gaussians * wanted)
        distance = (math.pi * mouth.radius**2 * mouth.half_height / max(each, 1)) ** (1 / 3)
        means = torch.cat((means, mouth.points(2 * each, generator)))
        face = torch.cat((face, len(head.faces) + torch.arange(2).repeat_interleave(each).to(face)))
        log_scales = torch.cat((log_scales, torch.full((2 * each, 3), distance).log()))
    count, device = len(means), head.faces.device
    learnable = {
        "means": Column(means, config.position_rate * config.extent),
        "quats": Column(torch.tensor([1.0, 0.0, 0.0, 0.0]).repeat(count, 1), config.rotation_rate),
        "log_scales": Column(log_scales, config.scale_rate),
        "opacity_logits": Column(torch.full((count,), 0.1).logit(), config.opacity_rate),
        "sh": Column(torch.rand(count, 1, 3, generator=generator) / 255, config.color_rate),
        "differences": Column(torch.zeros(count, *differences), config.difference_rate),
    }
    if config.sh_degree:
        learnable["sh_rest"] = Column(torch.zeros(count, (config.sh_degree + 1) ** 2 - 1, 3), config.color_rate / 20)
    moved = {name: Column(column.values.to(device), column.rate) for name, column in learnable.items()}
    return Rows(moved, {"face": face.to(device), **statistics(count, device)})


def density_control(config: Config, scene: Scene) -> DensityControl:
    """The density schedule scaled to this training; opacities are never reset."""
    iterations = config.density_start, config.density_stop, config.density_interval, config.prune_iterations
    return DensityControl(
        *scaled_schedule(*iterations, scene.steps, config.iterations),
        resetting=False,
        gradient=config.density_gradient,
        extent=config.extent,
        budget=scene.max_gaussians,
        ramp=config.density_ramp,
    )


def position_rate(config: Config, scene: Scene, step: int) -> float:
    """Learning rate of neutral positions after `step` steps."""
    first = config.position_rate * config.extent
    last = scaled(config.position_iterations, scene.steps, config.iterations)
    return log_linear(step, first, first * config.position_decay, last)
