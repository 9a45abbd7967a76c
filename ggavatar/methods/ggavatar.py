"""GGAvatar (Li et al. 2024): Gaussians on a head mesh, refined by an expression-driven Geometry Morph Adjuster.

Comments number the paper's equations; docs/paper.md lists the choices where the paper is silent (A1–A34).

    1. Neutral phase (Sec. 3.2): one Gaussian per triangle of the neutral head, then density control with inherited
       bindings.
    2. Adjusted phase (Sec. 3.3): the head follows the tracked expression, and the adjuster adds Δμ, Δr, Δs =
       W(x)·f(ψ, θ) to every Gaussian.
"""

from __future__ import annotations

import functools
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, Literal

import torch
from jaxtyping import Float
from torch import Tensor

from ggavatar.core import Drive, Frame, Gaussians, Rendering
from ggavatar.data.scene import Scene
from ggavatar.gaussians.binding import WorldGeometry, bind
from ggavatar.gaussians.bound_parts import AdjusterParts, BoundParts, bound_columns
from ggavatar.gaussians.density_control import DensityControl, accumulate, scaled_schedule
from ggavatar.gaussians.initial_colors import SH_C0
from ggavatar.gaussians.initialization import BoundRates, bound_rows
from ggavatar.gaussians.offsets import COLOR_ROWS, GEOMETRY_ROWS, Offsets, refine
from ggavatar.gaussians.spherical_harmonics import color_from_frames, degree_in_use, harmonics
from ggavatar.geometry.triangles import TriangleFrames, triangle_frames
from ggavatar.head.head_pose import POSE_FEATURES, HeadPoses
from ggavatar.head.model import HeadModel
from ggavatar.head.region_boxes import RegionBoxes
from ggavatar.losses.crop_sampler import CropSampler
from ggavatar.losses.dssim import image_terms
from ggavatar.losses.terms import l1, log_scale_regularizer, position_regularizer
from ggavatar.losses.vgg import FeatureChoice
from ggavatar.losses.vgg_term import PerceptualTerm
from ggavatar.networks.fields import Box, Field, FourierFeatures, HashTriplane, HashTriplaneConfig
from ggavatar.networks.morph_adjuster import AdjusterConfig, BasisAdjuster
from ggavatar.optim.schedules import PAPER_STEPS, log_linear, scaled
from ggavatar.optim.seeding import seeded
from ggavatar.optim.step_counter import StepCounter


@dataclass(frozen=True)
class Config:
    """All settings of the method.

    Iterations refer to the paper's 120,000 and scale with the length of the training.
    """

    neutral_iterations: int = 5_000
    """Iterations on the neutral mesh, before expressions, adjuster and perceptual loss start (Sec. 3.5)."""
    initialization: bool = True
    """Whether there is a neutral phase at all (Table 2, w/o initialization)."""
    skinning: bool = True
    """Whether the mesh follows the expression (Table 2, w/o LBS)."""
    adjuster: bool = True
    """Whether there is a Geometry Morph Adjuster (Table 2, w/o Geometry Morph Adjuster)."""
    pose_on: Literal["camera", "neck"] = "camera"
    """What the head pose moves: the camera (the paper), or the neck too, so that the torso stays still (A12)."""
    condition: Literal["face", "face_and_pose"] = "face"
    """Inputs of F_ψθ: facial parameters (the paper), or also the head pose, clamped to its training range (A12)."""
    field: Literal["triplane", "fourier"] = "triplane"
    """Features of neutral positions; `fourier` is Table 2, w/o tri-plane."""

    position_rate: float = 5e-3
    """Learning rate of local positions at the start, triangle units (Sec. 3.5; A19)."""
    position_decay: float = 0.01
    """Final position rate as a fraction of the initial one, reached at `position_iterations` (Sec. 3.5)."""
    position_iterations: int = 60_000
    """Iterations over which the position rate falls; constant afterwards (Sec. 3.5)."""
    scale_rate: float = 5e-3
    """Learning rate of the logarithms of local scales (Sec. 3.5)."""
    rotation_rate: float = 1e-3
    """Learning rate of local quaternions (3DGS)."""
    opacity_rate: float = 0.05
    """Learning rate of opacity logits (3DGS)."""
    color_rate: float = 2.5e-3
    """Learning rate of the constant spherical harmonic; the rate of the others is 1/20 of it (3DGS)."""
    sh_degree: int = 3
    """Highest degree of the spherical harmonics, 0 to 3 (3DGS; A21)."""
    sh_iterations: int = 1_000
    """Iterations between increments of the degree in use (3DGS)."""
    first_colors: Literal["grey", "frames"] = "grey"
    """Initial colors: `grey` (GaussianAvatars), or from a few training `frames`."""

    density_start: int = 500
    """Density control starts after this iteration (Sec. 3.5)."""
    density_stop: int = 60_000
    """Iteration at which density control and opacity resets end (Sec. 3.5; A20)."""
    density_interval: int = 100
    """Iterations between two rounds (Section 3.5); short trainings: 20 steps, or 10 to 20 for 30 rounds."""
    density_gradient: float = 2e-4
    """Mean gradient norm of projected centers from which a Gaussian grows, normalized device coordinates (3DGS)."""
    density_ramp: bool = False
    """Whether the budget becomes available evenly over the rounds (ours, short trainings) or at once (3DGS)."""
    reset_iterations: int = 3_000
    """Iterations between two opacity resets (Sec. 3.5); none in trainings shorter than a tenth of the paper's."""
    extent: float = 1.0
    """Extent of the scene, m (A23)."""

    latent: int = 32
    """Length L of the latent vector f (unstated; A8)."""
    hidden: int = 64
    """Width of the basis network F_H (unstated; A8)."""
    latent_hidden: int = 128
    """Width of the latent network F_ψθ (unstated; A8)."""
    field_levels: int = 12
    """Levels of the tri-plane (unstated; A9)."""
    field_features: int = 2
    """Features of a table entry (unstated; A9)."""
    field_finest: int = 512
    """Cells along a side at the finest level (unstated; A9)."""
    octaves: int = 10
    """Octaves of the positional encoding in w/o tri-plane (NeRF)."""
    offset_unit: float = 0.01
    """Meters per unit of Δμ (A6)."""
    color_unit: float = 0.0
    """sRGB color per unit of three color rows of the basis; 0 is the paper, whose basis has none."""
    network_rate: float = 1e-4
    """Learning rate of F_H and F_ψθ (Sec. 3.5)."""
    field_rate: float = 5e-3
    """Learning rate of the tri-plane's tables (Sec. 3.5)."""

    dssim_share: float = 0.2
    """λ1, share of D-SSIM in the image loss (Eq. 13)."""
    perceptual_weight: float = 0.02
    """λ2, weight of the VGG loss after the neutral phase (Eq. 16)."""
    perceptual_features: FeatureChoice = "vgg16"
    """Features of the perceptual loss: `vgg16`, an untrained stand-in (`random`), or the `best` that can be had."""
    perceptual_mode: Literal["image", "crops"] = "image"
    """VGG loss on the whole image (Section 3.4), or on crops in some steps with the same expected weight."""
    crop_side: int = 128
    """Side of a crop, px."""
    crop_probability: float = 0.2
    """Fraction of the steps with a crop."""
    position_weight: float = 0.01
    """λ3, weight of the position regularizer (Eq. 16)."""
    position_threshold: float = 1.0
    """ε_position, triangle units (Eq. 14)."""
    scale_weight: float = 1.0
    """λ4, weight of the scale regularizer (Eq. 16)."""
    scale_threshold: float = 0.6
    """ε_scaling, triangle units (Eq. 15)."""
    alpha_weight: float = 0.0
    """Weight of the mean absolute difference between coverage and mask; 0 is the paper, which compares colors only."""


VARIANTS: dict[str, dict[str, Any]] = {
    "without_adjuster": {"adjuster": False},
    "without_triplane": {"field": "fourier"},
    "without_lbs": {"skinning": False},
    "without_initialization": {"initialization": False},
}

SHORT_TRAINING: dict[str, Any] = {
    "perceptual_features": "best",
    "first_colors": "frames",
    "position_rate": 1e-2,
    "position_iterations": 120_000,
    "scale_rate": 0.017,
    "color_rate": 1e-2,
    "perceptual_mode": "crops",
    "crop_side": 96,
    "crop_probability": 0.1,
    "density_ramp": True,
    "network_rate": 1e-3,
    "sh_degree": 1,
    "sh_iterations": 20_000,
}
"""Changes for trainings of a few thousand steps on a CPU.

Measured in docs/experiments/2026-11-22-learning-rates-for-short-trainings.md.
"""

PRESETS: dict[str, dict[str, Any]] = {"default": SHORT_TRAINING, "fast": SHORT_TRAINING, "paper": {}}


def least_gaussians(head: HeadModel) -> int:
    """One Gaussian for each triangle, which a triangle never loses."""
    return len(head.faces)


def build(config: Config, scene: Scene) -> GGAvatar:
    """The avatar before its first step."""
    avatar = GGAvatar(config, scene).to(scene.background.device)
    if config.first_colors == "frames":
        color_from_frames(avatar.rows, avatar.gaussians, scene)
    return avatar


class GGAvatar(StepCounter):
    """The avatar: rows of Gaussians in the local spaces of their triangles, and the adjuster."""

    def __init__(self, config: Config, scene: Scene) -> None:
        super().__init__()
        self.config, self.scene = config, scene
        self.head: HeadModel = scene.head
        self.poses = HeadPoses.of(self.head, scene.drives)
        self.neutral_local_frames = triangle_frames(self.head.neutral(), self.head.faces)
        self.rows = bound_rows(self.head, rates(config), config.sh_degree, seeded(scene.seed, 4))
        self.adjuster = make_adjuster(config, scene) if config.adjuster else None
        self.density = density_control(config, scene)
        crops = CropSampler(config.crop_side, config.crop_probability) if config.perceptual_mode == "crops" else None
        self.boxes = RegionBoxes(self.head)
        self.perceptual = PerceptualTerm(
            config.perceptual_weight, crops, scene.seed, features=config.perceptual_features
        )
        self._reused: dict[str, Tensor] = {}

    @property
    def is_neutral(self) -> bool:
        """Whether the next step belongs to the neutral phase."""
        return self.config.initialization and int(self.steps_done) < scaled(
            self.config.neutral_iterations, self.scene.steps
        )

    def gaussians(self, drive: Drive) -> Gaussians:
        """The avatar posed by `drive`, in world space (Eq. 4–12)."""
        means, quats, scales = self._bound(self._local_frames(drive))
        opacities = self._once("opacities", lambda: self.rows["opacity_logits"].sigmoid())
        offsets = None
        if self.adjuster is not None and not self.is_neutral:
            offsets = self._offsets(self._condition(drive))  # Eq. 9–11, W never built
            means, quats, scales = refine(means, quats, scales, offsets, self.config.offset_unit)  # Eq. 12
        return Gaussians(means, quats, scales, opacities, self._colors(offsets), self._sh_degree())

    def losses(self, frame: Frame, rendering: Rendering, step: int) -> Mapping[str, Tensor]:
        """The weighted terms of Eq. 13–16, and coverage if configured."""
        config, rows = self.config, self.rows
        visible = rendering.radii > 0
        terms = {
            **image_terms(rendering.image, frame.image, config.dssim_share)._asdict(),  # Eq. 13
            "position": position_regularizer(rows["means"], visible, config.position_threshold, config.position_weight),
            "scale": log_scale_regularizer(rows["log_scales"], visible, config.scale_threshold, config.scale_weight),
        }
        if config.alpha_weight:
            terms["alpha"] = config.alpha_weight * l1(rendering.alpha, frame.alpha)
        if config.perceptual_weight and not self.is_neutral:
            boxes = self.boxes.of(frame) if self.perceptual.crops else []
            terms.update(self.perceptual(rendering.image, frame.image, step, boxes))  # Eq. 16
        return terms

    @functools.cached_property
    def adjuster_optimizer(self) -> torch.optim.Optimizer | None:
        """Adam for the adjuster, made when it is first used."""
        return adjuster_optimizer(self.config, self.adjuster) if self.adjuster else None

    def optimizers(self) -> list[torch.optim.Optimizer]:
        """Adam for the rows and Adam for the adjuster."""
        return [self.rows.optimizer, *([self.adjuster_optimizer] if self.adjuster_optimizer else [])]

    @torch.no_grad()
    def after_backward(self, rendering: Rendering, step: int) -> None:
        """Density control after `step`, then rates and stage of `step + 1`."""
        if self.density.is_active(step):
            accumulate(self.rows, rendering)
            self.density.apply(self.rows, step, self.neutral_local_frames.scales, seeded(self.scene.seed, 2, step))
        self.rows.set_rate("means", position_rate(self.config, self.scene, step))
        self.steps_done.fill_(step)

    def train(self, mode: bool = True) -> GGAvatar:
        """Switch between training and evaluation, which caches what does not depend on the drive."""
        self._reused = {}
        return super().train(mode)

    def notes(self) -> dict[str, str]:
        """Notes for provenance.json: the features of the perceptual loss."""
        return self.perceptual.notes()

    @torch.no_grad()
    def bound_parts(self) -> BoundParts:
        """The avatar as arrays; in the neutral phase, without expression and adjuster."""
        return BoundParts(
            self.head,
            self.poses,
            **bound_columns(self.rows, self._sh_degree()),
            follows_face=self.config.skinning and not self.is_neutral,
            holds_torso=self.config.pose_on == "neck",
            adjuster=self._adjuster_parts(),
        )

    def _adjuster_parts(self) -> AdjusterParts | None:
        if self.adjuster is None or self.is_neutral:
            return None
        adjuster, config = self.adjuster, self.config
        return AdjusterParts(
            hidden=adjuster.cache(self._neutral_positions()),
            last_weight=adjuster.last_weight.detach(),
            last_bias=adjuster.last_bias.detach(),
            latent_layers=adjuster.latent_layers(),
            unit=config.offset_unit,
            color_unit=config.color_unit,
            sees_pose=config.condition == "face_and_pose",
        )

    def _local_frames(self, drive: Drive) -> TriangleFrames:
        """Triangle frames (Eq. 4–5) of the neutral or the tracked head; differentiable if the drive asks for it."""
        with torch.set_grad_enabled(torch.is_grad_enabled() and drive.requires_grad):
            return self._local_frames_of(drive)

    def _local_frames_of(self, drive: Drive) -> TriangleFrames:
        neutral = self.is_neutral or not self.config.skinning
        if neutral and self.config.pose_on == "camera":
            return self.neutral_local_frames
        vertices = self.head.neutral() if neutral else self.head.vertices(drive)
        if self.config.pose_on == "neck":
            vertices = self.poses.hold_torso(vertices, drive, self.head)
        return triangle_frames(vertices, self.head.faces)

    def _condition(self, drive: Drive) -> Float[Tensor, " C"]:
        """ψ and θ of Eq. 10."""
        face = self.head.condition(drive)
        return face if self.config.condition == "face" else torch.cat((face, self.poses.condition(drive)))

    def _bound(self, local_frames: TriangleFrames) -> WorldGeometry:
        """The Gaussians bound to these triangles (Eq. 6–8)."""
        rows = self.rows
        return bind(rows["means"], rows["quats"], rows["log_scales"], rows["face"], local_frames)

    def _offsets(self, condition: Float[Tensor, " C"]) -> Offsets:
        """W(x)·f(ψ, θ) at the neutral positions x (Eq. 9–11); evaluation caches what depends on x only."""
        adjuster = self.adjuster
        assert adjuster is not None
        if self.training or torch.is_grad_enabled():
            return adjuster(self._neutral_positions(), condition)
        hidden = self._once("hidden", lambda: adjuster.cache(self._neutral_positions()))
        return adjuster.offsets(hidden, adjuster.latent(condition))

    @torch.no_grad()
    def _neutral_positions(self) -> Float[Tensor, "N 3"]:
        """Positions of the Gaussians on the neutral head, m."""
        return self._bound(self.neutral_local_frames).means

    def _colors(self, offsets: Offsets | None) -> Float[Tensor, "N K 3"]:
        """Spherical harmonics; with color rows, the constant one depends on the condition."""
        if offsets is None or offsets.colors is None:
            return self._once("harmonics", lambda: harmonics(self.rows))
        return harmonics(self.rows, self.rows["sh"] + (self.config.color_unit / SH_C0) * offsets.colors[:, None])

    def _once(self, name: str, make: Callable[[], Tensor]) -> Tensor:
        """What training computes in every step, and evaluation once for all frames."""
        if self.training or torch.is_grad_enabled():
            return make()
        if name not in self._reused:
            self._reused[name] = make()
        return self._reused[name]

    def _sh_degree(self) -> int:
        """Degree of the spherical harmonics in use."""
        return degree_in_use(
            self.steps_done, scaled(self.config.sh_iterations, self.scene.steps), self.config.sh_degree
        )


def rates(config: Config) -> BoundRates:
    """Learning rates of the rows (Sec. 3.5)."""
    return BoundRates(
        means=config.position_rate * config.extent,
        quats=config.rotation_rate,
        log_scales=config.scale_rate,
        opacity_logits=config.opacity_rate,
        sh=config.color_rate,
    )


def make_adjuster(config: Config, scene: Scene) -> BasisAdjuster:
    """The Geometry Morph Adjuster, its field around the neutral head; it starts as the identity."""
    generator = seeded(scene.seed, 5)
    box = Box.around(scene.head.neutral())
    sizes = HashTriplaneConfig(levels=config.field_levels, features=config.field_features, finest=config.field_finest)
    field: Field = (
        HashTriplane(sizes, box, generator) if config.field == "triplane" else FourierFeatures(box, config.octaves)
    )
    conditions = len(scene.head.condition(scene.head.neutral_drive()))
    conditions += POSE_FEATURES if config.condition == "face_and_pose" else 0
    rows = GEOMETRY_ROWS + (COLOR_ROWS if config.color_unit else 0)
    adjuster_sizes = AdjusterConfig(config.latent, config.hidden, config.latent_hidden, rows)
    return BasisAdjuster(field, conditions, adjuster_sizes, generator).to(scene.background.device)


def adjuster_optimizer(config: Config, adjuster: BasisAdjuster) -> torch.optim.Optimizer:
    """Adam with the paper's two rates (Sec. 3.5), and instant-ngp's ε for the tables' tiny gradients (A31)."""
    tables = [value for name, value in adjuster.named_parameters() if name.startswith("field.")]
    networks = [value for name, value in adjuster.named_parameters() if not name.startswith("field.")]
    groups = [{"params": networks, "lr": config.network_rate, "eps": 1e-8}]
    if tables:
        groups.append({"params": tables, "lr": config.field_rate, "eps": 1e-15})
    return torch.optim.Adam(groups, betas=(0.9, 0.999), fused=True)


def density_control(config: Config, scene: Scene) -> DensityControl:
    """The paper's density schedule scaled to this training; short trainings have no opacity resets."""
    iterations = config.density_start, config.density_stop, config.density_interval, config.reset_iterations
    return DensityControl(
        *scaled_schedule(*iterations, scene.steps, PAPER_STEPS),
        resetting=scene.steps >= PAPER_STEPS // 10,
        reset_at_start=bool((scene.background > 0.99).all()),
        gradient=config.density_gradient,
        extent=config.extent,
        budget=scene.max_gaussians,
        ramp=config.density_ramp,
    )


def position_rate(config: Config, scene: Scene, step: int) -> float:
    """Learning rate of local positions after `step` steps."""
    first = config.position_rate * config.extent
    return log_linear(step, first, first * config.position_decay, scaled(config.position_iterations, scene.steps))
