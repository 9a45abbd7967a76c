"""Gaussians as splat files hold them: opacities as logits, scales as logarithms; and the axes of viewers."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass

import numpy as np
import torch
from jaxtyping import Float, Int
from numpy import ndarray

from ggavatar.core import Gaussians
from ggavatar.gaussians.initial_colors import SH_C0

LEAST_OPACITY, LEAST_SCALE = 1e-6, 1e-9
"""What logits and logarithms can still express; anything less is invisible."""

TURNED_SIGNS = np.array([-1, -1, 1, -1, 1, 1, -1, 1, -1, 1, -1, -1, 1, -1, 1], np.float32)
"""Signs that the harmonics beyond the constant one take under half a turn about x, in the order of 3DGS."""


@dataclass(frozen=True)
class Stored:
    """N Gaussians before activation, float32.

    Attributes:
        means: Positions, m (in a triangle's units where `faces` is given).
        constant: Coefficient of the constant harmonic; shown as 0.5 + SH_C0 · coefficient.
        rest: Coefficients of the other harmonics; K is 0, 3, 8 or 15.
        opacity_logits: Logits of the opacities.
        log_scales: Natural logarithms of the standard deviations, m (or a triangle's units).
        quats: wxyz, any length but zero.
        faces: The triangle each is bound to, or None where the Gaussians stand in the world.
    """

    means: Float[ndarray, "N 3"]
    constant: Float[ndarray, "N 3"]
    rest: Float[ndarray, "N K 3"]
    opacity_logits: Float[ndarray, " N"]
    log_scales: Float[ndarray, "N 3"]
    quats: Float[ndarray, "N 4"]
    faces: Int[ndarray, " N"] | None = None

    def __len__(self) -> int:
        return len(self.means)

    @property
    def degree(self) -> int:
        """Highest degree of the harmonics, 0 to 3."""
        return {0: 0, 3: 1, 8: 2, 15: 3}[self.rest.shape[1]]


def stored(gaussians: Gaussians) -> Stored:
    """Activated Gaussians as a file holds them; harmonics above the degree in use are left out, colours are exact."""
    colors = _numbers(gaussians.colors)
    if colors.ndim == 2:
        constant, rest = (colors - 0.5) / SH_C0, np.zeros((len(colors), 0, 3), np.float32)
    else:
        used = colors.shape[1] if gaussians.sh_degree is None else (gaussians.sh_degree + 1) ** 2
        constant, rest = colors[:, 0], colors[:, 1:used]
    opacities = _numbers(gaussians.opacities).astype(np.float64).clip(LEAST_OPACITY, 1 - LEAST_OPACITY)
    quats = _numbers(gaussians.quats)
    return Stored(
        means=_numbers(gaussians.means),
        constant=np.ascontiguousarray(constant, np.float32),
        rest=np.ascontiguousarray(rest, np.float32),
        opacity_logits=(np.log(opacities) - np.log1p(-opacities)).astype(np.float32),
        log_scales=np.log(_numbers(gaussians.scales).clip(LEAST_SCALE, None)),
        quats=quats / np.linalg.norm(quats, axis=1, keepdims=True).clip(1e-12, None),
    )


def activated(rows: Stored, device: torch.device | str = "cpu") -> Gaussians:
    """What a file holds as Gaussians; those bound to triangles stay in their triangles' units."""
    colors = np.concatenate((rows.constant[:, None], rows.rest), axis=1)
    return Gaussians(
        means=torch.from_numpy(rows.means).to(device),
        quats=torch.from_numpy(rows.quats).to(device),
        scales=torch.from_numpy(rows.log_scales).to(device).exp(),
        opacities=torch.from_numpy(rows.opacity_logits).to(device).sigmoid(),
        colors=torch.from_numpy(colors).to(device),
    )


def turned(rows: Stored) -> Stored:
    """The same picture after half a turn about x: from our axes (y up, z to the viewer) to viewers' or back.

    3DGS files and their viewers have COLMAP's axes: x right, y down, z away. Means change the signs of y and z,
    quaternions are multiplied by (0, 1, 0, 0) from the left, harmonics change signs only; exact.
    """
    w, x, y, z = rows.quats.T
    return dataclasses.replace(
        rows,
        means=rows.means * np.array([1, -1, -1], np.float32),
        quats=np.stack((-x, w, -z, y), axis=1),
        rest=rows.rest * TURNED_SIGNS[: rows.rest.shape[1], None],
    )


def _numbers(tensor: torch.Tensor) -> Float[ndarray, "..."]:
    return tensor.detach().cpu().to(torch.float32).contiguous().numpy()
