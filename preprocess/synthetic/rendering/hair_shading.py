"""Shading of strands: Kajiya and Kay (1989) with the two shifted highlights of Scheuermann (2004)."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float
from numpy import ndarray

from ggavatar.jit.kernels import kernel
from preprocess.synthetic.rendering.shading import Lights, Shadow, shadowed


def strand_colors(
    nodes: Float[ndarray, "S N 3"],
    tones: Float[ndarray, "S 3"],
    ambient_visibility: Float[ndarray, "S N"],
    lights: Lights,
    shadow: Shadow,
) -> Float[ndarray, "S N 3"]:
    """Linear color of every node.

    Args:
        nodes: Positions, m.
        tones: Linear color of each strand.
        ambient_visibility: Fraction of light that reaches each node through the other strands.
        lights: The room's lights.
        shadow: Shadow map of the key light.
    """
    colors = np.empty(nodes.shape, np.float32)
    single = (np.ascontiguousarray(values, np.float32) for values in (nodes, tones, ambient_visibility))
    _light(*single, lights, shadow, colors)
    return colors


@kernel
def _light(nodes, tones, ambient_visibility, lights, shadow, colors):
    """Fill `colors` [S, N, 3] node by node."""
    count = nodes.shape[1]
    for strand in range(nodes.shape[0]):
        for node in range(count):
            first, last = max(node - 1, 0), min(node + 1, count - 1)
            tx = nodes[strand, last, 0] - nodes[strand, first, 0]
            ty = nodes[strand, last, 1] - nodes[strand, first, 1]
            tz = nodes[strand, last, 2] - nodes[strand, first, 2]
            length = np.sqrt(tx * tx + ty * ty + tz * tz) + 1e-9
            tx, ty, tz = tx / length, ty / length, tz / length
            x, y, z = nodes[strand, node, 0], nodes[strand, node, 1], nodes[strand, node, 2]
            vx, vy, vz = lights.camera[0] - x, lights.camera[1] - y, lights.camera[2] - z
            length = np.sqrt(vx * vx + vy * vy + vz * vz)
            vx, vy, vz = vx / length, vy / length, vz / length
            visibility = ambient_visibility[strand, node]
            lit = shadowed(shadow, x, y, z)
            for channel in range(3):
                colors[strand, node, channel] = tones[strand, channel] * visibility * (0.65 * lights.sky[channel] + 0.2)
            for light in range(lights.directions.shape[0]):
                lx, ly, lz = lights.directions[light, 0], lights.directions[light, 1], lights.directions[light, 2]
                reach = visibility * (0.25 + 0.75 * lit if light == 0 else 0.8)
                cosine = tx * lx + ty * ly + tz * lz
                sine = np.sqrt(max(1 - cosine * cosine, 0.0))
                hx, hy, hz = lx + vx, ly + vy, lz + vz
                length = np.sqrt(hx * hx + hy * hy + hz * hz) + 1e-9
                along = (tx * hx + ty * hy + tz * hz) / length
                narrow = max(1 - (along - 0.08) ** 2, 0.0) ** 60
                broad = max(1 - (along + 0.12) ** 2, 0.0) ** 14
                for channel in range(3):
                    glow = tones[strand, channel] * (0.85 * sine + 0.9 * broad) + 0.06 * narrow
                    colors[strand, node, channel] += lights.colors[light, channel] * reach * glow
