"""Rasterization of strands as thin camera-facing lines with coverage, sorted by depth, over an image with z-buffer."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from numpy import ndarray

from ggavatar.jit.kernels import inlined, kernel

_BEHIND, _NEAR, _TINY = np.float32(0.0015), np.float32(0.05), np.float32(1e-6)
_ZERO, _HALF, _ONE, _OPAQUE = np.float32(0.0), np.float32(0.5), np.float32(1.0), np.float32(0.004)


@dataclass(frozen=True)
class Strands:
    """S strands of N nodes.

    Attributes:
        pixels: Position of every node in samples, and camera z, m.
        colors: Linear color of every node.
        widths: Width at every node in samples; lines thinner than a sample cover it partially.
    """

    pixels: Float[ndarray, "S N 3"]
    colors: Float[ndarray, "S N 3"]
    widths: Float[ndarray, "S N"]

    def segments(self) -> Float[ndarray, "M 13"]:
        """One row per segment: start, end, color at the start, color at the end, mean width."""
        parts = (
            self.pixels[:, :-1],
            self.pixels[:, 1:],
            self.colors[:, :-1],
            self.colors[:, 1:],
            0.5 * (self.widths[:, :-1] + self.widths[:, 1:])[..., None],
        )
        return np.concatenate(parts, axis=2, dtype=np.float32).reshape(-1, 13)


def rasterize_strands(
    strands: Sequence[Strands],
    depth: Float[ndarray, "H W"],
    color: Float[ndarray, "H W 3"],
    alpha: Float[ndarray, "H W"],
) -> None:
    """Composite strands over `color` (premultiplied) and `alpha`, in place.

    Args:
        strands: Strands in any order; all are sorted together.
        depth: Camera z of the surfaces, m; strands more than 1.5 mm behind them are hidden.
        color: The image.
        alpha: Its coverage.
    """
    segments = np.concatenate([item.segments() for item in strands])
    nearest_first = np.argsort(segments[:, 2] + segments[:, 5], kind="stable")
    layer, transmittance = np.zeros_like(color), np.ones_like(alpha)
    _draw(segments, nearest_first, depth, layer, transmittance)
    color *= transmittance[..., None]
    color += layer
    alpha *= transmittance
    alpha += 1 - transmittance


@kernel
def _draw(segments, order, depth, layer, transmittance):
    """Draw segments front to back, so that segments behind opaque ones are skipped."""
    for index in order:
        segment = segments[index]
        if min(segment[2], segment[5]) > _NEAR and not _covered(segment, depth, transmittance):
            _draw_segment(segment, depth, layer, transmittance)


@inlined
def _covered(segment, depth, transmittance):
    """Whether both ends and the middle of a segment are outside the image, behind a surface or behind opaque hair."""
    height, width = depth.shape
    for step in range(3):
        share = _HALF * np.float32(step)
        column = int(np.floor(segment[0] + share * (segment[3] - segment[0])))
        row = int(np.floor(segment[1] + share * (segment[4] - segment[1])))
        if row < 0 or column < 0 or row >= height or column >= width:
            continue
        distance = segment[2] + share * (segment[5] - segment[2])
        if transmittance[row, column] > _OPAQUE and distance < depth[row, column] + _BEHIND:
            return False
    return True


@inlined
def _draw_segment(segment, depth, layer, transmittance):
    """Draw one segment: walk along its longer side and cover a window of samples across it."""
    height, width = depth.shape
    ax, ay, az = segment[0], segment[1], segment[2]
    dx, dy, dz = segment[3] - ax, segment[4] - ay, segment[5] - az
    share, reach = min(segment[12], _ONE), _HALF * max(segment[12], _ONE) + _HALF
    squared = max(dx * dx + dy * dy, _TINY)
    per_squared, length = _ONE / squared, np.sqrt(squared)
    per_length = _ONE / length
    steep = abs(dy) >= abs(dx)
    start, run, side, slope = (ay, dy, ax, dx) if steep else (ax, dx, ay, dy)
    slope = slope / run if abs(run) > _TINY else _ZERO
    window = reach * min(length / max(abs(run), _TINY), _ONE + _ONE)
    along_size, across_size = (height, width) if steep else (width, height)
    first = int(max(min(start, start + run) - reach, _ZERO))
    last = int(min(max(start, start + run) + reach, np.float32(along_size - 1)))
    for major in range(first, last + 1):
        middle = side + slope * (np.float32(major) + _HALF - start)
        low = int(max(middle - window, _ZERO))
        high = int(min(middle + window, np.float32(across_size - 1)))
        for minor in range(low, high + 1):
            row, column = (major, minor) if steep else (minor, major)
            px, py = np.float32(column) + _HALF - ax, np.float32(row) + _HALF - ay
            along = (px * dx + py * dy) * per_squared
            cover = min(reach - abs(px * dy - py * dx) * per_length, _ONE) * share
            if cover <= 0 or along < 0 or along >= 1 or az + along * dz > depth[row, column] + _BEHIND:
                continue
            weight = cover * transmittance[row, column]
            transmittance[row, column] -= weight
            for channel in range(3):
                tone = segment[6 + channel] + (segment[9 + channel] - segment[6 + channel]) * along
                layer[row, column, channel] += tone * weight
