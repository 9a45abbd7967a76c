"""PSAvatar (Zhao et al. 2024): a point-based morphable shape on and off the head mesh, aligned, then splatted.

Z. Zhao et al., "PSAvatar: A Point-based Morphable Shape Model for Real-Time Head Animation with 3D Gaussian Splatting",
https://arxiv.org/abs/2401.12900. No code was published, so this is a reconstruction: the structure is that of its
figure, its abstract and notes of its readers, and every number is ours, or 3D Gaussian Splatting's (3DGS).

    1. Points lie on the head mesh and off it, along its normals: hair, glasses and a collar, which the model has not.
    2. A point moves by the bases and the skinning of the mesh at its place, and by learned corrections of the bases.
    3. Analysis by synthesis: translucent round points are rendered and aligned with the frames. Those that nothing
       needs become transparent and are removed; none is ever added.
    4. Those that are left become 3D Gaussians with sizes and rotations of their own, which give the detail.

There is no network. The round points are Gaussians, with the integral of PointAvatar's discs α = 1 − d²/r².
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Literal

import torch
from torch import Tensor
from torch.nn.functional import normalize

from ggavatar.core import Drive, Frame, Gaussians, Rendering
from ggavatar.data.scene import Scene
from ggavatar.gaussians.initialization import faces_seen, neighbor_distance
from ggavatar.gaussians.spherical_harmonics import color_from_frames, degree_in_use, harmonics
from ggavatar.geometry.transforms import quaternion_multiply
from ggavatar.geometry.uv_sampling import face_areas
from ggavatar.head.head_pose import HeadPoses
from ggavatar.head.model import HeadModel
from ggavatar.head.region_boxes import RegionBoxes
from ggavatar.losses.crop_sampler import CropSampler
from ggavatar.losses.dssim import image_terms
from ggavatar.losses.terms import l1
from ggavatar.losses.vgg import FeatureChoice
from ggavatar.losses.vgg_term import PerceptualTerm
from ggavatar.optim.parameters import Column, Rows
from ggavatar.optim.schedules import log_linear, scaled
from ggavatar.optim.seeding import seeded
from ggavatar.optim.step_counter import StepCounter
from ggavatar.points.morphable_shape import CorrectionBases, pose_along_normals, pose_points, skinned_mesh
from ggavatar.points.shell import Shell, ShellRanges, sample_shell


@dataclass(frozen=True)
class Config:
    """All settings of the method. "Ours" are choices where the paper is not known; iterations refer to `iterations`."""

    iterations: int = 30_000
    """Length of the training that all iteration constants refer to (3DGS)."""
    pose_on: Literal["camera", "neck"] = "camera"
    """What the head pose moves: the camera, as tracked, or the neck too, so that the torso stays still."""

    points: int = 100_000
    """Initial number of points (ours; PointAvatar has up to 400,000); --max-gaussians applies too."""
    off_share: float = 0.5
    """Share of the points that are off the skin (ours; the paper's figure shows both dense)."""
    lowest_off_face: float = -0.005
    """Lowest offset of points off the face, m (ours)."""
    highest_off_face: float = 0.015
    """Highest offset of points off the face, m (ours; glasses in the paper's figure are 10 to 20 mm off it)."""
    highest_off_rest: float = 0.06
    """Highest offset of points off scalp, ears, neck and shoulders, m (ours, measured in the paper's figure)."""
    first_places: Literal["surface", "seen"] = "surface"
    """Triangles that points are drawn from by area: all of them (paper), or those that training frames can show."""
    first_colors: Literal["grey", "frames"] = "grey"
    """Initial colors: `grey` (the paper's figure), or from a few training `frames`."""
    first_opacity: float = 0.2
    """Initial opacity (ours; the paper's figure shows a translucent cloud)."""

    follow: Literal["skin", "normal"] = "skin"
    """What carries points off the skin: the skinning at their place (one reader), or the posed normal (another)."""
    free: bool = True
    """Whether points may leave the place where they were drawn (ours: glasses of the figure lie on no such grid)."""
    corrections: bool = True
    """Whether corrections of the bases are learned (readers)."""

    stage_share: float = 0.25
    """Fraction of the training in which points are aligned, before they become Gaussians (ours)."""
    first_size: float = 1.0
    """Standard deviation of round points at the start, as a share of the distance of their neighbors (ours)."""
    last_size: float = 0.5
    """The same at the end of the alignment, and of the Gaussians at their start (ours)."""

    position_rate: float = 1.6e-4
    """Learning rate of displacements of points in the alignment, m (3DGS)."""
    fine_position_rate: float = 1.6e-5
    """Learning rate of displacements of Gaussians at the start, m (ours)."""
    position_decay: float = 0.01
    """Final value of either rate, at the end of its stage, as a fraction of the initial one (3DGS)."""
    basis_rate: float = 1e-4
    """Learning rate of corrections of the bases in the alignment, m per unit of the most moving coefficient (ours)."""
    fine_basis_rate: float = 1e-5
    """The same rate from the end of the alignment on, reached by then (ours)."""
    scale_rate: float = 5e-3
    """Learning rate of the logarithms of scales (3DGS)."""
    rotation_rate: float = 1e-3
    """Learning rate of quaternions (3DGS)."""
    opacity_rate: float = 0.05
    """Learning rate of opacity logits (3DGS)."""
    color_rate: float = 2.5e-3
    """Learning rate of the constant spherical harmonic; the rate of the others is 1/20 of it (3DGS)."""
    sh_degree: int = 3
    """Highest degree of the spherical harmonics of the Gaussians, 0 to 3 (3DGS); round points have degree 0."""
    sh_iterations: int = 1_000
    """Iterations between increments of the degree in use, from the end of the alignment on (3DGS)."""

    prune_iterations: int = 500
    """Iterations between two prunings, the first after two of them (ours; no denser than every 10 steps)."""
    prune_opacity: float = 0.1
    """Opacity below which round points are removed (MonoGaussianAvatar)."""
    fine_prune_opacity: float = 5e-3
    """Opacity below which Gaussians are removed (3DGS)."""
    least_share: float = 0.2
    """Share of the initial points that is never removed (ours)."""

    mask_weight: float = 1.0
    """Weight of the mean absolute difference between coverage and mask in the alignment (PointAvatar)."""
    fine_mask_weight: float = 0.1
    """The same weight for Gaussians (ours)."""
    dssim_share: float = 0.2
    """Weight of D-SSIM in the image loss of Gaussians; L1 has the rest (3DGS). Round points have L1 alone."""
    perceptual_weight: float = 0.02
    """Weight of the VGG loss that the GGAvatar paper adds to its baselines (Sec. 4.2); the paper's is not known."""
    perceptual_features: FeatureChoice = "vgg16"
    """Features of the perceptual loss: `vgg16`, an untrained stand-in (`random`), or the `best` that can be had."""
    perceptual_mode: Literal["image", "crops"] = "image"
    """VGG loss on the whole image, or on crops in some steps with the same expected weight."""
    crop_side: int = 128
    """Side of a crop, px."""
    crop_probability: float = 0.2
    """Fraction of the steps with a crop."""


TABLE_NOTES = ("a reconstruction: its authors published no code, and its constants are ours",)
"""Deviations from the paper, which tables print as footnotes."""

VARIANTS: dict[str, dict[str, Any]] = {
    "normal": {"follow": "normal"},
    "onsurface": {"off_share": 0.0},
    "pinned": {"free": False},
    "without_corrections": {"corrections": False},
}

SHORT_TRAINING: dict[str, Any] = {
    "perceptual_features": "best",
    "first_places": "seen",
    "first_colors": "frames",
    "position_rate": 1e-3,
    "fine_position_rate": 1e-3,
    "basis_rate": 2e-5,
    "scale_rate": 0.017,
    "color_rate": 1e-2,
    "sh_degree": 1,
    "perceptual_mode": "crops",
    "crop_side": 96,
    "crop_probability": 0.1,
}
"""Changes for trainings of a few thousand steps on a CPU.

Measured in docs/experiments/2026-12-01-ps-avatar.md.
"""

PRESETS: dict[str, dict[str, Any]] = {"default": SHORT_TRAINING, "fast": SHORT_TRAINING, "paper": {}}

LEAST_INTERVAL = 10
"""Least number of steps between two prunings."""


def least_gaussians(_: HeadModel) -> int:
    """Enough points for each to have three neighbors."""
    return 8


def build(config: Config, scene: Scene) -> PSAvatar:
    """The avatar before its first step."""
    avatar = PSAvatar(config, scene).to(scene.background.device)
    if config.first_colors == "frames":
        color_from_frames(avatar.rows, avatar.gaussians, scene)
    return avatar


class PSAvatar(StepCounter):
    """The avatar: rows of points on and off the head mesh, and corrections of the mesh's bases."""

    def __init__(self, config: Config, scene: Scene) -> None:
        super().__init__()
        self.config, self.scene, self.head = config, scene, scene.head
        self.poses = HeadPoses.of(self.head, scene.drives)
        self.rows = initial_rows(config, scene, self.poses)
        self.least = int(config.least_share * len(self.rows))
        self.corrections = CorrectionBases(self.head, scene.drives, config.basis_rate) if config.corrections else None
        self.aligned_after = round(config.stage_share * scene.steps)
        self.prune_interval = max(scaled(config.prune_iterations, scene.steps, config.iterations), LEAST_INTERVAL)
        self.boxes = RegionBoxes(self.head)
        crops = CropSampler(config.crop_side, config.crop_probability) if config.perceptual_mode == "crops" else None
        self.perceptual = PerceptualTerm(
            config.perceptual_weight, crops, scene.seed, features=config.perceptual_features
        )

    @property
    def is_aligning(self) -> bool:
        """Whether the next step is one of the alignment, with round points."""
        return int(self.steps_done) < self.aligned_after

    def gaussians(self, drive: Drive) -> Gaussians:
        """The avatar posed by `drive`, in world space: round points in the alignment, then Gaussians."""
        rows, config = self.rows, self.config
        mesh = skinned_mesh(self.head, drive, self.poses if config.pose_on == "neck" else None)
        if self.corrections is not None:
            mesh = mesh._replace(shifts=mesh.shifts + self.corrections(drive))
        corners = self.head.faces.index_select(0, rows["face"])
        moved = rows["displacements"] if config.free else rows["displacements"].detach()
        if config.follow == "skin":
            means, turns = pose_points(mesh, corners, rows["weights"], rows["rest"] + moved)
        else:
            means, turns = pose_along_normals(mesh, self.head, corners, rows["weights"], rows["offsets"], moved)
        opacities = rows["opacity_logits"].sigmoid()
        if self.is_aligning:
            sizes = self._size_share(int(self.steps_done)) * rows["log_scales"].detach().exp()
            return Gaussians(means, turns, sizes, opacities, rows["sh"], 0)
        quats = quaternion_multiply(turns, normalize(rows["quats"], dim=-1))
        return Gaussians(means, quats, rows["log_scales"].exp(), opacities, harmonics(rows), self._sh_degree())

    def losses(self, frame: Frame, rendering: Rendering, step: int) -> Mapping[str, Tensor]:
        """L1 and mask in the alignment; L1, D-SSIM and mask for Gaussians; the perceptual loss in both."""
        config = self.config
        if step <= self.aligned_after:
            terms, weight = {"l1": l1(rendering.image, frame.image)}, config.mask_weight
        else:
            terms = image_terms(rendering.image, frame.image, config.dssim_share)._asdict()
            weight = config.fine_mask_weight
        if weight:
            terms["mask"] = weight * l1(rendering.alpha, frame.alpha)
        if config.perceptual_weight:
            boxes = self.boxes.of(frame) if self.perceptual.crops else []
            terms.update(self.perceptual(rendering.image, frame.image, step, boxes))
        return terms

    def optimizers(self) -> list[torch.optim.Optimizer]:
        """Adam for the rows and Adam for the corrections."""
        return [self.rows.optimizer, *([self.corrections.optimizer] if self.corrections is not None else [])]

    @torch.no_grad()
    def after_backward(self, rendering: Rendering, step: int) -> None:
        """Prune after `step`, turn points into Gaussians at the end of the alignment, then the rates of `step + 1`."""
        config, ends = self.config, step == self.aligned_after
        if ends or (step % self.prune_interval == 0 and 2 * self.prune_interval <= step < self.scene.steps):
            self._prune(config.prune_opacity if step <= self.aligned_after else config.fine_prune_opacity)
        if ends:
            self._become_gaussians()
        self._set_rates(step)
        self.steps_done.fill_(step)

    def notes(self) -> dict[str, str]:
        """Notes for provenance.json: that this is a reconstruction, and how many points are left where."""
        off = int((self.rows["offsets"] != 0).sum())
        return self.perceptual.notes() | {
            "reconstruction": "PSAvatar from descriptions; its code was never published and the constants are ours",
            "points": f"{len(self.rows) - off} on the skin, {off} off it",
        }

    def _prune(self, opacity: float) -> None:
        """Remove points below an opacity; the most opaque `least_share` of the first ones stay."""
        logits = self.rows["opacity_logits"]
        floor = logits.topk(min(self.least, len(logits))).values.amin() if self.least else logits.new_tensor(torch.inf)
        kept = (logits >= torch.logit(logits.new_tensor(opacity))) | (logits >= floor)
        self.rows.take(kept.nonzero().squeeze(-1))

    def _become_gaussians(self) -> None:
        """Points take their last size as their own; those below the opacity of pruning are raised to it."""
        rows = self.rows
        rows.replace("log_scales", rows["log_scales"] + torch.log(rows["log_scales"].new_tensor(self.config.last_size)))
        floor = torch.logit(rows["opacity_logits"].new_tensor(self.config.prune_opacity))
        rows["opacity_logits"].clamp_min_(floor)

    def _size_share(self, done: int) -> float:
        """Size of round points after `done` steps, as a share of the distance of their neighbors."""
        return log_linear(done, self.config.first_size, self.config.last_size, self.aligned_after)

    def _set_rates(self, step: int) -> None:
        """Learning rates of the step after `step`."""
        config, length = self.config, self.aligned_after
        if step < length:
            position = log_linear(step, config.position_rate, config.position_rate * config.position_decay, length)
        else:
            first, length = config.fine_position_rate, self.scene.steps - length
            position = log_linear(step - self.aligned_after, first, first * config.position_decay, length)
        self.rows.set_rate("displacements", position)
        if self.corrections is not None:
            rate = log_linear(step, config.basis_rate, config.fine_basis_rate, self.aligned_after)
            self.corrections.set_rate(rate)

    def _sh_degree(self) -> int:
        """Degree of the spherical harmonics in use: 0 at the end of the alignment, then one more every interval."""
        interval = scaled(self.config.sh_iterations, self.scene.steps, self.config.iterations)
        return degree_in_use(self.steps_done - self.aligned_after, interval, self.config.sh_degree)


def initial_rows(config: Config, scene: Scene, poses: HeadPoses) -> Rows:
    """Points of the initial opacity at their places at rest, as large as the distance of their neighbors."""
    shell = initial_shell(config, scene, poses)
    rest, count = shell.points(scene.head), len(shell.face)
    sizes = neighbor_distance(rest)
    learnable = {
        "displacements": Column(torch.zeros_like(rest), config.position_rate),
        "quats": Column(rest.new_tensor([1.0, 0.0, 0.0, 0.0]).repeat(count, 1), config.rotation_rate),
        "log_scales": Column(sizes.log()[:, None].expand(-1, 3), config.scale_rate),
        "opacity_logits": Column(rest.new_full((count,), config.first_opacity).logit(), config.opacity_rate),
        "sh": Column(rest.new_zeros(count, 1, 3), config.color_rate),
    }
    if config.sh_degree:
        rest_of_harmonics = rest.new_zeros(count, (config.sh_degree + 1) ** 2 - 1, 3)
        learnable["sh_rest"] = Column(rest_of_harmonics, config.color_rate / 20)
    return Rows(learnable, {**shell._asdict(), "rest": rest})


def initial_shell(config: Config, scene: Scene, poses: HeadPoses) -> Shell:
    """Points on and off the skin, by area of the triangles they belong to."""
    head = scene.head
    count = min(config.points, scene.max_gaussians)
    off = round(config.off_share * count)
    room = face_areas(head.neutral(), head.faces)
    if config.first_places == "seen":
        room = room * faces_seen(scene, poses)
    ranges = ShellRanges(face=(config.lowest_off_face, config.highest_off_face), rest=(0.0, config.highest_off_rest))
    return sample_shell(head, room, (count - off, off), ranges, seeded(scene.seed, 4))
