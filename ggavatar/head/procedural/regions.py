"""Named vertex sets of the procedural head."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float, Int
from numpy import ndarray

from ggavatar.head.procedural.skin import MOUTH_HALF_WIDTH, lid_curve, lip_line_height


def named_regions(
    points: Float[ndarray, "V 3"], groups: dict[str, Int[ndarray, " R"]], lids: tuple[ndarray, ndarray], lips: ndarray
) -> dict[str, ndarray]:
    """Vertex sets of the generic head: its parts, and areas of the skin; they may overlap.

    Args:
        points: Vertices of the generic head, m.
        groups: Vertex sets of the parts.
        lids: Loops of the left and the right lid margin.
        lips: Loop of the lip margin.
    """
    skin = groups["skin"]
    x, y, z = np.abs(points[skin, 0]), points[skin, 1], points[skin, 2]
    hairline = y - 0.080 - 0.25 * np.clip(z - 0.02, 0, 1) + 0.9 * np.clip(0.025 - z, 0, 0.07)
    chosen = {
        "scalp": (hairline > 0) & (y > -0.045 - 0.4 * np.clip(z + 0.09, 0, 1)),
        "neck": (y < -0.092 - 0.25 * np.clip(z, -0.04, 0.02)) & (y > -0.145)
        | (y <= -0.045) & (y > -0.145) & (z < -0.045),
        "shoulders": y <= -0.145,
        "lips": _lips(x, y, z),
        "nose": (x < 0.019) & (y < 0.022) & (y > -0.030) & (z > 0.047),
        "eyes": ((x - lid_curve()[:, 0].mean()) / 0.022) ** 2 + ((y - 0.024) / 0.015) ** 2 + 9.0 * (z < 0.0) < 1,
    }
    regions = {name: skin[mask] for name, mask in chosen.items()}
    off_face = np.concatenate((regions["scalp"], regions["neck"], regions["shoulders"]))
    regions["face"] = np.setdiff1d(skin[z > -0.035], off_face)
    regions["teeth"] = np.concatenate((groups["upper_teeth"], groups["lower_teeth"]))
    regions["mouth"] = np.unique(
        np.concatenate((regions["lips"], groups["mouth_bag"], regions["teeth"], groups["tongue"]))
    )
    regions["eyes"] = np.unique(np.concatenate((regions["eyes"], groups["left_eyeball"], groups["right_eyeball"])))
    regions |= {name: groups[name] for name in groups if name not in ("skin",)}
    regions |= {"skin": skin, "left_lid_margin": lids[0], "right_lid_margin": lids[1], "lip_margin": lips}
    return regions


def _lips(x: ndarray, y: ndarray, z: ndarray) -> ndarray:
    """Mask of the vermilion: up to 7 mm above and 9 mm below the line between the lips, less towards the corners."""
    across = np.clip(x / (MOUTH_HALF_WIDTH + 0.001), 0, 1)
    height = y - lip_line_height(x)
    return (
        (height < 0.0072 * (1 - across**2.5))
        & (height > -0.0092 * (1 - across**2.5))
        & (z > 0.02)
        & (x < MOUTH_HALF_WIDTH + 0.001)
    )
