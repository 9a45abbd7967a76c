"""Painted mesh: one Gaussian per triangle with a color of its own (an example of a method in a package)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import torch
from torch import Tensor, nn

from ggavatar.core import Drive, Frame, Gaussians, Rendering
from ggavatar.data.scene import Scene
from ggavatar.gaussians.binding import bind
from ggavatar.gaussians.initialization import BoundRates, bound_rows
from ggavatar.geometry.triangles import triangle_frames
from ggavatar.losses.dssim import image_terms
from ggavatar.optim.seeding import seeded


@dataclass(frozen=True)
class Config:
    """All settings of the method."""

    dssim_share: float = 0.2
    """Weight of D-SSIM in the image loss; L1 has the rest (3DGS)."""


VARIANTS: dict[str, dict[str, Any]] = {"without_dssim": {"dssim_share": 0.0}}
TABLE_NOTES: tuple[str, ...] = ("one Gaussian per triangle, none is added or removed.",)


def build(config: Config, scene: Scene) -> PaintedMesh:
    """The avatar before its first step."""
    return PaintedMesh(config, scene)


class PaintedMesh(nn.Module):
    """One Gaussian on every triangle of the tracked head."""

    def __init__(self, config: Config, scene: Scene) -> None:
        super().__init__()
        self.config, self.head = config, scene.head
        self.rows = bound_rows(scene.head, BoundRates(), 0, seeded(scene.seed, 1))

    def gaussians(self, drive: Drive) -> Gaussians:
        """The avatar posed by `drive`."""
        rows, frames = self.rows, triangle_frames(self.head.vertices(drive), self.head.faces)
        bound = bind(rows["means"], rows["quats"], rows["log_scales"], rows["face"], frames)
        return Gaussians(*bound, rows["opacity_logits"].sigmoid(), rows["sh"], 0)

    def losses(self, frame: Frame, rendering: Rendering, step: int) -> dict[str, Tensor]:
        """L1 and D-SSIM."""
        return image_terms(rendering.image, frame.image, self.config.dssim_share)._asdict()

    def optimizers(self) -> list[torch.optim.Optimizer]:
        """Adam for the rows."""
        return [self.rows.optimizer]

    def after_backward(self, rendering: Rendering, step: int) -> None:
        """Nothing: no Gaussian is added, and the trainer lowers the rates."""
