"""Gaussians as splat files store them (opacities as logits, scales as logarithms), and the axes of their viewers."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass

import numpy as np
import torch
from jaxtyping import Float, Int
from numpy import ndarray

from ggavatar.core import Gaussians
from ggavatar.gaussians.initial_colors import SH_C0

MIN_OPACITY, MIN_SCALE = 1e-6, 1e-9
"""Values are clipped here to keep logits and logarithms finite; anything smaller (m for scales) is invisible."""

SH_SIGNS_180_ABOUT_X = np.array([-1, -1, 1, -1, 1, 1, -1, 1, -1, 1, -1, -1, 1, -1, 1], np.float32)
"""Signs of the harmonics of degree 1 to 3, in the order of 3DGS, under a rotation by 180° about x."""


@dataclass(frozen=True)
class StoredGaussians:
    """N Gaussians before activation, float32.

    Attributes:
        means: Positions, m (in the units of its triangle where `faces` is given).
        sh_dc: Coefficients of the constant harmonic (f_dc of 3DGS); the color is 0.5 + SH_C0 · coefficient.
        sh_rest: Coefficients of the other harmonics (f_rest of 3DGS); K is 0, 3, 8 or 15.
        opacity_logits: Logits of the opacities.
        log_scales: Natural logarithms of the standard deviations in m (or in the units of its triangle).
        quats: wxyz, of any length but zero.
        faces: Index of the triangle that each Gaussian is bound to; None for Gaussians in world space.
        notes: What the reader of a file assumed, dropped or ignored, as sentences.
    """

    means: Float[ndarray, "N 3"]
    sh_dc: Float[ndarray, "N 3"]
    sh_rest: Float[ndarray, "N K 3"]
    opacity_logits: Float[ndarray, " N"]
    log_scales: Float[ndarray, "N 3"]
    quats: Float[ndarray, "N 4"]
    faces: Int[ndarray, " N"] | None = None
    notes: tuple[str, ...] = ()

    def __len__(self) -> int:
        return len(self.means)

    @property
    def degree(self) -> int:
        """Highest degree of the harmonics, 0 to 3."""
        return {0: 0, 3: 1, 8: 2, 15: 3}[self.sh_rest.shape[1]]


def to_stored(gaussians: Gaussians) -> StoredGaussians:
    """Gaussians as a file stores them, without the harmonics above the degree in use."""
    colors = _numbers(gaussians.colors)
    if colors.ndim == 2:
        sh_dc, sh_rest = (colors - 0.5) / SH_C0, np.zeros((len(colors), 0, 3), np.float32)
    else:
        used = colors.shape[1] if gaussians.sh_degree is None else (gaussians.sh_degree + 1) ** 2
        sh_dc, sh_rest = colors[:, 0], colors[:, 1:used]
    opacities = _numbers(gaussians.opacities).astype(np.float64).clip(MIN_OPACITY, 1 - MIN_OPACITY)
    quats = _numbers(gaussians.quats)
    return StoredGaussians(
        means=_numbers(gaussians.means),
        sh_dc=np.ascontiguousarray(sh_dc, np.float32),
        sh_rest=np.ascontiguousarray(sh_rest, np.float32),
        opacity_logits=(np.log(opacities) - np.log1p(-opacities)).astype(np.float32),
        log_scales=np.log(_numbers(gaussians.scales).clip(MIN_SCALE, None)),
        quats=quats / np.linalg.norm(quats, axis=1, keepdims=True).clip(1e-12, None),
    )


def activate(rows: StoredGaussians, device: torch.device | str = "cpu") -> Gaussians:
    """Gaussians from their stored values; those bound to triangles stay in the units of their triangles."""
    colors = np.concatenate((rows.sh_dc[:, None], rows.sh_rest), axis=1)
    return Gaussians(
        means=torch.from_numpy(rows.means).to(device),
        quats=torch.from_numpy(rows.quats).to(device),
        scales=torch.from_numpy(rows.log_scales).to(device).exp(),
        opacities=torch.from_numpy(rows.opacity_logits).to(device).sigmoid(),
        colors=torch.from_numpy(colors).to(device),
    )


def rotate_180_about_x(rows: StoredGaussians) -> StoredGaussians:
    """Rotate Gaussians by 180° about x: from our axes (y up, z to the viewer) to those of viewers, or back.

    3DGS files and their viewers use COLMAP's axes: x right, y down, z away. Means change the signs of y and z,
    quaternions are multiplied by (0, 1, 0, 0) from the left, harmonics change their signs only, so that the rotation
    is exact.
    """
    w, x, y, z = rows.quats.T
    return dataclasses.replace(
        rows,
        means=rows.means * np.array([1, -1, -1], np.float32),
        quats=np.stack((-x, w, -z, y), axis=1),
        sh_rest=rows.sh_rest * SH_SIGNS_180_ABOUT_X[: rows.sh_rest.shape[1], None],
    )


def flip_axes(rows: StoredGaussians, signs: tuple[int, int, int]) -> StoredGaussians:
    """Reverse axes of Gaussians, each sign ±1: also a reflection, from right-handed axes to left-handed ones.

    A Gaussian is symmetric in its own axes, so its rotation R becomes S·R·S, which is a rotation again.
    """
    x, y, z = signs
    return dataclasses.replace(
        rows,
        means=rows.means * np.array([x, y, z], np.float32),
        quats=rows.quats * np.array([1, y * z, x * z, x * y], np.float32),
        sh_rest=rows.sh_rest * _harmonic_signs(x, y, z)[: rows.sh_rest.shape[1], None],
    )


def _harmonic_signs(x: int, y: int, z: int) -> ndarray:
    """Signs of the harmonics of degree 1 to 3, in the order of 3DGS, where directions change signs."""
    second = [x * y, y * z, 1, x * z, 1]
    return np.array([y, z, x, *second, y, x * y * z, y, z, x, z, x], np.float32)


def _numbers(tensor: torch.Tensor) -> Float[ndarray, "..."]:
    return tensor.detach().cpu().to(torch.float32).contiguous().numpy()
