"""GaussianAvatars (Qian et al. 2024): Gaussians that ride on the triangles of the tracked head mesh.

S. Qian et al., "GaussianAvatars: Photorealistic Head Avatars with Rigged 3D Gaussians", CVPR 2024, after its text and
the constants of its public code; it is the first baseline of the GGAvatar paper, which calls what GaussianAvatars
lacks "w/o Geometry Morph Adjuster".

    1. One Gaussian a triangle; position, rotation and scale are local and follow the triangle of every frame (Sec.
    3.2). 2. Density control as in 3D Gaussian Splatting; children keep their triangle, no triangle loses its last
    Gaussian (Sec. 3.3). 3. Two regularizers keep a Gaussian at its triangle; the head's expression, joints and
    translation are fine-tuned frame by frame, for training frames only (Sec. 3.4).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Literal

import torch
from torch import Tensor, nn

from ggavatar.core import Drive, Frame, Gaussians, Rendering
from ggavatar.data.scene import Scene
from ggavatar.gaussians.binding import bind
from ggavatar.gaussians.density_control import DensityControl, accumulate
from ggavatar.gaussians.initialization import BoundRates, bound_rows
from ggavatar.gaussians.spherical_harmonics import color_from_frames, degree_in_use, harmonics
from ggavatar.geometry.triangles import TriangleFrames, triangle_frames
from ggavatar.head.head_pose import HeadPoses
from ggavatar.head.region_boxes import region_boxes
from ggavatar.losses.crop_sampler import CropSampler
from ggavatar.losses.dssim import image_terms
from ggavatar.losses.terms import log_scale_regularizer, position_regularizer
from ggavatar.losses.vgg_term import PerceptualTerm
from ggavatar.optim.schedules import PAPER_STEPS, log_linear, scaled
from ggavatar.optim.seeding import seeded
from ggavatar.optim.tracking_corrections import CorrectionRates, DriveCorrections


@dataclass(frozen=True)
class Config:
    """Every number of the method; the defaults are GaussianAvatars' own. Iterations are those of `iterations`."""

    iterations: int = 600_000
    """Length of the training that the constants below belong to, iterations (GaussianAvatars)."""
    pose_on: Literal["camera", "neck"] = "camera"
    """Where the head pose acts: on the camera, as it was tracked, or on the neck too, so that the torso is still."""

    finetuning: bool = True
    """Whether the head's parameters are corrected on training frames (Sec. 3.4)."""
    expression_rate: float = 1e-3
    """Learning rate of corrections of expression coefficients, in their unit (GaussianAvatars)."""
    joint_rate: float = 1e-5
    """Learning rate of corrections of joint rotations, rad (GaussianAvatars)."""
    translation_rate: float = 1e-6
    """Learning rate of corrections of the head's translation, m (GaussianAvatars)."""

    position_rate: float = 5e-3
    """Learning rate of local positions at the start, triangle units (GaussianAvatars)."""
    position_decay: float = 0.01
    """Share of the position rate that is left at `position_iterations` (GaussianAvatars)."""
    position_iterations: int = 600_000
    """Iterations over which the position rate falls (GaussianAvatars)."""
    scale_rate: float = 0.017
    """Learning rate of the logarithms of local scales (GaussianAvatars)."""
    rotation_rate: float = 1e-3
    """Learning rate of local quaternions (3DGS)."""
    opacity_rate: float = 0.05
    """Learning rate of opacity logits (3DGS)."""
    color_rate: float = 2.5e-3
    """Learning rate of the constant spherical harmonic; the others learn at a 20th (3DGS)."""
    sh_degree: int = 3
    """Highest degree of the spherical harmonics, 0 to 3 (3DGS)."""
    sh_iterations: int = 1_000
    """Iterations between two rises of the degree in use (3DGS)."""
    first_colors: Literal["grey", "frames"] = "grey"
    """Colors to begin with: grey (GaussianAvatars), or read off a few training frames."""

    density_start: int = 10_000
    """Density control begins after this iteration (GaussianAvatars)."""
    density_stop: int = 600_000
    """Density control ends with this iteration, and opacity resets with it (GaussianAvatars)."""
    density_interval: int = 2_000
    """Iterations between two rounds (GaussianAvatars); short trainings keep 20 steps, 30 rounds, at least 10 steps."""
    density_gradient: float = 2e-4
    """Mean gradient norm of projected centers from which a Gaussian grows, normalized device coordinates (3DGS)."""
    density_ramp: bool = False
    """Whether room for new Gaussians opens evenly over the rounds (short trainings) or at once (3DGS)."""
    reset_iterations: int = 60_000
    """Iterations between two opacity resets (GaussianAvatars); none in trainings of under 12,000 steps."""
    split_in: Literal["local", "world"] = "local"
    """Space of the deviations that spread a split's children; the public code takes the world's by mistake."""
    extent: float = 1.0
    """Extent of the scene, m; that of the cameras, which the public code takes, means nothing for one camera."""

    dssim_share: float = 0.2
    """Share of D-SSIM in the image loss (3DGS)."""
    position_weight: float = 0.01
    """Weight of the position regularizer (Sec. 3.4)."""
    position_threshold: float = 1.0
    """Distance from the triangle's center that costs nothing, triangle units (Sec. 3.4)."""
    scale_weight: float = 1.0
    """Weight of the scale regularizer (Sec. 3.4)."""
    scale_threshold: float = 0.6
    """Standard deviation that costs nothing, triangle units (Sec. 3.4)."""

    perceptual_weight: float = 0.0
    """Weight of a VGG loss, which GaussianAvatars does not have; 0.02 where the GGAvatar paper adds it."""
    perceptual_share: float = 1 / 24
    """Share of the training before the VGG loss begins (5,000 of the GGAvatar paper's 120,000 iterations)."""
    perceptual_mode: Literal["image", "crops"] = "image"
    """VGG loss on the whole image in every step, or on crops in some at the same expected weight."""
    crop_side: int = 128
    """Side of a crop, px."""
    crop_probability: float = 0.2
    """Share of the steps with a crop."""


OWN: dict[str, Any] = {
    "iterations": 600_000,
    "position_iterations": 600_000,
    "sh_iterations": 1_000,
    "density_start": 10_000,
    "density_stop": 600_000,
    "density_interval": 2_000,
    "reset_iterations": 60_000,
}
"""GaussianAvatars' own schedule, scaled to any length."""

SEED: dict[str, Any] = {
    "iterations": PAPER_STEPS,
    "position_iterations": 60_000,
    "sh_iterations": 1_000,
    "density_start": 500,
    "density_stop": 60_000,
    "density_interval": 100,
    "reset_iterations": 3_000,
}
"""The schedule of the GGAvatar paper (Sec. 3.5), whose baselines were trained under the same conditions."""

SHORT: dict[str, Any] = {
    "pose_on": "neck",
    "first_colors": "frames",
    "position_rate": 1e-2,
    "color_rate": 5e-3,
    "sh_degree": 1,
    "perceptual_mode": "crops",
    "crop_side": 96,
    "crop_probability": 0.1,
}
"""What a training of a few thousand steps on a CPU changes, as `ggavatar.SHORT` does for our method.

The schedule stays GaussianAvatars' own: at 1,500 steps it is 0.3 dB better than that of the GGAvatar paper.
"""

VARIANTS: dict[str, dict[str, Any]] = {
    "with_perceptual": {"perceptual_weight": 0.02},
    "without_finetuning": {"finetuning": False},
    "own_schedule": OWN,
    "seed_schedule": SEED,
}

PRESETS: dict[str, dict[str, Any]] = {"default": SHORT, "fast": SHORT, "paper": SEED}


def build(config: Config, scene: Scene) -> GaussianAvatars:
    """The avatar before its first step."""
    avatar = GaussianAvatars(config, scene).to(scene.background.device)
    if config.first_colors == "frames":
        color_from_frames(avatar.rows, avatar.gaussians, scene)
    return avatar


class GaussianAvatars(nn.Module):
    """The avatar: rows of Gaussians in the spaces of their triangles, and corrections of training frames."""

    steps_done: Tensor

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
        self.perceptual = PerceptualTerm(
            config.perceptual_weight, crops if config.perceptual_mode == "crops" else None, scene.seed
        )
        self.register_buffer("steps_done", torch.zeros((), dtype=torch.int64))

    def gaussians(self, drive: Drive) -> Gaussians:
        """The avatar posed by `drive`, in world space; a training frame's drive is corrected first (Sec. 3.2, 3.4)."""
        rows, frames = self.rows, self._face_frames(drive)
        means, quats, scales = bind(rows["means"], rows["quats"], rows["log_scales"], rows["face"], frames)
        sh = harmonics(rows)
        return Gaussians(means, quats, scales, rows["opacity_logits"].sigmoid(), sh, self._sh_degree())

    def losses(self, frame: Frame, rendering: Rendering, step: int) -> Mapping[str, Tensor]:
        """The image loss and the two regularizers (Sec. 3.4); the perceptual loss where it was asked for."""
        config, rows = self.config, self.rows
        visible = rendering.radii > 0
        terms = {
            **image_terms(rendering.image, frame.image, config.dssim_share)._asdict(),
            "position": config.position_weight
            * position_regularizer(rows["means"], visible, config.position_threshold),
            "scale": config.scale_weight * log_scale_regularizer(rows["log_scales"], visible, config.scale_threshold),
        }
        if config.perceptual_weight and step > config.perceptual_share * self.scene.steps:
            boxes = region_boxes(self.head, frame) if self.perceptual.crops else []
            terms.update(self.perceptual(rendering.image, frame.image, step, boxes))
        return terms

    def optimizers(self) -> list[torch.optim.Optimizer]:
        """Adam on the rows and Adam on the corrections."""
        return [self.rows.optimizer, *([self.corrections.optimizer] if self.corrections else [])]

    @torch.no_grad()
    def after_backward(self, rendering: Rendering, step: int) -> None:
        """Density control after `step`; rates and degree of the next."""
        if self.density.is_active(step):
            accumulate(self.rows, rendering)
            self.density.apply(self.rows, step, self.face_scales, seeded(self.scene.seed, 2, step))
        self.rows.set_rate("means", position_rate(self.config, self.scene, step))
        self.steps_done.fill_(step)

    def notes(self) -> dict[str, str]:
        """Which features the perceptual loss used."""
        return self.perceptual.notes()

    def _face_frames(self, drive: Drive) -> TriangleFrames:
        """Frames of the triangles of the tracked head; gradients reach the corrections of a training frame."""
        if self.corrections is None or not self.corrections.corrects(drive):
            with torch.no_grad():
                return self._tracked_frames(drive)
        return self._tracked_frames(self.corrections(drive))

    def _tracked_frames(self, drive: Drive) -> TriangleFrames:
        vertices = self.head.vertices(drive)
        if self.config.pose_on == "neck":
            vertices = self.poses.hold_torso(vertices, drive, self.head)
        return triangle_frames(vertices, self.head.faces)

    def _sh_degree(self) -> int:
        """Degree in use: one more every `sh_iterations`."""
        return degree_in_use(
            self.steps_done,
            scaled(self.config.sh_iterations, self.scene.steps, self.config.iterations),
            self.config.sh_degree,
        )


def drive_corrections(config: Config, scene: Scene) -> DriveCorrections | None:
    """Corrections of zero for the training frames, if there are any."""
    if not config.finetuning or not any(drive.frame is not None for drive in scene.drives):
        return None
    rates = CorrectionRates(config.expression_rate, config.joint_rate, config.translation_rate)
    return DriveCorrections(scene.drives, rates)


def density_control(config: Config, scene: Scene) -> DensityControl:
    """The density schedule scaled to this training; short trainings keep enough rounds and drop the resets."""
    start = scaled(config.density_start, scene.steps, config.iterations)
    stop = scaled(config.density_stop, scene.steps, config.iterations)
    wanted = scaled(config.density_interval, scene.steps, config.iterations)
    interval = max(min(max(20, wanted), (stop - start) // 30), 10)
    return DensityControl(
        start=start,
        stop=stop,
        interval=interval,
        reset_interval=max(scaled(config.reset_iterations, scene.steps, config.iterations), 10 * interval),
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
