"""PointAvatar (Zheng et al. 2023): canonical points with learned deformation, albedo and normals, rendered as discs.

Internal lengths are quarter meters, as in the authors' code, whose FLAME is four times as large (`UNITS_PER_METER`).
Where a tracker keeps the head still and moves the camera, the authors' static joint is the torso in front of the camera
and normals are shaded in camera axes: the same up to a rigid transform of the scene.
"""

from __future__ import annotations

import functools
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Literal, NamedTuple

import torch
from jaxtyping import Float
from torch import Tensor
from torch.nn.functional import interpolate, mse_loss, normalize

from ggavatar.core import Drive, Frame, Rasterizer, Rendering
from ggavatar.data.scene import Scene
from ggavatar.head.head_pose import HeadPoses
from ggavatar.head.region_boxes import RegionBoxes
from ggavatar.jit.bfloat16 import matmul_dtype
from ggavatar.jit.constants import to_device
from ggavatar.losses.crop_sampler import CropSampler
from ggavatar.losses.terms import l1
from ggavatar.losses.vgg import FeatureChoice
from ggavatar.losses.vgg_term import PerceptualTerm
from ggavatar.optim.schedules import log_linear
from ggavatar.optim.seeding import seeded
from ggavatar.optim.step_counter import StepCounter
from ggavatar.optim.tracking_corrections import CorrectionRates, DriveCorrections
from ggavatar.points.canonical import CanonicalNetwork, Surface
from ggavatar.points.canonical_reference import CanonicalConfig
from ggavatar.points.deformer import Features, PointDeformer
from ggavatar.points.driving import PosedSkeleton, SkeletonDriver, canonical_drive, expression_coefficients
from ggavatar.points.head_fitting import HeadSurface, fit_to_head
from ggavatar.points.head_targets import HeadTargets
from ggavatar.points.point_cloud import CloudSchedule, PointCloud
from ggavatar.points.rowwise import rowwise
from ggavatar.points.shading import ShadingNetwork, shaded
from ggavatar.points.skinning import deform, deformed_normals
from ggavatar.render.discs.rasterizer import rasterizer as disc_rasterizer
from ggavatar.render.discs.values import DiscRendering, Discs, similar_scale

UNITS_PER_METER = 4.0
"""Units of length of points and networks per meter."""

PERCEPTUAL_SIZE = 224
"""Side of the images that VGG compares, px."""

FITTING_POINTS = 20_000
"""Points on the head model at which the networks are fitted."""


@dataclass(frozen=True)
class Config:
    """All settings of the method. Epochs refer to the authors' 62 and scale with the length of the training."""

    points: int = 400
    """Initial number of points (authors' code)."""
    sphere: float = 0.5
    """Radius of the initial sphere of points, quarter meters (authors' code)."""
    begin: Literal["sphere", "head"] = "sphere"
    """Initial points: on the sphere (authors' code), or on the head model in the canonical pose (ours)."""
    fitting_steps: int = 0
    """Steps that fit the networks to the head model before training; 0 is none (authors)."""
    radius_factor: float = 0.3
    """Radius of the discs of 100 points, normalized device coordinates (authors' code)."""
    max_points: int = 240_000
    """Maximum number of points (GGAvatar, Sec. 4.1); --max-gaussians applies too."""
    epochs: int = 62
    """Length of the training (authors' code; A34)."""
    upsampling_epochs: int = 5
    """Epochs between two doublings (authors' code)."""
    pruning_frames: int = 1
    """Minimum number of frames between prunings, which otherwise happen every epoch (ours, for short epochs)."""
    pruning_radius: float = 0.006
    """Radius of discs below which points are not pruned, normalized device coordinates (authors' code)."""

    rate: float = 1e-4
    """Learning rate of points and networks (authors' code)."""
    rate_left: float = 1.0
    """Final rate as a fraction of the initial one; the authors' decay has no effect, because they recreate Adam."""
    tracking_rate: float = 5e-4
    """Learning rate of corrections of the tracking, rad and quarter meters; 0 is none (authors' code)."""
    tracking_epochs: int = 10
    """Epochs before tracking corrections start (authors' code)."""
    jaw: float = 0.4
    """Opening of the jaw in the canonical pose, rad; its expression is the mean one (authors' code)."""
    pose_on: Literal["camera", "neck"] = "camera"
    """What the head model's root joint follows: the head (the authors), or the torso, as in ggavatar (A12)."""

    surface_width: int = 256
    """Width of the canonical network's hidden layers (authors' code)."""
    surface_layers: int = 9
    """Number of hidden layers, more than four (authors' code)."""
    surface_octaves: int = 6
    """Octaves of its positional encoding (authors' code)."""
    normals: Literal["jacobian", "joints"] = "jacobian"
    """Normals by the Jacobian of the deformation (authors), or by the joints only (ours, a quarter of the cost)."""
    hidden_type: Literal["float32", "fastest"] = "float32"
    """Hidden layers of the canonical network in float32 (code), or in bfloat16 on CPUs that support it (ours)."""

    mask_weight: float = 1.0
    """Weight of the mean absolute difference between coverage and mask (authors' code)."""
    perceptual_weight: float = 0.1
    """Weight of the VGG loss (authors' code)."""
    perceptual_features: FeatureChoice = "vgg16"
    """Features of the perceptual loss: `vgg16`, an untrained stand-in (`random`), or the `best` that can be had."""
    perceptual_mode: Literal["image", "crops"] = "image"
    """VGG loss on the image resized to 224 px, or on crops in some steps with the same expected weight."""
    crop_side: int = 64
    """Side of a crop, px."""
    crop_probability: float = 0.5
    """Fraction of the steps with a crop."""
    distance_weight: float = 1.0
    """Weight of the mean squared signed distance of points (authors' code)."""
    eikonal_weight: float = 0.1
    """Weight of the mean squared deviation of the gradient's length from 1 (authors' code)."""
    neighbours: float = 0.25
    """Maximum distance per axis of the random neighbors in the eikonal loss, quarter meters (authors' code)."""
    head_weight: float = 10.0
    """Weight of the head model's targets, halved at every milestone (authors' code)."""
    head_milestones: tuple[int, ...] = (10, 20, 30, 40)
    """Epochs at which `head_weight` is halved (authors' code)."""
    regularised: int = 0
    """Random points per step for the surface and head-model terms, unbiased; 0 is all points."""


TABLE_NOTES = ("one frame per step, where the authors' code has up to eight",)
"""Deviations from the paper, which tables print as footnotes."""

SHORT_TRAINING: dict[str, Any] = {
    "perceptual_features": "best",
    "max_points": 20_000,
    "pruning_frames": 100,
    "rate": 1e-3,
    "rate_left": 0.1,
    "hidden_type": "fastest",
    "perceptual_mode": "crops",
    "regularised": 256,
}
"""Changes for trainings of a few thousand steps on a CPU.

Measured in docs/experiments/2026-11-28-point-avatar-fast-preset.md.
"""

FAST_TRAINING: dict[str, Any] = SHORT_TRAINING | {
    "points": 4_000,
    "begin": "head",
    "fitting_steps": 200,
    "radius_factor": 0.2,
    "max_points": 10_000,
    "surface_width": 128,
    "surface_layers": 6,
}
"""Changes for trainings of a few minutes."""

PRESETS: dict[str, dict[str, Any]] = {"default": SHORT_TRAINING, "fast": FAST_TRAINING, "paper": {}}


def build(config: Config, scene: Scene) -> PointAvatar:
    """The avatar before its first step."""
    return PointAvatar(config, scene).to(scene.background.device)


def rasterizer(device: torch.device | str, backend: str = "auto") -> Rasterizer:
    """The rasterizer of this method's discs."""
    return disc_rasterizer(device, backend)


class Canonical(NamedTuple):
    """Drive-independent properties of the points."""

    surface: Surface
    features: Features | None


class PointAvatar(StepCounter):
    """The avatar: points, and the networks of their surface, deformation and shading."""

    def __init__(self, config: Config, scene: Scene) -> None:
        super().__init__()
        self.config, self.scene, self.head = config, scene, scene.head
        drives = scene.drives or (self.head.neutral_drive(),)
        canonical = canonical_drive(self.head, drives, config.jaw)
        poses = HeadPoses.of(self.head, drives)
        self.driver = SkeletonDriver(self.head, canonical, poses, UNITS_PER_METER, config.pose_on == "neck")
        coefficients = torch.stack([expression_coefficients(drive) for drive in drives])
        self.targets = HeadTargets.of(self.head, canonical, coefficients, UNITS_PER_METER)
        self.canonical = canonical
        self.cloud = PointCloud(
            self._first_count(),
            config.sphere,
            config.radius_factor,
            config.rate,
            self._generator(1),
            self._initial_points(),
        )
        hidden_type = matmul_dtype(scene.background.device) if config.hidden_type == "fastest" else None
        sizes = CanonicalConfig(config.surface_width, config.surface_layers, octaves=config.surface_octaves)
        self.surface = CanonicalNetwork(sizes, self._generator(2), hidden_type)
        shapes = len(self.targets.blendshapes[0])
        self.deformer = PointDeformer(shapes, len(self.head.parents) + 1, self._generator(3))
        self.shading = ShadingNetwork(self._generator(4))
        self.corrections = corrections(config, scene)
        crops = CropSampler(config.crop_side, config.crop_probability) if config.perceptual_mode == "crops" else None
        self.boxes = RegionBoxes(self.head)
        self.perceptual = PerceptualTerm(
            config.perceptual_weight, crops, scene.seed, features=config.perceptual_features
        )
        self.schedule = cloud_schedule(config, scene)
        self.meters = meters_per_device_unit(scene)
        self._cached: Canonical | None = None
        self._surface_at_points: Surface | None = None

    @property
    def epoch(self) -> int:
        """Epoch of the next step, from 0."""
        return int(self.steps_done) // self.schedule.steps_per_epoch

    def gaussians(self, drive: Drive) -> Discs:
        """The points posed by `drive`, in world space, with their shaded colors."""
        drive = self._corrected(drive)
        canonical, pose = self._canonical(), self.driver.posed_skeleton(drive)
        if torch.is_grad_enabled():
            parameters = [*self.deformer.parameters(), *self.shading.parameters()]
            points, colors = rowwise(self._pose_rows, (self.cloud.points, *canonical.surface[1:]), pose, parameters)
        else:
            points, colors = self._posed(self.cloud.points, canonical, pose)
        means, radius = points / UNITS_PER_METER + drive.translation, float(self.cloud.radius)
        one = torch.ones_like(means)
        quats = torch.cat((one[:, :1], torch.zeros_like(one)), dim=1)
        return Discs(means, quats, similar_scale(radius, self.meters) * one, one[:, 0], colors, radius=radius)

    def losses(self, frame: Frame, rendering: Rendering, step: int) -> Mapping[str, Tensor]:
        """Image, coverage and VGG terms, two surface terms and three head-model terms."""
        config = self.config
        terms = {"l1": l1(rendering.image, frame.image), "mask": config.mask_weight * l1(rendering.alpha, frame.alpha)}
        if config.perceptual_weight:
            terms |= self._perceptual_term(frame, rendering, step)
        count, generator = len(self.cloud.points), seeded(self.scene.seed, 5, step)
        some = torch.randperm(count, generator=generator)[: config.regularised or count]
        some = to_device(some, rendering.image.device)
        terms |= self._surface_terms(some, generator)
        weight = config.head_weight * 0.5 ** sum(milestone <= self.epoch for milestone in config.head_milestones)
        points = self.cloud.points[some]
        bases = self.deformer.bases(points)
        targets = self.targets.losses(bases, points + bases.offsets)
        return terms | {name: weight * value for name, value in targets.items()}

    @functools.cached_property
    def optimizer(self) -> torch.optim.Optimizer:
        """Adam for the networks, made when it is first used."""
        networks = [*self.surface.parameters(), *self.deformer.parameters(), *self.shading.parameters()]
        return torch.optim.Adam(networks, lr=self.config.rate, betas=(0.9, 0.999), eps=1e-8, fused=True)

    @functools.cached_property
    def corrections_optimizer(self) -> torch.optim.Optimizer | None:
        """The authors' SparseAdam, made when it is first used; None without corrections."""
        return sparse_adam(self.config, self.corrections) if self.corrections is not None else None

    def optimizers(self) -> list[torch.optim.Optimizer]:
        """Adam for the points, Adam for the networks, and the optimizer of the corrections."""
        further = [self.corrections_optimizer] if self.corrections_optimizer else []
        return [self.cloud.rows.optimizer, self.optimizer, *further]

    @torch.no_grad()
    def after_backward(self, rendering: Rendering, step: int) -> None:
        """Prune and double the points, then set the rate of the next step."""
        assert isinstance(rendering, DiscRendering)
        self.cloud.advance(step, rendering.shown, self.schedule, seeded(self.scene.seed, 6, step))
        rate = log_linear(step, self.config.rate, self.config.rate * self.config.rate_left, self.scene.steps)
        for optimizer in (self.cloud.rows.optimizer, self.optimizer):
            for group in optimizer.param_groups:
                group["lr"] = rate
        self._surface_at_points = None
        self.steps_done.fill_(step)

    def train(self, mode: bool = True) -> PointAvatar:
        """Switch between training and evaluation, which caches drive-independent properties; fit before step 1."""
        self._cached = None
        if mode and self.config.fitting_steps and not int(self.steps_done):
            self._fit_to_head()
        return super().train(mode)

    def notes(self) -> dict[str, str]:
        """Notes for provenance.json: the features of the perceptual loss, and the radius of the discs."""
        return self.perceptual.notes() | {"disc_radius": f"{float(self.cloud.radius):.5f} of half the shorter side"}

    def _first_count(self) -> int:
        """Initial number of points."""
        return min(self.config.points, self.scene.max_gaussians)

    def _initial_points(self) -> Tensor | None:
        """Initial points on the head model; None for a sphere."""
        if self.config.begin == "sphere":
            return None
        return HeadSurface.of(
            self.head, self.canonical, UNITS_PER_METER, self._first_count(), self._generator(1)
        ).points

    def _fit_to_head(self) -> None:
        """Fit the networks to the head model."""
        random = self._generator(8)
        surface = HeadSurface.of(self.head, self.canonical, UNITS_PER_METER, FITTING_POINTS, random)
        fit_to_head((self.surface, self.deformer), surface, self.targets, self.config.fitting_steps, random)

    def _features(self, points: Tensor) -> Features:
        """Features of the deformation, with or without derivatives."""
        if self.config.normals == "joints":
            return self.deformer.features_without_tangents(points)
        return self.deformer.features(points)

    def _canonical(self) -> Canonical:
        """The surface at all points and, without gradients, the features of their deformation."""
        points = self.cloud.points
        if torch.is_grad_enabled():
            self._surface_at_points = self.surface(points)
            return Canonical(self._surface_at_points, None)
        if self._cached is None or self.training:
            self._cached = Canonical(self.surface(points), self._features(points))
        return self._cached

    def _pose_rows(self, rows: Sequence[Tensor], shared: Sequence[Tensor]) -> tuple[Tensor, Tensor]:
        """Posed points and their colors, from rows of points, distance gradients and albedo."""
        points, gradient, albedo = rows
        canonical = Canonical(Surface(albedo[:, 0], gradient, albedo), self._features(points))
        return self._posed(points, canonical, PosedSkeleton(*shared))

    def _posed(self, points: Tensor, canonical: Canonical, pose: PosedSkeleton) -> tuple[Tensor, Tensor]:
        """Posed points, quarter meters, and their colors."""
        assert canonical.features is not None
        deformation = self.deformer.deformation(canonical.features, pose.correctives)
        deformed = deform(points, deformation, pose.canonical, pose.posed)
        normals = deformed_normals(deformed.tangents, normalize(canonical.surface.gradient, dim=-1))
        return deformed.points, shaded(self.shading(normals @ pose.head_to_camera.T), canonical.surface.albedo)

    def _surface_terms(self, some: Tensor, generator: torch.Generator) -> dict[str, Tensor]:
        """Loss: points lie on the surface, whose gradient has length 1 at and around them."""
        assert self._surface_at_points is not None, "call gaussians() before losses() in every step"
        points = self.cloud.points[some].detach()
        noise = to_device(torch.rand(points.shape, generator=generator), points.device) - 0.5
        around = self.surface(points + 2 * self.config.neighbours * noise).gradient
        lengths = torch.cat((self._surface_at_points.gradient[some], around)).norm(dim=1)
        return {
            "distance": self.config.distance_weight * self._surface_at_points.distance[some].square().mean(),
            "eikonal": self.config.eikonal_weight * mse_loss(lengths, torch.ones_like(lengths)),
        }

    def _perceptual_term(self, frame: Frame, rendering: Rendering, step: int) -> dict[str, Tensor]:
        if self.config.perceptual_mode == "crops":
            return self.perceptual(rendering.image, frame.image, step, self.boxes.of(frame))
        return self.perceptual(_resized(rendering.image), _resized(frame.image), step)

    def _corrected(self, drive: Drive) -> Drive:
        """The drive with the corrections of its training frame, which are trained after `tracking_epochs`."""
        if self.corrections is None:
            return drive
        with torch.set_grad_enabled(torch.is_grad_enabled() and self.epoch > self.config.tracking_epochs):
            return self.corrections(drive)

    def _generator(self, stream: int) -> torch.Generator:
        return seeded(self.scene.seed, 7, stream)


def cloud_schedule(config: Config, scene: Scene) -> CloudSchedule:
    """The authors' schedule in steps, with at least `pruning_frames` between prunings."""
    epoch = max(scene.steps // config.epochs, 1)
    pruning = epoch * max(-(-config.pruning_frames // epoch), 1)
    max_points = min(config.max_points, scene.max_gaussians)
    return CloudSchedule(epoch, config.upsampling_epochs, pruning, max_points, config.pruning_radius)


def corrections(config: Config, scene: Scene) -> DriveCorrections | None:
    """Corrections of expression, joints and translation of the training frames, or None."""
    if not config.tracking_rate or not any(drive.frame is not None for drive in scene.drives):
        return None
    rate = config.tracking_rate
    module = DriveCorrections(scene.drives, CorrectionRates(rate, rate, rate / UNITS_PER_METER))
    for parameter in module.parameters():
        parameter.register_post_accumulate_grad_hook(_make_sparse)
    return module


def sparse_adam(config: Config, module: DriveCorrections) -> torch.optim.Optimizer:
    """The authors' SparseAdam: corrections and moments of a frame change only in steps that use the frame."""
    return torch.optim.SparseAdam(module.groups, lr=config.tracking_rate)


def _make_sparse(parameter: Tensor) -> None:
    if parameter.grad is not None:
        parameter.grad = parameter.grad.to_sparse(1)


def meters_per_device_unit(scene: Scene) -> float:
    """Half the shorter image side, projected to the head's origin, m; mean over the training cameras."""
    lengths = [
        float(camera.world_to_camera[2, 3] * min(camera.width, camera.height) / 2 / camera.intrinsics[0, 0])
        for camera in scene.cameras
    ]
    return sum(lengths) / len(lengths) if lengths else 1.0


def _resized(image: Float[Tensor, "H W 3"]) -> Float[Tensor, "P P 3"]:
    """The image resized to `PERCEPTUAL_SIZE`."""
    size = (PERCEPTUAL_SIZE, PERCEPTUAL_SIZE)
    return interpolate(image.permute(2, 0, 1)[None], size, mode="bilinear", align_corners=False)[0].permute(1, 2, 0)
