"""A file of Gaussians without a capture: only their positions are known, so the camera is placed in front of them."""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path

import torch
from jaxtyping import Float
from torch import Tensor

from ggavatar.core import Camera, Drive, Gaussians, Rasterizer
from ggavatar.formats.gaussian_files import digest
from ggavatar.formats.imported_avatar import BoundAvatar, ImportedAvatar, open_gaussians
from ggavatar.formats.imported_run import WHITE
from ggavatar.formats.source_options import GaussianFileOptions, results_folder
from ggavatar.geometry.transforms import look_at
from ggavatar.render.backends import pick

IMAGE_SIDE = 512
"""Width and height of the image, px."""
FIELD_OF_VIEW = math.radians(25)
FILL_FRACTION = 0.8
"""Fraction of the image that the Gaussians fill."""
INNER_FRACTION = 0.96
"""Fraction of the Gaussians that determine the extent; the others are outliers."""
MAX_POINTS_FOR_EXTENT = 1 << 20
"""The extent of more Gaussians than this is estimated from a subset."""


@dataclass(frozen=True)
class StandaloneGaussians:
    """A file of Gaussians, opened for rendering without a capture.

    Attributes:
        folder: Folder of the results.
        subject: Name of the file.
        method: Kind of file.
        avatar: The Gaussians.
        rasterize: The rasterizer.
        background: sRGB in [0, 1].
        provenance: Path and digest of the file.
        step: Always 0.
    """

    folder: Path
    subject: str
    method: str
    avatar: ImportedAvatar
    rasterize: Rasterizer
    background: Float[Tensor, "3"]
    provenance: dict[str, str]
    step: int = 0

    def front_view(self) -> tuple[Drive, Camera, Float[Tensor, "3"]]:
        """A neutral drive, a camera that sees everything from the front (+Z), and the point it looks at, m."""
        drive = self._drive()
        center, radius = extent(self.avatar.gaussians(drive))
        distance = radius / (FILL_FRACTION * math.tan(FIELD_OF_VIEW / 2))
        focal = IMAGE_SIDE / 2 / math.tan(FIELD_OF_VIEW / 2)
        intrinsics = center.new_tensor([[focal, 0, IMAGE_SIDE / 2], [0, focal, IMAGE_SIDE / 2], [0, 0, 1]])
        view = look_at(center + center.new_tensor([0, 0, distance]), center, center.new_tensor([0.0, 1.0, 0.0]))
        return drive, Camera(intrinsics, view, IMAGE_SIDE, IMAGE_SIDE), center

    def _drive(self) -> Drive:
        if isinstance(self.avatar, BoundAvatar):
            return self.avatar.head.neutral_drive()
        zero = self.background.new_zeros
        return Drive(zero(0), zero(0, 3), zero(2), zero(3), torch.eye(4).to(self.background))


def extent(gaussians: Gaussians) -> tuple[Float[Tensor, "3"], float]:
    """Center and half side, m, of the box around all but a few outlying Gaussians, each two deviations wide."""
    visible = gaussians.opacities > 1 / 255
    rows = visible.nonzero()[:, 0] if bool(visible.any()) else torch.arange(len(visible), device=visible.device)
    rows, margin = rows[:: 1 + len(rows) // MAX_POINTS_FOR_EXTENT], (1 - INNER_FRACTION) / 2
    means, reach = gaussians.means[rows], 2 * gaussians.scales[rows].amax(dim=1, keepdim=True)
    low, high = (means - reach).quantile(margin, dim=0), (means + reach).quantile(1 - margin, dim=0)
    return (low + high) / 2, max(float((high - low).max()) / 2, 1e-3)


def open_standalone(path: Path, source: GaussianFileOptions, device: str, backend: str) -> StandaloneGaussians:
    """Open a file of Gaussians without a capture.

    Raises:
        InputError: Not a file of Gaussians, or it is bound to a head that was not given.
    """
    avatar = open_gaussians(path, source, None, device)
    method = "GaussianAvatars file" if isinstance(avatar, BoundAvatar) else "3DGS file"
    background = torch.tensor(WHITE, device=device)
    provenance = {"file": str(path), "file_sha256": digest(path)}
    return StandaloneGaussians(
        results_folder(path), path.stem, method, avatar, pick(device, backend), background, provenance
    )
