"""SplattingAvatar (Shao et al. 2024): Gaussians embedded on the head mesh, over which the optimizer walks them.

Z. Shao et al., "SplattingAvatar: Realistic Real-Time Human Avatars with Mesh-Embedded Gaussian Splatting", CVPR 2024,
https://arxiv.org/abs/2403.05087; from its equations, and the constants of its public code.

    1. A Gaussian is on a triangle, at barycentric coordinates, in some distance along the smooth normal (Sec. 3.1).
    2. Its rotation is blended from those of the vertices; its scale follows the area of its triangle (Sec. 3.2).
    3. Lifted optimization (Sec. 3.3): gradients flow into the coordinates; a Gaussian that leaves its triangle walks on
       across the edge. In the public code no gradient reaches them (variant `code`).
    4. Density control as in 3D Gaussian Splatting; children of a split are placed on the mesh.

There are no networks and no conditions: all motion is that of the mesh. The authors draw a random background in every
step. Here frames are composited already, but `losses` moves both images to another background exactly, by their alpha.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Literal

import torch
from torch import Tensor
from torch.nn.functional import mse_loss

from ggavatar.core import Drive, Frame, Gaussians, Rendering
from ggavatar.data.scene import Scene
from ggavatar.gaussians.density_control import DensityControl, accumulate, scaled_schedule, statistics
from ggavatar.gaussians.embedding import (
    AUTHORS_UNITS_PER_METER,
    EmbeddedSplit,
    Places,
    RestMesh,
    ScaleRule,
    absorb_slides,
    embed,
    scaling_regularizer,
)
from ggavatar.gaussians.initialization import faces_seen, neighbor_distance
from ggavatar.gaussians.spherical_harmonics import color_from_frames
from ggavatar.geometry.triangle_walk import neighbors
from ggavatar.geometry.uv_sampling import SurfaceSamples, face_areas, strip_samples
from ggavatar.head.head_pose import HeadPoses
from ggavatar.head.region_boxes import RegionBoxes
from ggavatar.jit.constants import to_device
from ggavatar.losses.crop_sampler import CropSampler
from ggavatar.losses.terms import l1
from ggavatar.losses.vgg import FeatureChoice
from ggavatar.losses.vgg_term import PerceptualTerm
from ggavatar.optim.parameters import Column, Rows
from ggavatar.optim.schedules import PAPER_STEPS, log_linear, scaled
from ggavatar.optim.seeding import seeded
from ggavatar.optim.step_counter import StepCounter


@dataclass(frozen=True)
class Config:
    """All settings of the method. Iterations refer to `iterations`; lengths are a quarter of those of the authors.

    Their FLAME is four times as large as ours, in m. "Code" is their public code.
    """

    iterations: int = 30_000
    """Length of the training that all iteration constants refer to (code)."""
    pose_on: Literal["camera", "neck"] = "camera"
    """What the head pose moves: the camera, as tracked, or the neck too, so that the torso stays still."""

    first_gaussians: int = 10_000
    """Initial number of Gaussians (code); at most half of --max-gaussians."""
    first_places: Literal["triangles", "seen"] = "triangles"
    """Initial places: random triangles (paper), or even by area on triangles that training frames can show (ours)."""
    first_colors: Literal["grey", "frames"] = "grey"
    """Initial colors: `grey` (code), or from a few training `frames`."""
    canonical: Literal["neutral", "first"] = "neutral"
    """The mesh at rest: the neutral head, or that of the first training frame (code)."""

    walking: Literal["lifted", "off"] = "lifted"
    """Whether gradients move Gaussians over the surface (Sec. 3.3), or not (code)."""
    walk_interval: int = 100
    """Iterations between two walks (code); short trainings: 20 steps, or 10 to 20 for 30 walks."""
    walk_decay: float = 0.9
    """Factor on what is left of a walk at every crossing of an edge (code)."""
    scale_by: ScaleRule = "area"
    """How scales follow the area of the triangle: its ratio to rest (Eq. 8), the root of it, `log` (code), or not."""
    area_damping: float = 6.25e-6
    """Added to both areas of that ratio, m² (code)."""

    displacement_rate: float = 4e-5
    """Learning rate of distances along the normal at the start, m (code)."""
    walk_rate: float = 1.6e-4
    """Learning rate of barycentric coordinates at the start, no unit (code)."""
    position_decay: float = 0.01
    """Final rates of distances and coordinates as a fraction of the initial ones (code)."""
    scale_rate: float = 5e-3
    """Learning rate of the logarithms of scales (code)."""
    rotation_rate: float = 1e-3
    """Learning rate of quaternions (code)."""
    opacity_rate: float = 0.05
    """Learning rate of opacity logits (code)."""
    color_rate: float = 2.5e-3
    """Learning rate of the constant spherical harmonic, the only one (code)."""

    density_start: int = 600
    """Density control starts after this iteration (code)."""
    density_stop: int = 29_000
    """Iteration at which density control and opacity resets end (code)."""
    density_interval: int = 100
    """Iterations between two rounds (code); short trainings: 20 steps, or 10 to 20 for 30 rounds."""
    density_gradient: float = 2e-4
    """Mean gradient norm of projected centers from which a Gaussian grows, normalized device coordinates (code)."""
    density_ramp: bool = False
    """Whether the budget becomes available evenly over the rounds (for short trainings) or at once (3DGS)."""
    reset_iterations: int = 3_000
    """Iterations between two opacity resets (code); none in trainings under 12,000 steps."""
    extent: float = 0.5
    """Extent of the scene, m: Gaussians over 1/100 of it are split, over 1/10 removed (what runs in the code)."""
    split_along_normal: bool = False
    """Whether children of a split move along the normal too; else they keep their parent's distance (code)."""

    mse_weight: float = 10.0
    """Weight of the mean squared difference (code; not printed); that of L1 is 1."""
    scaling_weight: float = 1.0
    """Weight of the scaling regularizer (code since June 2024), with its value in quarter meters."""
    scaling_threshold: float = 2e-3
    """Largest standard deviation up to which it is 0, m (Eq. 10, code)."""
    scaling_ratio: float = 10.0
    """Ratio of the largest to the smallest deviation up to which it is 0 (Eq. 10, code)."""
    perceptual_weight: float = 1e-3
    """Weight of the perceptual loss; the code has 0.01 of LPIPS, which is a tenth of this loss for similar images."""
    perceptual_features: FeatureChoice = "vgg16"
    """Features of the perceptual loss: `vgg16`, an untrained stand-in (`random`), or the `best` that can be had."""
    perceptual_mode: Literal["image", "crops"] = "image"
    """Perceptual loss on the whole image (code), or on crops in some steps with the same expected weight."""
    crop_side: int = 128
    """Side of a crop, px."""
    crop_probability: float = 0.2
    """Fraction of the steps with a crop."""


TABLE_NOTES = (
    "Eq. 8 as printed (scale times the ratio of areas), and gradients into barycentric coordinates (Sec. 3.3); the "
    "public code has neither",
    "VGG loss instead of LPIPS",
)
"""Deviations from the authors' code, which tables print as footnotes."""

VARIANTS: dict[str, dict[str, Any]] = {
    "code": {"walking": "off", "scale_by": "log", "canonical": "first"},
    "without_walk": {"walking": "off"},
    "without_area": {"scale_by": "none"},
}

SHORT_TRAINING: dict[str, Any] = {
    "perceptual_features": "best",
    "first_places": "seen",
    "first_colors": "frames",
    "displacement_rate": 1.5e-3,
    "walk_rate": 2e-2,
    "color_rate": 1e-2,
    "density_ramp": True,
    "perceptual_mode": "crops",
    "crop_side": 96,
    "crop_probability": 0.1,
}
"""Changes for trainings of a few thousand steps on a CPU.

Measured in docs/experiments/2026-12-01-splatting-avatar.md.
"""

PRESETS: dict[str, dict[str, Any]] = {"default": SHORT_TRAINING, "fast": SHORT_TRAINING, "paper": {}}


def build(config: Config, scene: Scene) -> SplattingAvatar:
    """The avatar before its first step."""
    avatar = SplattingAvatar(config, scene).to(scene.background.device)
    if config.first_colors == "frames":
        color_from_frames(avatar.rows, avatar.gaussians, scene)
    return avatar


class SplattingAvatar(StepCounter):
    """The avatar: rows of Gaussians embedded on the head mesh."""

    def __init__(self, config: Config, scene: Scene) -> None:
        super().__init__()
        self.config, self.scene, self.head = config, scene, scene.head
        self.poses = HeadPoses.of(self.head, scene.drives)
        self.mesh = neighbors(self.head.faces)
        self.boxes = RegionBoxes(self.head)
        self.rest = RestMesh.of(self._rest_vertices(), self.head.faces)
        self.rows = initial_rows(config, scene, self.rest, self.poses)
        self.density = density_control(
            config, scene, EmbeddedSplit(self.rest, self.mesh, config.walk_decay, config.split_along_normal)
        )
        self.walk_interval = interval(config.walk_interval, config, scene)
        crops = CropSampler(config.crop_side, config.crop_probability) if config.perceptual_mode == "crops" else None
        self.perceptual = PerceptualTerm(
            config.perceptual_weight, crops, scene.seed, features=config.perceptual_features
        )
        self._posed_scales: Tensor | None = None

    def gaussians(self, drive: Drive) -> Gaussians:
        """The avatar posed by `drive`, in world space (Eq. 1–8)."""
        rows, config = self.rows, self.config
        with torch.set_grad_enabled(torch.is_grad_enabled() and drive.requires_grad):
            posed = self.rest.posed(self._vertices(drive))
        places = Places.of(rows) if config.walking == "lifted" else self._places_of_code()
        placed = embed(
            places, rows["quats"], rows["log_scales"], self.rest, posed, config.scale_by, config.area_damping
        )
        self._posed_scales = placed.scales if torch.is_grad_enabled() else None
        return Gaussians(*placed, rows["opacity_logits"].sigmoid(), rows["sh"], 0)

    def losses(self, frame: Frame, rendering: Rendering, step: int) -> Mapping[str, Tensor]:
        """L1, squared error and perceptual loss on a random background, and the scaling regularizer (Eq. 9, 10)."""
        assert self._posed_scales is not None, "call gaussians() before losses() in every step"
        config = self.config
        color = torch.rand(3, generator=seeded(self.scene.seed, 5, step), dtype=frame.image.dtype)
        change = to_device(color, frame.image.device) - self.scene.background
        image = rendering.image + (1 - rendering.alpha) * change
        target = frame.image + (1 - frame.alpha) * change
        regularizer = scaling_regularizer(self._posed_scales, config.scaling_threshold, config.scaling_ratio)
        terms = {
            "l1": l1(image, target),
            "mse": config.mse_weight * mse_loss(image, target),
            "scaling": config.scaling_weight * AUTHORS_UNITS_PER_METER * regularizer,
        }
        if config.perceptual_weight:
            boxes = self.boxes.of(frame) if self.perceptual.crops else []
            terms.update(self.perceptual(image * frame.alpha, target * frame.alpha, step, boxes))
        return terms

    def optimizers(self) -> list[torch.optim.Optimizer]:
        """Adam for the rows."""
        return [self.rows.optimizer]

    @torch.no_grad()
    def after_backward(self, rendering: Rendering, step: int) -> None:
        """Density control after `step`, then the walk, then the rates of `step + 1`."""
        if self.density.is_active(step):
            accumulate(self.rows, rendering)
            unit = torch.ones(len(self.head.faces), device=self.head.faces.device)
            self.density.apply(self.rows, step, unit, seeded(self.scene.seed, 2, step))
        if self.config.walking == "lifted" and step % self.walk_interval == 0:
            absorb_slides(self.rows, self.mesh, self.config.walk_decay)
        for column, first in (("distances", self.config.displacement_rate), ("slides", self.config.walk_rate)):
            self.rows.set_rate(column, log_linear(step, first, first * self.config.position_decay, self.scene.steps))
        self._posed_scales = None
        self.steps_done.fill_(step)

    def notes(self) -> dict[str, str]:
        """Notes for provenance.json: the features of the perceptual loss."""
        return self.perceptual.notes()

    def _places_of_code(self) -> Places:
        """The places without their slides, which get no gradient."""
        return Places(self.rows["face"], self.rows["weights"], self.rows["distances"])

    def _rest_vertices(self) -> Tensor:
        if self.config.canonical == "first" and self.scene.drives:
            return self._vertices(self.scene.drives[0]).detach()
        return self.head.neutral()

    def _vertices(self, drive: Drive) -> Tensor:
        vertices = self.head.vertices(drive)
        if self.config.pose_on == "neck":
            vertices = self.poses.hold_torso(vertices, drive, self.head)
        return vertices


def initial_rows(config: Config, scene: Scene, rest: RestMesh, poses: HeadPoses) -> Rows:
    """Gray Gaussians of opacity 0.1 on the mesh, as large as their spacing at rest."""
    samples = first_samples(config, scene, rest, poses)
    count, like = len(samples.face), samples.weights
    sizes = neighbor_distance(samples.points(rest.vertices, rest.faces))
    learnable = {
        "distances": Column(like.new_zeros(count), config.displacement_rate),
        "slides": Column(like.new_zeros(count, 2), config.walk_rate),
        "quats": Column(like.new_tensor([1.0, 0.0, 0.0, 0.0]).repeat(count, 1), config.rotation_rate),
        "log_scales": Column(sizes.log()[:, None].expand(-1, 3), config.scale_rate),
        "opacity_logits": Column(like.new_full((count,), 0.1).logit(), config.opacity_rate),
        "sh": Column(like.new_zeros(count, 1, 3), config.color_rate),
    }
    carried = {"face": samples.face, "weights": samples.weights, **statistics(count, like.device)}
    return Rows(learnable, carried)


def first_samples(config: Config, scene: Scene, rest: RestMesh, poses: HeadPoses) -> SurfaceSamples:
    """Initial places: random ones in random triangles, as in the code, or even by area where frames can show them."""
    count = min(config.first_gaussians, max(scene.max_gaussians // 2, 1))
    if config.first_places == "seen":
        room = face_areas(rest.vertices, rest.faces) * faces_seen(scene, poses)
        return strip_samples(rest.vertices, rest.faces, room, count)
    generator = seeded(scene.seed, 4)
    face = torch.randint(len(rest.faces), (count,), generator=generator)
    first, share = torch.rand(2, count, generator=generator)
    second = share * (1 - first)
    weights = torch.stack((first, second, 1 - first - second), dim=1)
    order = torch.rand(count, 3, generator=generator).argsort(1)
    return SurfaceSamples(face.to(rest.faces.device), weights.gather(1, order).clamp_min(0).to(rest.vertices))


def density_control(config: Config, scene: Scene, splitter: EmbeddedSplit) -> DensityControl:
    """The density schedule scaled to this training, in m; short trainings have no opacity resets."""
    iterations = config.density_start, config.density_stop, config.density_interval, config.reset_iterations
    return DensityControl(
        *scaled_schedule(*iterations, scene.steps, config.iterations),
        resetting=scene.steps >= PAPER_STEPS // 10,
        gradient=config.density_gradient,
        extent=config.extent,
        budget=scene.max_gaussians,
        ramp=config.density_ramp,
        splitter=splitter,
        keep_last=False,
    )


def interval(iterations: int, config: Config, scene: Scene) -> int:
    """An interval scaled to this training; short trainings have one of 20 steps, or of 10 to 20 for 30 in all."""
    return max(min(max(20, scaled(iterations, scene.steps, config.iterations)), scene.steps // 30), 10)
