"""Strands as thin camera-facing lines, blended back to front over an image with a z-buffer."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float
from numpy import ndarray

from ggavatar.compiled import kernel

_BEHIND = 0.0015


def draw_strands(
    pixels: Float[ndarray, "S N 3"],
    colors: Float[ndarray, "S N 3"],
    widths: Float[ndarray, "S N"],
    depth: Float[ndarray, "H W"],
    color: Float[ndarray, "H W 3"],
    alpha: Float[ndarray, "H W"],
) -> None:
    """Draw S strands of N nodes over `color` (premultiplied) and `alpha`, in place.

    Args:
        pixels: Position in samples and camera z, m.
        colors: Linear colour of every node.
        widths: Width in samples; lines thinner than a sample cover it in part.
        depth: Camera z of the surfaces, m; strands more than 1.5 mm behind are hidden.
        color: Image so far.
        alpha: Coverage so far.
    """
    middle = (pixels[:, 1:, 2] + pixels[:, :-1, 2]).ravel()
    order = np.argsort(-middle, kind="stable")
    _draw(
        *(np.ascontiguousarray(values, np.float32) for values in (pixels, colors, widths)), order, depth, color, alpha
    )


@kernel
def _draw(pixels, colors, widths, order, depth, color, alpha):
    """Walk the segments in `order`, each along its longer side, with a window of samples across."""
    height, width = depth.shape
    segments = pixels.shape[1] - 1
    for item in range(order.shape[0]):
        strand, node = order[item] // segments, order[item] % segments
        ax, ay, az = pixels[strand, node, 0], pixels[strand, node, 1], pixels[strand, node, 2]
        dx, dy, dz = (
            pixels[strand, node + 1, 0] - ax,
            pixels[strand, node + 1, 1] - ay,
            pixels[strand, node + 1, 2] - az,
        )
        if min(az, az + dz) < 0.05:
            continue
        thickness = 0.5 * (widths[strand, node] + widths[strand, node + 1])
        share, reach = min(thickness, 1.0), 0.5 * max(thickness, 1.0) + 0.5
        squared = max(dx * dx + dy * dy, 1e-6)
        length = np.sqrt(squared)
        steep = abs(dy) >= abs(dx)
        start, run, side, slope = (ay, dy, ax, dx) if steep else (ax, dx, ay, dy)
        slope = slope / run if abs(run) > 1e-6 else 0.0
        window = reach * length / max(abs(run), 1e-3) if abs(run) > 1e-3 else reach
        window = min(window, 2.0 * reach)
        long_size, short_size = (height, width) if steep else (width, height)
        first, last = (
            int(max(min(start, start + run) - reach, 0.0)),
            int(min(max(start, start + run) + reach, long_size - 1.0)),
        )
        for major in range(first, last + 1):
            middle = side + slope * (major + 0.5 - start)
            low, high = int(max(middle - window, 0.0)), int(min(middle + window, short_size - 1.0))
            for minor in range(low, high + 1):
                row, column = (major, minor) if steep else (minor, major)
                px, py = column + 0.5 - ax, row + 0.5 - ay
                along = (px * dx + py * dy) / squared
                if along < 0.0 or along >= 1.0:
                    continue
                cover = min(max(reach - abs(px * dy - py * dx) / length, 0.0), 1.0) * share
                if cover <= 0.0 or az + along * dz > depth[row, column] + _BEHIND:
                    continue
                for channel in range(3):
                    tone = colors[strand, node, channel] * (1 - along) + colors[strand, node + 1, channel] * along
                    color[row, column, channel] += (tone - color[row, column, channel]) * cover
                alpha[row, column] += (1 - alpha[row, column]) * cover
