"""FlashAvatar (Xiang et al. 2024): Gaussians at the texels of a head mesh, moved by a position-conditioned network.

A baseline of the paper's Table 1. All numbers are from https://arxiv.org/abs/2312.02214 and its public code.

    1. Every texel of the texture layout that a triangle covers carries a Gaussian (`ggavatar.geometry.uv_sampling`).
    2. A network of the neutral position and the facial parameters outputs Δμ, Δr and Δs; the mesh determines the rest.
    3. There is no density control. The Huber loss has 40 times the weight in the mouth; a perceptual term joins later.

Substitutions: a strip of triangles (`layout`) for FLAME's texture layout, because heads here have no layout, or one for
images, in which front and back of parts overlap; the convex hull of the projected lips for the parsed mouth; the
foreground for the parsed head; the project's perceptual loss, named in provenance.json, for LPIPS. The authors train on
head and neck in front of green (`--background 0,1,0`); for a fair table, all methods share background and foreground.
"""

from __future__ import annotations

import functools
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Literal

import torch
from jaxtyping import Float, Float64
from torch import Tensor, nn
from torch.nn.functional import normalize

from ggavatar.core import Drive, Frame, Gaussians, Rendering
from ggavatar.data.scene import Scene
from ggavatar.gaussians.binding import WorldGeometry
from ggavatar.gaussians.initialization import faces_seen, neighbor_distance
from ggavatar.gaussians.spherical_harmonics import color_from_frames, degree_in_use, harmonics
from ggavatar.geometry.convex_hull import hull_outline, outline_mask
from ggavatar.geometry.transforms import project, quaternion_multiply
from ggavatar.geometry.uv_sampling import (
    SurfaceSamples,
    face_areas,
    lower_boundary,
    strip_samples,
    texel_samples,
)
from ggavatar.head.head_pose import POSE_FEATURES, HeadPoses
from ggavatar.head.model import HeadModel
from ggavatar.head.mouth_interior import LIP_REGIONS
from ggavatar.head.region_boxes import RegionBoxes
from ggavatar.jit.bfloat16 import matmul_dtype
from ggavatar.losses.crop_sampler import CropSampler
from ggavatar.losses.terms import huber
from ggavatar.losses.vgg import FeatureChoice
from ggavatar.losses.vgg_term import PerceptualTerm
from ggavatar.networks.conditioned_mlp import ConditionedPerceptron
from ggavatar.optim.parameters import Column, Rows
from ggavatar.optim.schedules import scaled
from ggavatar.optim.seeding import seeded
from ggavatar.optim.step_counter import StepCounter

PAPER_ITERATIONS = 150_000
"""Length of the authors' training, to which all constants below refer, iterations."""
FLAME_COVERAGE = 14_734 / 128**2
"""Fraction of the texels that FLAME's triangles cover."""


@dataclass(frozen=True)
class Config:
    """All settings of the method. Iterations refer to the authors' 150,000 and scale with the training."""

    texels: int = 128
    """Texels along an edge of the texture (code; 256 in GGAvatar's comparison), if --max-gaussians allows."""
    layout: Literal["strip", "head"] = "strip"
    """Texture layout: a strip computed for the head, or the head file's own if it has one."""
    room_power: float = 0.5
    """Exponent of a triangle's area for its part of the strip: 1 is even by area, 0 by triangle (ours)."""
    unseen_room: float = 0.1
    """Factor on the part of the strip of triangles that no training frame can show (ours)."""
    boundary: Literal["keep", "drop"] = "keep"
    """Texels at the lower rim of the mesh: kept (GGAvatar's comparison) or dropped (FlashAvatar)."""
    pose_on: Literal["camera", "neck"] = "camera"
    """What the head pose moves: the camera (the authors), or the neck too, so that the torso stays still."""
    condition: Literal["face", "face_and_pose"] = "face"
    """Condition vector: facial parameters (the authors), or also the head pose, clamped to its training range."""

    octaves: int = 8
    """Octaves of the positional encoding, sin and cos of 2ᵏx, x in m (code)."""
    hidden: int = 256
    """Width of the hidden layers (code)."""
    depth: int = 6
    """Number of hidden layers (code)."""
    hidden_type: Literal["float32", "fastest"] = "float32"
    """Hidden layers in float32 (code), or in bfloat16 on CPUs that support it (ours; twice as fast)."""
    first_offsets: Literal["random", "none"] = "random"
    """Initial offsets: those of a random network (code), or none."""
    first_colors: Literal["grey", "frames"] = "grey"
    """Initial colors: `grey` (code), or from a few training `frames`."""

    network_rate: float = 1e-4
    """Learning rate of the network (code)."""
    scale_rate: float = 5e-3
    """Learning rate of the logarithms of scales (code)."""
    rotation_rate: float = 1e-3
    """Learning rate of quaternions (code)."""
    opacity_rate: float = 0.05
    """Learning rate of opacity logits (code)."""
    color_rate: float = 2.5e-3
    """Learning rate of the constant spherical harmonic; the rate of the others is 1/20 of it (code)."""
    sh_degree: int = 3
    """Highest degree of the spherical harmonics, 0 to 3 (code)."""
    sh_iterations: int = 500
    """Iterations between increments of the degree in use (code)."""

    huber_delta: float = 0.1
    """Difference from which the Huber loss is linear (paper, code)."""
    mouth_weight: float = 40.0
    """Weight of the Huber loss inside the lips, in addition to that of the whole image (paper, code)."""
    perceptual_weight: float = 0.005
    """Weight of the perceptual loss; the code has 0.05 of LPIPS, which is a tenth of this loss for similar images."""
    perceptual_features: FeatureChoice = "vgg16"
    """Features of the perceptual loss: `vgg16`, an untrained stand-in (`random`), or the `best` that can be had."""
    perceptual_iterations: int = 15_000
    """Iterations before the perceptual loss starts (code)."""
    perceptual_mode: Literal["image", "crops"] = "image"
    """Perceptual loss on the whole image (code), or on crops in some steps with the same expected weight."""
    crop_side: int = 128
    """Side of a crop, px."""
    crop_probability: float = 1.0
    """Fraction of the steps with a crop; rare crops have larger weights and would dominate the small Huber loss."""


TABLE_NOTES = (
    "Gaussians on a strip of triangles computed for the head, where it has no texture layout",
    "mouth: convex hull of the lips; head: the foreground; VGG loss instead of LPIPS",
    "background and foreground as for all methods, not head and neck in front of green",
)
"""Deviations from the paper, which tables print as footnotes."""

VARIANTS: dict[str, dict[str, Any]] = {}

SHORT_TRAINING: dict[str, Any] = {
    "perceptual_features": "best",
    "room_power": 1.0,
    "hidden_type": "fastest",
    "first_offsets": "none",
    "first_colors": "frames",
    "network_rate": 1e-3,
    "color_rate": 1e-2,
    "perceptual_mode": "crops",
    "crop_side": 64,
}
"""Changes for trainings of a few thousand steps on a CPU."""

PRESETS: dict[str, dict[str, Any]] = {"default": SHORT_TRAINING, "fast": SHORT_TRAINING, "paper": {"texels": 256}}


def build(config: Config, scene: Scene) -> FlashAvatar:
    """The avatar before its first step."""
    avatar = FlashAvatar(config, scene).to(scene.background.device)
    if config.first_colors == "frames":
        color_from_frames(avatar.rows, avatar.gaussians, scene)
    return avatar


class FlashAvatar(StepCounter):
    """The avatar: rows of Gaussians at fixed places on the mesh, and the network that moves them."""

    def __init__(self, config: Config, scene: Scene) -> None:
        super().__init__()
        self.config, self.scene = config, scene
        self.head: HeadModel = scene.head
        self.poses = HeadPoses.of(self.head, scene.drives)
        samples = surface_samples(config, scene, self.poses)
        self.network = make_network(config, scene)
        self.rows = initial_rows(config, samples)
        crops = CropSampler(config.crop_side, config.crop_probability) if config.perceptual_mode == "crops" else None
        self.boxes = RegionBoxes(self.head)
        self.perceptual = PerceptualTerm(
            config.perceptual_weight, crops, scene.seed, features=config.perceptual_features
        )
        self._cached_encoding: Tensor | None = None
        self._outlines: dict[tuple[int | None, int, int], tuple[Drive, Tensor]] = {}
        self.register_load_state_dict_post_hook(lambda *_: self._clear_encoding())
        drive = scene.drives[0] if scene.drives else self.head.neutral_drive()
        self.rows.replace("log_scales", neighbor_distance(self.gaussians(drive).means).log()[:, None].expand(-1, 3))

    def gaussians(self, drive: Drive) -> Gaussians:
        """The avatar posed by `drive`, in world space."""
        offsets = self.network(self._encoding(), self._condition(drive)).tanh()
        rows = self.rows
        placed = apply_offsets(self._surface_points(drive), rows["quats"], rows["log_scales"], offsets)
        return Gaussians(*placed, rows["opacity_logits"].sigmoid(), harmonics(rows), self._sh_degree())

    def losses(self, frame: Frame, rendering: Rendering, step: int) -> Mapping[str, Tensor]:
        """Huber loss of the image and of the mouth, and later the perceptual term."""
        config = self.config
        mask = self._mouth_mask(frame)
        terms = {
            "huber": huber(rendering.image, frame.image, config.huber_delta),
            "mouth": config.mouth_weight * huber(rendering.image * mask, frame.image * mask, config.huber_delta),
        }
        if config.perceptual_weight and step > scaled(config.perceptual_iterations, self.scene.steps, PAPER_ITERATIONS):
            boxes = self.boxes.of(frame) if self.perceptual.crops else []
            terms.update(self.perceptual(rendering.image * frame.alpha, frame.image * frame.alpha, step, boxes))
        return terms

    @functools.cached_property
    def network_optimizer(self) -> torch.optim.Optimizer:
        """Adam for the network, made when it is first used."""
        return torch.optim.Adam(self.network.parameters(), self.config.network_rate, fused=True)

    def optimizers(self) -> list[torch.optim.Optimizer]:
        """Adam for the rows and Adam for the network."""
        return [self.rows.optimizer, self.network_optimizer]

    @torch.no_grad()
    def after_backward(self, rendering: Rendering, step: int) -> None:
        """Advance the step count, which determines degree and loss terms; rates and rows do not change."""
        self.steps_done.fill_(step)

    def notes(self) -> dict[str, str]:
        """Notes for provenance.json: the texture layout, and the features of the perceptual loss."""
        layout = self.config.layout if self.head.uv is not None else "strip"
        return {"texture_layout": f"{layout}, {len(self.rows)} texels", **self.perceptual.notes()}

    def _samples(self) -> SurfaceSamples:
        return SurfaceSamples(self.rows["face"], self.rows["weights"])

    @torch.no_grad()
    def _surface_points(self, drive: Drive) -> Float[Tensor, "N 3"]:
        """Positions of the Gaussians on the posed mesh, m."""
        vertices = self.head.vertices(drive)
        if self.config.pose_on == "neck":
            vertices = self.poses.hold_torso(vertices, drive, self.head)
        return self._samples().points(vertices, self.head.faces)

    @torch.no_grad()
    def _encoding(self) -> Float[Tensor, "N D"]:
        """The encoded neutral positions, computed once."""
        if self._cached_encoding is None or self._cached_encoding.device != self.rows["weights"].device:
            self._cached_encoding = positional_encoding(
                self._samples().points(self.head.neutral(), self.head.faces), self.config.octaves
            )
        return self._cached_encoding

    def _clear_encoding(self) -> None:
        self._cached_encoding = None

    def _condition(self, drive: Drive) -> Float[Tensor, " C"]:
        """Condition vector: facial parameters, and the head pose if configured."""
        face = self.head.condition(drive)
        return face if self.config.condition == "face" else torch.cat((face, self.poses.condition(drive)))

    def _sh_degree(self) -> int:
        """Degree of the spherical harmonics in use."""
        return degree_in_use(
            self.steps_done,
            scaled(self.config.sh_iterations, self.scene.steps, PAPER_ITERATIONS),
            self.config.sh_degree,
        )

    @torch.no_grad()
    def _mouth_mask(self, frame: Frame) -> Float[Tensor, "H W 1"]:
        """Mask of the convex hull of the lips, or of the region `mouth` for heads without a region `lips`."""
        height, width = frame.image.shape[:2]
        name = next((name for name in LIP_REGIONS if name in self.head.regions), None)
        if name is None:
            return frame.image.new_zeros(height, width, 1)
        return outline_mask(self._outline(frame, name), height, width, frame.image.dtype)

    def _outline(self, frame: Frame, name: str) -> Float64[Tensor, "K 3"]:
        """The outline of a region in a frame, from an earlier visit if it had the same drive and size."""
        key = frame.drive.frame, frame.camera.width, frame.camera.height
        drive, outline = self._outlines.get(key, (None, None))
        if outline is None or drive is not frame.drive:
            places = self.head.vertices(frame.drive)[self.head.regions[name]]
            outline = hull_outline(project(places, frame.camera.intrinsics, frame.camera.world_to_camera))
            self._outlines[key] = frame.drive, outline
        return outline


def apply_offsets(
    places: Float[Tensor, "N 3"],
    quats: Float[Tensor, "N 4"],
    log_scales: Float[Tensor, "N 3"],
    offsets: Float[Tensor, "N 10"],
) -> WorldGeometry:
    """Apply the network's outputs after tanh to Gaussians on the mesh.

    Args:
        places: Positions on the posed mesh, m.
        quats: Rotations, wxyz.
        log_scales: Logarithms of the standard deviations in m.
        offsets: Position offset (m), quaternion and log-scale factors. The quaternion's real part and the factors are
            exponentiated. As in the authors' code the factors, from 1/e to e, multiply the *logarithm* of the scale,
            so that their effect depends on the unit of length.
    """
    turn = torch.cat((offsets[:, 3:4].exp(), offsets[:, 4:7]), dim=-1)
    turned = normalize(quaternion_multiply(quats, turn), dim=-1)
    return WorldGeometry(places + offsets[:, :3], turned, (log_scales * offsets[:, 7:].exp()).exp())


def positional_encoding(points: Float[Tensor, "N 3"], octaves: int) -> Float[Tensor, "N D"]:
    """The points (m), then sine and cosine of 2ᵏx (without π) for every octave."""
    angles = points[:, None] * 2.0 ** torch.arange(octaves, device=points.device, dtype=points.dtype)[:, None]
    return torch.cat((points, torch.stack((angles.sin(), angles.cos()), dim=2).flatten(1)), dim=-1)


def make_network(config: Config, scene: Scene) -> ConditionedPerceptron:
    """The network, with torch's default initialization or, for initial offsets of zero, a last layer of zeros."""
    conditions = len(scene.head.condition(scene.head.neutral_drive()))
    conditions += POSE_FEATURES if config.condition == "face_and_pose" else 0
    features = 3 + 6 * config.octaves
    hidden_type = matmul_dtype(scene.background.device) if config.hidden_type == "fastest" else None
    network = ConditionedPerceptron(
        features, conditions, config.hidden, config.depth, 10, seeded(scene.seed, 5), hidden_type
    )
    if config.first_offsets == "none":
        for parameter in network.layers[-1].parameters():
            nn.init.zeros_(parameter)
    return network.to(scene.background.device)


def initial_rows(config: Config, samples: SurfaceSamples) -> Rows:
    """Unrotated, gray, nearly transparent Gaussians; the caller sets their scales."""
    count, like = len(samples.face), samples.weights
    learnable = {
        "quats": Column(like.new_tensor([1.0, 0.0, 0.0, 0.0]).repeat(count, 1), config.rotation_rate),
        "log_scales": Column(like.new_zeros(count, 3), config.scale_rate),
        "opacity_logits": Column(like.new_full((count,), 0.1).logit(), config.opacity_rate),
        "sh": Column(like.new_zeros(count, 1, 3), config.color_rate),
    }
    if config.sh_degree:
        rest = like.new_zeros(count, (config.sh_degree + 1) ** 2 - 1, 3)
        learnable["sh_rest"] = Column(rest, config.color_rate / 20)
    return Rows(learnable, {"face": samples.face, "weights": samples.weights})


def surface_samples(config: Config, scene: Scene, poses: HeadPoses) -> SurfaceSamples:
    """Places of the Gaussians on the mesh, with fewer texels if there would be more than the training allows."""
    head = scene.head
    allowed = torch.ones(len(head.faces), dtype=torch.bool, device=head.faces.device)
    if config.boundary == "drop":
        rim = head.regions.get("boundary")
        touching = lower_boundary(head.template, head.faces) if rim is None else torch.isin(head.faces, rim).any(-1)
        allowed = ~touching
    if config.layout == "strip" or head.uv is None:
        weights = face_areas(head.neutral(), head.faces) ** config.room_power * allowed
        weights = weights * torch.where(faces_seen(scene, poses), 1.0, config.unseen_room)
        count = min(round(config.texels**2 * FLAME_COVERAGE), scene.max_gaussians)
        return strip_samples(head.neutral(), head.faces, weights, count)
    side = config.texels
    while True:
        samples = texel_samples(head.uv, side)
        kept = allowed[samples.face]
        if int(kept.sum()) <= scene.max_gaussians:
            return SurfaceSamples(samples.face[kept], samples.weights[kept])
        side = min(side - 1, int(side * (scene.max_gaussians / int(kept.sum())) ** 0.5))
