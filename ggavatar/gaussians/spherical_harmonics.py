"""The color columns of rows, `sh` and `sh_rest`: initial colors from frames, and the degree in use."""

from __future__ import annotations

from collections.abc import Callable

import torch
from jaxtyping import Float
from torch import Tensor

from ggavatar.core import Drive, Gaussians
from ggavatar.data.scene import Scene
from ggavatar.gaussians.initial_colors import rgb_to_sh, splatted_colors
from ggavatar.optim.parameters import Rows


def color_from_frames(rows: Rows, pose: Callable[[Drive], Gaussians], scene: Scene) -> None:
    """Initialize the colors of rows from a few training frames.

    Colors do not change if the scene has no samples, as when a trained avatar is opened.

    Args:
        rows: The Gaussians; their column `sh` is overwritten.
        pose: Returns the Gaussians of a drive.
        scene: Provides the sample frames and the rasterizer.
    """
    if scene.rasterize is not None and scene.samples:
        rows.replace("sh", rgb_to_sh(splatted_colors(pose, scene.samples, scene.rasterize))[:, None])


def harmonics(rows: Rows, constant: Float[Tensor, "N 1 3"] | None = None) -> Float[Tensor, "N K 3"]:
    """All spherical harmonics of the rows, with the constant one replaced by `constant` if given."""
    first = rows["sh"] if constant is None else constant
    return torch.cat((first, rows["sh_rest"]), dim=1) if "sh_rest" in rows.learnable else first


def degree_in_use(steps_done: Tensor, interval: int, highest: int) -> int:
    """Degree of the harmonics in use: one more every `interval` steps, up to the highest (3DGS)."""
    return min(int(steps_done) // max(interval, 1), highest)
