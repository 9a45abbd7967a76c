"""The color columns of rows, `sh` and `sh_rest`: first colors off the frames, and the harmonics in use."""

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
    """Give the rows the colors that a few training frames show; an opened avatar, whose scene has none, keeps its own.

    Args:
        rows: Their column `sh` is overwritten.
        pose: The Gaussians of a drive.
        scene: Samples and renderer.
    """
    if scene.rasterize is not None and scene.samples:
        rows.replace("sh", rgb_to_sh(splatted_colors(pose, scene.samples, scene.rasterize))[:, None])


def harmonics(rows: Rows, constant: Float[Tensor, "N 1 3"] | None = None) -> Float[Tensor, "N K 3"]:
    """All spherical harmonics of the rows, the constant one replaced by `constant` if there is one."""
    first = rows["sh"] if constant is None else constant
    return torch.cat((first, rows["sh_rest"]), dim=1) if "sh_rest" in rows.learnable else first


def degree_in_use(steps_done: Tensor, interval: int, highest: int) -> int:
    """Degree of the harmonics after some steps: one more every `interval` steps, up to the highest (3DGS)."""
    return min(int(steps_done) // max(interval, 1), highest)
