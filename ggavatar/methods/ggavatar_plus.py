"""GGAvatar plus: a torso that does not turn with the head, the head pose as a condition, condition-dependent colors.

Ours. It wraps a `ggavatar.GGAvatar` and defines only the differences, whose effects are measured in
docs/experiments/2026-11-30-the-papers-method-at-our-lengths.md.

    1. The head pose also moves the neck: offsets need not explain what does not turn with the head.
    2. The latent network receives the head pose, clamped to its training range.
    3. The basis has three more rows, for color: wrinkles, shading, gaze (as in RGBAvatar and GPAvatar).
    4. The image loss has a larger weight in mouth and eyes (as in FlashAvatar), and coverage is compared with the mask.
    5. The perceptual loss has a quarter of the paper's weight, which suits short trainings better in PSNR and LPIPS.
    6. Initial colors come from the frames, the budget becomes available evenly, and rows learn faster for longer.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields
from typing import Any

import torch
from jaxtyping import Float
from torch import Tensor, nn

from ggavatar.core import Drive, Frame, Gaussians, Rendering
from ggavatar.data.scene import Scene
from ggavatar.gaussians.bound_parts import BoundParts
from ggavatar.losses.crop_sampler import Box
from ggavatar.losses.vgg import FeatureChoice
from ggavatar.methods import ggavatar


@dataclass(frozen=True)
class Config:
    """Settings of what is ours, and the shared ones that it changes or exposes.

    Iterations refer to 120,000 and scale with the length of the training.
    """

    torso: bool = True
    """Whether the torso keeps its own pose, tracked or else at rest, instead of turning with the head."""
    pose_condition: bool = True
    """Whether the latent network receives the head pose."""
    color_unit: float = 0.1
    """sRGB color per unit of a color row; 0 removes the color rows."""
    latent: int = 32
    """Length of the latent vector; the default of `ggavatar`."""
    network_rate: float = 1e-3
    """Learning rate of the networks; ten times the paper's, for trainings a tenth as long or shorter."""
    position_rate: float = 1e-2
    """Learning rate of local positions at the start, triangle units; twice the paper's."""
    position_iterations: int = 120_000
    """Iterations over which the position rate falls; with 120,000, rows that are added late can still move."""
    scale_rate: float = 0.017
    """Learning rate of the logarithms of local scales; GaussianAvatars', 3.4 times the paper's."""
    color_rate: float = 1e-2
    """Learning rate of the constant spherical harmonic; four times that of 3DGS."""
    sh_degree: int = 1
    """Highest degree of the spherical harmonics, 0 to 3."""
    sh_iterations: int = 20_000
    """Iterations between increments of the degree in use."""
    density_start: int = 5_000
    """Density control starts after this iteration."""
    region_weight: float = 1.0
    """Additional weight of L1 over the boxes of mouth and eyes, as a multiple of that in the image loss; 0 is none."""
    alpha_weight: float = 0.1
    """Weight of the mean absolute difference between coverage and mask."""
    perceptual_weight: float = 0.005
    """Weight of the perceptual loss on crops: a quarter of the paper's λ2."""
    perceptual_features: FeatureChoice = "best"
    """Features of the perceptual loss: `vgg16`, an untrained stand-in (`random`), or the `best` that can be had."""
    crop_side: int = 96
    """Side of a crop, px."""
    crop_probability: float = 0.1
    """Fraction of the steps with a crop."""


VARIANTS: dict[str, dict[str, Any]] = {
    "without_torso": {"torso": False},
    "without_pose": {"pose_condition": False},
    "without_colour": {"color_unit": 0.0},
    "without_regions": {"region_weight": 0.0},
    "without_alpha": {"alpha_weight": 0.0},
    "full_perceptual": {"perceptual_weight": 0.02},
}

least_gaussians = ggavatar.least_gaussians


def build(config: Config, scene: Scene) -> GGAvatarPlus:
    """The avatar before its first step."""
    return GGAvatarPlus(config, scene)


class GGAvatarPlus(nn.Module):
    """The paper's avatar with our settings and one more term in its objective."""

    def __init__(self, config: Config, scene: Scene) -> None:
        super().__init__()
        self.config = config
        self.avatar = ggavatar.build(paper_config(config), scene)

    def gaussians(self, drive: Drive) -> Gaussians:
        """The avatar posed by `drive`, in world space."""
        return self.avatar.gaussians(drive)

    def losses(self, frame: Frame, rendering: Rendering, step: int) -> Mapping[str, Tensor]:
        """The paper's terms, coverage, and the L1 of mouth and eyes."""
        terms = dict(self.avatar.losses(frame, rendering, step))
        if self.config.region_weight and not self.avatar.is_neutral:
            boxes = self.avatar.boxes.of(frame)
            share = 1 - self.avatar.config.dssim_share
            terms["regions"] = self.config.region_weight * share * regions_l1(rendering.image, frame.image, boxes)
        return terms

    def optimizers(self) -> list[torch.optim.Optimizer]:
        """The optimizers of the paper's avatar."""
        return self.avatar.optimizers()

    def after_backward(self, rendering: Rendering, step: int) -> None:
        """Density control after `step`, then rates and stage of `step + 1`."""
        self.avatar.after_backward(rendering, step)

    def notes(self) -> dict[str, str]:
        """Notes for provenance.json: the features of the perceptual loss."""
        return self.avatar.notes()

    def bound_parts(self) -> BoundParts:
        """The avatar as arrays."""
        return self.avatar.bound_parts()


def paper_config(config: Config) -> ggavatar.Config:
    """The paper's method with our settings."""
    shared = {field.name for field in fields(ggavatar.Config)} & {field.name for field in fields(config)}
    return ggavatar.Config(
        **{name: getattr(config, name) for name in shared},
        pose_on="neck" if config.torso else "camera",
        condition="face_and_pose" if config.pose_condition else "face",
        density_ramp=True,
        first_colors="frames",
        perceptual_mode="crops",
    )


def regions_l1(
    image: Float[Tensor, "H W 3"], target: Float[Tensor, "H W 3"], boxes: Sequence[Box]
) -> Float[Tensor, ""]:
    """Absolute difference summed over boxes (left, top, right, bottom, px), per pixel of the whole image."""
    height, width = image.shape[:2]
    total = image.new_zeros(())
    for left, top, right, bottom in boxes:
        rows = slice(max(int(top), 0), min(int(bottom) + 1, height))
        columns = slice(max(int(left), 0), min(int(right) + 1, width))
        total = total + (image[rows, columns] - target[rows, columns]).abs().sum()
    return total / (height * width * 3)
