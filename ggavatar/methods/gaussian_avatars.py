"""GaussianAvatars (Qian et al. 2024): Gaussians bound to the triangles of the tracked head mesh.

S. Qian et al., "GaussianAvatars: Photorealistic Head Avatars with Rigged 3D Gaussians", CVPR 2024; implemented from the
paper with the constants of its public code. It is the first baseline of the GGAvatar paper, whose ablation "w/o
Geometry Morph Adjuster" is nearly the same method.

    1. One Gaussian per triangle; position, rotation and scale are local to the triangle (Sec. 3.2).
    2. Density control as in 3D Gaussian Splatting; children keep their triangle, and no triangle loses its last
       Gaussian (Sec. 3.3).
    3. Two regularizers keep Gaussians close to their triangles. Expression, joints and translation of the head are
       fine-tuned per frame, for training frames only (Sec. 3.4).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Literal

import torch
from torch import Tensor

from ggavatar.core import Drive, Frame, Gaussians, Rendering
from ggavatar.data.scene import Scene
from ggavatar.gaussians.binding import bind
from ggavatar.gaussians.bound_parts import BoundParts, bound_columns
from ggavatar.gaussians.density_control import DensityControl, accumulate, scaled_schedule
from ggavatar.gaussians.initialization import BoundRates, bound_rows
from ggavatar.gaussians.spherical_harmonics import color_from_frames, degree_in_use, harmonics
from ggavatar.geometry.triangles import TriangleFrames, triangle_frames
from ggavatar.head.head_pose import HeadPoses
from ggavatar.head.model import HeadModel
from ggavatar.head.region_boxes import RegionBoxes
from ggavatar.losses.crop_sampler import CropSampler
from ggavatar.losses.dssim import image_terms
from ggavatar.losses.terms import log_scale_regularizer, position_regularizer
from ggavatar.losses.vgg import FeatureChoice
from ggavatar.losses.vgg_term import PerceptualTerm
from ggavatar.optim.schedules import PAPER_STEPS, log_linear, scaled
from ggavatar.optim.seeding import seeded
from ggavatar.optim.step_counter import StepCounter
from ggavatar.optim.tracking_corrections import CorrectionRates, DriveCorrections


@dataclass(frozen=True)
class Config:
    """All settings of the method; the defaults are those of GaussianAvatars. Iterations refer to `iterations`."""

    iterations: int = 600_000
    """Length of the training that all iteration constants refer to (GaussianAvatars)."""
    pose_on: Literal["camera", "neck"] = "camera"
    """What the head pose moves: the camera, as tracked, or the neck too, so that the torso stays still."""

    finetuning: bool = True
    """Whether the head's parameters are fine-tuned on training frames (Sec. 3.4)."""
    expression_rate: float = 1e-3
    """Learning rate of corrections of expression coefficients, in their unit (GaussianAvatars)."""
    joint_rate: float = 1e-5
    """Learning rate of corrections of joint rotations, rad (GaussianAvatars)."""
    translation_rate: float = 1e-6
    """Learning rate of corrections of the head's translation, m (GaussianAvatars)."""

    position_rate: float = 5e-3
    """Learning rate of local positions at the start, triangle units (GaussianAvatars)."""
    position_decay: float = 0.01
    """Final position rate as a fraction of the initial one, reached at `position_iterations` (GaussianAvatars)."""
    position_iterations: int = 600_000
    """Iterations over which the position rate falls (GaussianAvatars)."""
    scale_rate: float = 0.017
    """Learning rate of the logarithms of local scales (GaussianAvatars)."""
    rotation_rate: float = 1e-3
    """Learning rate of local quaternions (3DGS)."""
    opacity_rate: float = 0.05
    """Learning rate of opacity logits (3DGS)."""
    color_rate: float = 2.5e-3
    """Learning rate of the constant spherical harmonic; the rate of the others is 1/20 of it (3DGS)."""
    sh_degree: int = 3
    """Highest degree of the spherical harmonics, 0 to 3 (3DGS)."""
    sh_iterations: int = 1_000
    """Iterations between increments of the degree in use (3DGS)."""
    first_colors: Literal["grey", "frames"] = "grey"
    """Initial colors: `grey` (GaussianAvatars), or from a few training `frames`."""

    density_start: int = 10_000
    """Density control starts after this iteration (GaussianAvatars)."""
    density_stop: int = 600_000
    """Iteration at which density control and opacity resets end (GaussianAvatars)."""
    density_interval: int = 2_000
    """Iterations between two rounds (GaussianAvatars); short trainings: 20 steps, or 10 to 20 for 30 rounds."""
    density_gradient: float = 2e-4
    """Mean gradient norm of projected centers from which a Gaussian grows, normalized device coordinates (3DGS)."""
    density_ramp: bool = False
    """Whether the budget becomes available evenly over the rounds (for short trainings) or at once (3DGS)."""
    reset_iterations: int = 60_000
    """Iterations between two opacity resets (GaussianAvatars); none in trainings under 12,000 steps."""
    split_in: Literal["local", "world"] = "local"
    """Space of the deviations that spread the children of a split; the public code uses `world` by mistake."""
    extent: float = 1.0
    """Extent of the scene, m; the extent of the cameras, used in the public code, is undefined for one camera."""

    dssim_share: float = 0.2
    """Weight of D-SSIM in the image loss; L1 has the rest (3DGS)."""
    position_weight: float = 0.01
    """Weight of the position regularizer (Sec. 3.4)."""
    position_threshold: float = 1.0
    """Distance from the triangle's center up to which the cost is 0, triangle units (Sec. 3.4)."""
    scale_weight: float = 1.0
    """Weight of the scale regularizer (Sec. 3.4)."""
    scale_threshold: float = 0.6
    """Standard deviation up to which the cost is 0, triangle units (Sec. 3.4)."""

    perceptual_weight: float = 0.02
    """Weight of the VGG loss that the GGAvatar paper adds (Sec. 4.2); GaussianAvatars has none."""
    perceptual_features: FeatureChoice = "vgg16"
    """Features of the perceptual loss: `vgg16`, an untrained stand-in (`random`), or the `best` that can be had."""
    perceptual_share: float = 1 / 24
    """Fraction of the training before the VGG loss starts (5,000 of the GGAvatar paper's 120,000 iterations)."""
    perceptual_mode: Literal["image", "crops"] = "image"
    """VGG loss on the whole image, or on crops in some steps with the same expected weight."""
    crop_side: int = 128
    """Side of a crop, px."""
    crop_probability: float = 0.2
    """Fraction of the steps with a crop."""


TABLE_NOTES = (
    "with the perceptual loss that the GGAvatar paper adds (Sec. 4.2)",
    "one camera: the extent of the scene is 1 m",
)
"""Deviations from the paper, which tables print as footnotes."""

OWN_SCHEDULE: dict[str, Any] = {
    "iterations": 600_000,
    "position_iterations": 600_000,
    "sh_iterations": 1_000,
    "density_start": 10_000,
    "density_stop": 600_000,
    "density_interval": 2_000,
    "reset_iterations": 60_000,
}
"""The schedule of GaussianAvatars, scaled to any length."""

GGAVATAR_PAPER_SCHEDULE: dict[str, Any] = {
    "iterations": PAPER_STEPS,
    "position_iterations": 60_000,
    "sh_iterations": 1_000,
    "density_start": 500,
    "density_stop": 60_000,
    "density_interval": 100,
    "reset_iterations": 3_000,
}
"""The schedule of the GGAvatar paper (Sec. 3.5), which trains all baselines under the same conditions."""

SHORT_TRAINING: dict[str, Any] = {
    "perceptual_features": "best",
    "first_colors": "frames",
    "position_rate": 1e-2,
    "color_rate": 1e-2,
    "density_ramp": True,
    "sh_degree": 1,
    "perceptual_mode": "crops",
    "crop_side": 96,
    "crop_probability": 0.1,
}
"""Changes for trainings of a few thousand steps on a CPU, like `SHORT_TRAINING` of our method in `ggavatar.py`.

The schedule remains that of GaussianAvatars: at 1,500 steps it is 0.3 dB better than that of the GGAvatar paper.
"""

VARIANTS: dict[str, dict[str, Any]] = {
    "without_perceptual": {"perceptual_weight": 0.0},
    "without_finetuning": {"finetuning": False},
    "own_schedule": OWN_SCHEDULE,
    "seed_schedule": GGAVATAR_PAPER_SCHEDULE,
}

PRESETS: dict[str, dict[str, Any]] = {
    "default": SHORT_TRAINING,
    "fast": SHORT_TRAINING,
    "paper": GGAVATAR_PAPER_SCHEDULE,
}


def least_gaussians(head: HeadModel) -> int:
    """One Gaussian for each triangle, which a triangle never loses."""
    return len(head.faces)


def build(config: Config, scene: Scene) -> GaussianAvatars:
    """The avatar before its first step."""
    avatar = GaussianAvatars(config, scene).to(scene.background.device)
    if config.first_colors == "frames":
        color_from_frames(avatar.rows, avatar.gaussians, scene)
    return avatar


class GaussianAvatars(StepCounter):
    """The avatar: rows of Gaussians in the local spaces of their triangles, and corrections of training frames."""

    def __init__(self, config: Config, scene: Scene) -> None:
        super().__init__()
        self.config, self.scene, self.head = config, scene, scene.head
        self.poses = HeadPoses.of(self.head, scene.drives)
        self.face_scales = triangle_frames(self.head.neutral(), self.head.faces).scales
        rates = BoundRates(
            config.position_rate * config.extent,
            config.rotation_rate,
            config.scale_rate,
            config.opacity_rate,
            config.color_rate,
        )
        self.rows = bound_rows(self.head, rates, config.sh_degree, seeded(scene.seed, 4))
        self.corrections = drive_corrections(config, scene)
        self.density = density_control(config, scene)
        crops = CropSampler(config.crop_side, config.crop_probability)
        self.boxes = RegionBoxes(self.head)
        self.perceptual = PerceptualTerm(
            config.perceptual_weight,
            crops if config.perceptual_mode == "crops" else None,
            scene.seed,
            features=config.perceptual_features,
        )

    def gaussians(self, drive: Drive) -> Gaussians:
        """The avatar posed by `drive`, in world space; drives of training frames are corrected first (Sec. 3.4)."""
        rows, local_frames = self.rows, self._local_frames(drive)
        means, quats, scales = bind(rows["means"], rows["quats"], rows["log_scales"], rows["face"], local_frames)
        sh = harmonics(rows)
        return Gaussians(means, quats, scales, rows["opacity_logits"].sigmoid(), sh, self._sh_degree())

    def losses(self, frame: Frame, rendering: Rendering, step: int) -> Mapping[str, Tensor]:
        """The image loss and the two regularizers (Sec. 3.4), and the perceptual loss if configured."""
        config, rows = self.config, self.rows
        visible = rendering.radii > 0
        terms = {
            **image_terms(rendering.image, frame.image, config.dssim_share)._asdict(),
            "position": position_regularizer(rows["means"], visible, config.position_threshold, config.position_weight),
            "scale": log_scale_regularizer(rows["log_scales"], visible, config.scale_threshold, config.scale_weight),
        }
        if config.perceptual_weight and step > config.perceptual_share * self.scene.steps:
            boxes = self.boxes.of(frame) if self.perceptual.crops else []
            terms.update(self.perceptual(rendering.image, frame.image, step, boxes))
        return terms

    def optimizers(self) -> list[torch.optim.Optimizer]:
        """Adam for the rows and Adam for the corrections."""
        return [self.rows.optimizer, *([self.corrections.optimizer] if self.corrections else [])]

    @torch.no_grad()
    def after_backward(self, rendering: Rendering, step: int) -> None:
        """Density control after `step`, then rates and degree of `step + 1`."""
        if self.density.is_active(step):
            accumulate(self.rows, rendering)
            self.density.apply(self.rows, step, self.face_scales, seeded(self.scene.seed, 2, step))
        self.rows.set_rate("means", position_rate(self.config, self.scene, step))
        self.steps_done.fill_(step)

    def notes(self) -> dict[str, str]:
        """Notes for provenance.json: the features of the perceptual loss."""
        return self.perceptual.notes()

    def bound_parts(self) -> BoundParts:
        """The avatar as arrays, without the corrections of training frames."""
        return BoundParts(
            self.head,
            self.poses,
            **bound_columns(self.rows, self._sh_degree()),
            follows_face=True,
            holds_torso=self.config.pose_on == "neck",
            adjuster=None,
        )

    def _local_frames(self, drive: Drive) -> TriangleFrames:
        """Triangle frames of the tracked head; for a training frame, gradients flow into its corrections."""
        if self.corrections is None or not self.corrections.corrects(drive):
            with torch.no_grad():
                return self._local_frames_of(drive)
        return self._local_frames_of(self.corrections(drive))

    def _local_frames_of(self, drive: Drive) -> TriangleFrames:
        vertices = self.head.vertices(drive)
        if self.config.pose_on == "neck":
            vertices = self.poses.hold_torso(vertices, drive, self.head)
        return triangle_frames(vertices, self.head.faces)

    def _sh_degree(self) -> int:
        """Degree of the spherical harmonics in use."""
        return degree_in_use(
            self.steps_done,
            scaled(self.config.sh_iterations, self.scene.steps, self.config.iterations),
            self.config.sh_degree,
        )


def drive_corrections(config: Config, scene: Scene) -> DriveCorrections | None:
    """Corrections of the training frames, initially zero; None without fine-tuning or training frames."""
    if not config.finetuning or not any(drive.frame is not None for drive in scene.drives):
        return None
    rates = CorrectionRates(config.expression_rate, config.joint_rate, config.translation_rate)
    return DriveCorrections(scene.drives, rates)


def density_control(config: Config, scene: Scene) -> DensityControl:
    """The density schedule scaled to this training; short trainings have no opacity resets."""
    iterations = config.density_start, config.density_stop, config.density_interval, config.reset_iterations
    return DensityControl(
        *scaled_schedule(*iterations, scene.steps, config.iterations),
        resetting=scene.steps >= PAPER_STEPS // 10,
        reset_at_start=bool((scene.background > 0.99).all()),
        gradient=config.density_gradient,
        extent=config.extent,
        budget=scene.max_gaussians,
        ramp=config.density_ramp,
        split_in=config.split_in,
    )


def position_rate(config: Config, scene: Scene, step: int) -> float:
    """Learning rate of local positions after `step` steps."""
    first = config.position_rate * config.extent
    last = scaled(config.position_iterations, scene.steps, config.iterations)
    return log_linear(step, first, first * config.position_decay, last)
