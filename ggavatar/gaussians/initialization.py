"""Initialization of Gaussians: one per triangle (GaussianAvatars, Sec. 3.2); sizes by neighbors, triangles seen."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch
from jaxtyping import Bool, Float
from scipy.spatial import KDTree
from torch import Tensor

from ggavatar.data.frames import evenly_spaced
from ggavatar.data.scene import Scene
from ggavatar.errors import InputError
from ggavatar.gaussians.density_control import statistics
from ggavatar.geometry.uv_sampling import camera_facing
from ggavatar.head.head_pose import HeadPoses
from ggavatar.head.model import HeadModel
from ggavatar.optim.parameters import Column, Rows

VISIBILITY_FRAMES = 24
"""Number of training frames from which triangle visibility is determined."""


@dataclass(frozen=True)
class BoundRates:
    """Learning rates of the columns of bound Gaussians."""

    means: float = 5e-3
    """Rate of local positions, triangle units."""
    quats: float = 1e-3
    """Rate of local quaternions."""
    log_scales: float = 5e-3
    """Rate of the logarithms of local scales."""
    opacity_logits: float = 0.05
    """Rate of opacity logits."""
    sh: float = 2.5e-3
    """Rate of the constant spherical harmonic; the rate of the others is 1/20 of it."""


def bound_rows(head: HeadModel, rates: BoundRates, sh_degree: int, generator: torch.Generator) -> Rows:
    """One gray Gaussian of opacity 0.1 at the centroid of every triangle, as large as the triangle.

    Args:
        head: The head whose triangles carry the Gaussians; the rows are on its device.
        rates: Learning rates.
        sh_degree: Highest degree of the spherical harmonics, 0 to 3; above 0 there is a column `sh_rest`.
        generator: A generator on the CPU for the small random part of the gray.

    Raises:
        InputError: `sh_degree` is out of range.
    """
    if not 0 <= sh_degree <= 3:
        raise InputError(f"sh_degree: expected 0 to 3, found {sh_degree}")
    count, device = len(head.faces), head.faces.device
    learnable = {
        "means": Column(torch.zeros(count, 3), rates.means),
        "quats": Column(torch.tensor([1.0, 0.0, 0.0, 0.0]).repeat(count, 1), rates.quats),
        "log_scales": Column(torch.zeros(count, 3), rates.log_scales),
        "opacity_logits": Column(torch.full((count,), 0.1).logit(), rates.opacity_logits),
        "sh": Column(torch.rand(count, 1, 3, generator=generator) / 255, rates.sh),
    }
    if sh_degree:
        learnable["sh_rest"] = Column(torch.zeros(count, (sh_degree + 1) ** 2 - 1, 3), rates.sh / 20)
    carried = {"face": torch.arange(count), **statistics(count)}
    moved = {name: Column(column.values.to(device), column.rate) for name, column in learnable.items()}
    return Rows(moved, {name: values.to(device) for name, values in carried.items()})


@torch.no_grad()
def neighbor_distance(points: Float[Tensor, "N 3"]) -> Float[Tensor, " N"]:
    """Root mean square distance to the three nearest neighbors, m; at least 0.3 mm (3DGS)."""
    found, _ = KDTree(points.cpu().numpy()).query(points.cpu().numpy(), k=4)
    distances = torch.as_tensor(np.asarray(found)[:, 1:]).to(points)
    return distances.square().mean(-1).clamp_min(1e-7).sqrt()


def faces_seen(scene: Scene, poses: HeadPoses) -> Bool[Tensor, " F"]:
    """Which triangles face the camera in some training frame; all if there are no frames."""
    if not scene.drives:
        return torch.ones(len(scene.head.faces), dtype=torch.bool, device=scene.head.faces.device)
    chosen = evenly_spaced(tuple(range(len(scene.drives))), VISIBILITY_FRAMES)
    posed = [poses.hold_torso(scene.head.vertices(scene.drives[row]), scene.drives[row], scene.head) for row in chosen]
    return camera_facing(posed, [scene.cameras[row] for row in chosen], scene.head.faces)
