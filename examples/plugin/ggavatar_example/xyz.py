"""XYZ: a line `x y z r g b` for every Gaussian, which CloudCompare and MeshLab open (an example of a splat format)."""

from __future__ import annotations

from typing import BinaryIO

import numpy as np

from ggavatar.formats.splats.stored_gaussians import StoredGaussians

SH_C0 = 0.28209479177387814
"""The constant spherical harmonic, 1 / (2·√π)."""


def write(stream: BinaryIO, gaussians: StoredGaussians) -> None:
    """Write centers in m (y up, z to the viewer) and 8-bit colors."""
    colors = np.rint((0.5 + SH_C0 * gaussians.sh_dc).clip(0, 1) * 255)
    np.savetxt(stream, np.hstack((gaussians.means, colors)), fmt="%.6f %.6f %.6f %d %d %d")


def losses(gaussians: StoredGaussians) -> list[str]:
    """What the format cannot hold."""
    return [".xyz keeps centers and colors of Gaussians, not their size, rotation and opacity"]
