"""Color and fine relief of skin, lips, eyes and teeth, painted in texture space.

Colors are sRGB, lengths in m, points on the generic head.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from jaxtyping import Float, Int
from numpy import ndarray
from scipy.spatial import cKDTree

from ggavatar.head.procedural.skin import MOUTH_HALF_WIDTH, lid_curve, lip_line_height
from ggavatar.head.procedural.surface import EYE_CENTER, EYE_RADIUS
from preprocess.synthetic.person.description import Person
from preprocess.synthetic.person.texture_space import Texels, mirrored_gaussian, noise, smoothstep

_IRIS_ANGLE, _PUPIL_ANGLE = 0.475, 0.175
# x at which the front teeth meet, m; the arch is almost flat there.
_UPPER_GAPS, _LOWER_GAPS = (0.0, 0.0084, 0.0145, 0.0202), (0.0, 0.0053, 0.0109, 0.0164)


def blend(
    base: Float[ndarray, "N 3"], color: tuple[float, float, float] | ndarray, amount: Float[ndarray, " N"]
) -> Float[ndarray, "N 3"]:
    """Colors blended towards another color by `amount`."""
    return base + (np.asarray(color) - base) * amount[:, None]


def scalp_coverage(points: Float[ndarray, "N 3"]) -> Float[ndarray, " N"]:
    """Where scalp hair grows, with a soft hairline: 1 on the crown, 0 on the face, around the ears and on the nape."""
    x, y, z = np.abs(points[:, 0]), points[:, 1], points[:, 2]
    ragged = 0.0022 * noise(points, 0.009, 11) + 0.0010 * noise(points, 0.0025, 14)
    line = np.interp(
        z,
        [-0.125, -0.085, -0.060, -0.035, -0.012, 0.004, 0.018, 0.040],
        [-0.042, -0.046, -0.036, -0.004, 0.018, 0.050, 0.074, 0.083],
    )
    line = (
        line
        - 0.004 * np.exp(-((x / 0.016) ** 2)) * (z > 0)
        + 0.005 * np.exp(-(((x - 0.040) / 0.010) ** 2)) * (z > 0.01)
    )
    return smoothstep(-0.007, 0.006, y - line + ragged)


def beard_coverage(points: Float[ndarray, "N 3"]) -> Float[ndarray, " N"]:
    """Where a beard grows, 0 to 1: jaw, chin, upper lip, sideburns, upper throat."""
    x, y, z = np.abs(points[:, 0]), points[:, 1], points[:, 2]
    ragged = 0.003 * noise(points, 0.007, 12)
    upper = np.interp(x, [0.0, 0.020, 0.028, 0.047, 0.059, 0.066], [-0.030, -0.031, -0.048, -0.041, -0.016, 0.030])
    lower = np.interp(z, [-0.03, 0.0, 0.03], [-0.075, -0.098, -0.110])
    inside = (
        smoothstep(-0.005, 0.006, upper - y + ragged)
        * smoothstep(-0.005, 0.005, y - lower + ragged)
        * smoothstep(-0.034, -0.018, z)
    )
    return (
        inside
        * (1 - smoothstep(0.2, 0.8, vermilion(points)))
        * (1 - 0.75 * mirrored_gaussian(points, (0.0, -0.058, 0.052), (0.016, 0.0025, 0.02)))
    )


def vermilion(points: Float[ndarray, "N 3"]) -> Float[ndarray, " N"]:
    """1 on the red of the lips, 0 on skin, with a soft border and a Cupid's bow."""
    x = np.abs(points[:, 0])
    across = np.clip(x / (MOUTH_HALF_WIDTH + 0.0005), 0, 1)
    height = points[:, 1] - lip_line_height(points[:, 0])
    bow = (
        0.0066 * (1 - across**2.2)
        - 0.0016 * np.exp(-((x / 0.0030) ** 2))
        + 0.0006 * np.exp(-(((x - 0.006) / 0.004) ** 2))
    )
    lower = 0.0088 * (1 - across**2.4)
    inside = np.minimum(bow - height, height + lower)
    return smoothstep(-0.0009, 0.0007, inside) * (points[:, 2] > 0.02) * smoothstep(1.0, 0.985, across)


def skin_color(points: Float[ndarray, "N 3"], person: Person, seed: int) -> Float[ndarray, "N 3"]:
    """Color of the skin with its zones, freckles, stubble, lips and the shade of hair roots, sRGB."""
    skin = person.skin
    color = np.tile(np.asarray(skin.tone), (len(points), 1))
    mottle = (
        0.5 * noise(points, 0.022, seed) + 0.35 * noise(points, 0.008, seed + 1) + 0.2 * noise(points, 0.0028, seed + 2)
    )
    color *= (1 + 0.035 * mottle)[:, None]
    cheeks = mirrored_gaussian(points, (0.040, -0.012, 0.032), (0.020, 0.017, 0.03))
    nose = mirrored_gaussian(points, (0.0, -0.016, 0.066), (0.017, 0.012, 0.016))
    ears = smoothstep(0.071, 0.080, np.abs(points[:, 0])) * (points[:, 1] < 0.05)
    blood = np.clip(
        0.50 * cheeks
        + 0.55 * nose
        + 0.5 * ears
        + 0.16 * mirrored_gaussian(points, (0.0, -0.075, 0.05), (0.02, 0.012, 0.02)),
        0,
        1,
    )
    color = blend(color, skin.flush, blood * (0.75 + 0.25 * noise(points, 0.010, seed + 3)))
    lids = mirrored_gaussian(points, (0.031, 0.0245, 0.034), (0.019, 0.013, 0.02))
    color = blend(color, np.asarray(skin.tone) * (0.80, 0.68, 0.66), 0.42 * lids)
    color = blend(
        color,
        np.asarray(skin.tone) * (0.78, 0.70, 0.74),
        0.35 * mirrored_gaussian(points, (0.026, 0.010, 0.038), (0.014, 0.006, 0.02)),
    )
    if skin.freckles > 0:
        color = blend(color, np.asarray(skin.tone) * (0.80, 0.64, 0.54), skin.freckles * _freckles(points, seed))
    if skin.stubble > 0:
        grain = 0.65 + 0.35 * noise(points, 0.0014, seed + 7)
        color = blend(
            color,
            np.asarray(person.hair.color) * 0.5 + np.asarray(skin.tone) * 0.40,
            skin.stubble * 0.75 * beard_coverage(points) * grain,
        )
    lips = vermilion(points)
    lines = 1 + 0.10 * noise(points * (6.0, 0.8, 1.0), 0.004, seed + 8)
    color = blend(color, np.asarray(skin.lips), lips) * np.where(lips > 0.3, lines, 1.0)[:, None]
    roots = scalp_coverage(points) * (0.93 if person.hair.length > 0.03 else 0.86) * (person.hair.length > 0)
    color = blend(color, np.asarray(person.hair.color) * 0.55, roots)
    if person.beard:
        color = blend(
            color, np.asarray(person.beard.color) * 0.8 + np.asarray(skin.tone) * 0.12, 0.8 * beard_coverage(points)
        )
    color = blend(
        color,
        np.asarray(person.brow) * 0.6 + np.asarray(skin.tone) * 0.35,
        0.55 * person.brow_weight * brow_coverage(points),
    )
    nostril = mirrored_gaussian(points, (0.0068, -0.0262, 0.0585), (0.0030, 0.0028, 0.0050))
    color = blend(color, np.asarray(skin.tone) * (0.30, 0.16, 0.13), np.clip(1.5 * nostril - 0.25, 0, 0.95))
    return _lid_edges(color, points, person)


def brow_coverage(points: Float[ndarray, "N 3"]) -> Float[ndarray, " N"]:
    """Where eyebrows grow, 0 to 1."""
    x, y = np.abs(points[:, 0]), points[:, 1]
    middle = np.interp(x, [0.010, 0.020, 0.034, 0.045, 0.051], [0.0405, 0.0440, 0.0472, 0.0448, 0.0405])
    half = np.interp(x, [0.008, 0.014, 0.034, 0.050], [0.0022, 0.0040, 0.0030, 0.0009])
    ends = smoothstep(0.0085, 0.0125, x) * smoothstep(0.0525, 0.0470, x)
    return smoothstep(1.25, 0.55, np.abs(y - middle) / half) * ends * (points[:, 2] > 0.0)


def _freckles(points: ndarray, seed: int) -> ndarray:
    """Strength of freckles: spots of random size across nose and cheeks."""
    generator = np.random.default_rng(seed + 20)
    zone = np.maximum(
        mirrored_gaussian(points, (0.026, -0.004, 0.045), (0.026, 0.018, 0.04)),
        0.35 * mirrored_gaussian(points, (0.0, 0.06, 0.04), (0.04, 0.02, 0.03)),
    )
    candidates = points[generator.choice(len(points), 1100, replace=False, p=zone / zone.sum())]
    sizes = generator.uniform(0.00035, 0.0011, len(candidates))
    strengths = generator.uniform(0.15, 0.75, len(candidates))
    away, nearest = cKDTree(candidates).query(points, distance_upper_bound=0.003)
    nearest = np.minimum(nearest, len(candidates) - 1)
    return (
        smoothstep(1.3, 0.5, np.minimum(away, 1.0) / sizes[nearest]) * strengths[nearest] * smoothstep(0.02, 0.25, zone)
    )


def _lid_edges(color: ndarray, points: ndarray, person: Person) -> ndarray:
    """Colors with the moist pink rim of the lids and the dark line of the lash roots."""
    folded = np.column_stack((np.abs(points[:, 0]), points[:, 1]))
    fine = np.concatenate(
        [lid_curve(32) + share * (np.roll(lid_curve(32), -1, axis=0) - lid_curve(32)) for share in (0, 0.25, 0.5, 0.75)]
    )
    tree = cKDTree(fine)
    near = (np.abs(points[:, 1] - 0.024) < 0.02) & (points[:, 2] > 0.005) & (folded[:, 0] < 0.055)
    away = np.full(len(points), 1.0)
    away[near] = tree.query(folded[near])[0]
    depth = points[:, 2] - EYE_CENTER[2]
    color = blend(color, (0.72, 0.42, 0.40), smoothstep(0.0011, 0.0002, away) * 0.55)
    upper = points[:, 1] > 0.0236
    dark = np.asarray(person.brow) * 0.5 + np.asarray(person.skin.tone) * 0.15
    line = smoothstep(0.0016, 0.0004, away) * np.where(upper, 0.75, 0.30) * (depth > 0.002) * min(person.lashes, 1.2)
    return blend(color, dark, np.clip(line, 0, 1))


def eye_color(points: Float[ndarray, "N 3"], person: Person, seed: int) -> Float[ndarray, "N 3"]:
    """Color of the eyeball: sclera with fine veins, iris with fibers and a dark limbus, pupil; sRGB."""
    folded = np.column_stack(
        (np.abs(points[:, 0]) - EYE_CENTER[0], points[:, 1] - EYE_CENTER[1], points[:, 2] - EYE_CENTER[2])
    )
    angle = np.arccos(np.clip(folded[:, 2] / np.linalg.norm(folded, axis=1), -1, 1))
    around = np.arctan2(folded[:, 1], folded[:, 0] * np.sign(points[:, 0]))
    color = np.tile((0.90, 0.88, 0.85), (len(points), 1))
    veins = smoothstep(0.75, 1.1, 1 - np.abs(noise(folded * (1, 2.2, 1), 0.0030, seed + 30)) * 2.6) * smoothstep(
        0.55, 1.0, angle
    )
    color = blend(color, (0.80, 0.42, 0.38), 0.30 * veins)
    color = blend(color, (0.82, 0.55, 0.50), 0.5 * smoothstep(0.75, 1.15, np.abs(folded[:, 0]) / EYE_RADIUS * 1.2))
    fibers = np.stack((7 * np.cos(around), 7 * np.sin(around), 9 * angle), axis=1)
    tone = 1 + 0.38 * noise(fibers * 0.01, 0.012, seed + 31) + 0.22 * noise(fibers * 0.03, 0.011, seed + 32)
    iris = np.asarray(person.iris) * tone[:, None]
    iris = blend(iris, np.asarray(person.iris) * (1.5, 1.25, 0.8) + 0.05, smoothstep(0.34, 0.20, angle) * 0.55)
    iris = blend(iris, np.asarray(person.iris) * 0.30, smoothstep(0.40, 0.475, angle))
    color = color + (iris - color) * smoothstep(_IRIS_ANGLE + 0.03, _IRIS_ANGLE - 0.02, angle)[:, None]
    return blend(color, (0.012, 0.012, 0.014), smoothstep(_PUPIL_ANGLE + 0.025, _PUPIL_ANGLE - 0.015, angle))


def tooth_color(points: Float[ndarray, "N 3"], *, upper: bool) -> Float[ndarray, "N 3"]:
    """Color of teeth, slightly yellower and darker towards the gum and the back, and of the gum; sRGB."""
    rise = (points[:, 1] + 0.0475) if upper else (-0.0480 - points[:, 1])
    color = np.tile((0.90, 0.87, 0.80), (len(points), 1))
    color *= (1 - 0.25 * smoothstep(0.030, 0.010, points[:, 2]))[:, None]
    gaps = _UPPER_GAPS if upper else _LOWER_GAPS
    apart = np.abs(np.abs(points[:, :1]) - np.asarray(gaps)).min(axis=1)
    color = blend(color, (0.45, 0.32, 0.26), 0.75 * np.exp(-((apart / 0.00045) ** 2)))
    color = blend(color, (0.82, 0.74, 0.60), 0.5 * smoothstep(0.004, 0.010, rise))
    return blend(color, (0.72, 0.38, 0.38), smoothstep(0.0088, 0.0098, rise))


def paint_head(
    texels: Texels, groups: dict[str, Int[ndarray, " F"]], person: Person, seed: int
) -> Float[ndarray, "R R 3"]:
    """The head's color texture, sRGB; `groups` lists the faces of each anatomical part."""
    bare = replace(person, skin=replace(person.skin, stubble=0.0), beard=None, hair=replace(person.hair, length=-1.0))
    painters = {
        "skin": lambda p: skin_color(p, person, seed),
        "left_ear": lambda p: skin_color(p, bare, seed),
        "right_ear": lambda p: skin_color(p, bare, seed),
        "mouth_bag": lambda p: np.tile((0.48, 0.17, 0.17), (len(p), 1)) * (1 + 0.15 * noise(p, 0.006, seed))[:, None],
        "tongue": lambda p: np.tile((0.70, 0.36, 0.36), (len(p), 1)) * (1 + 0.12 * noise(p, 0.0016, seed))[:, None],
        "left_eyeball": lambda p: eye_color(p, person, seed),
        "right_eyeball": lambda p: eye_color(p, person, seed + 5),
        "upper_teeth": lambda p: tooth_color(p, upper=True),
        "lower_teeth": lambda p: tooth_color(p, upper=False),
    }
    color = np.zeros((len(texels.points), 3))
    for name, paint in painters.items():
        chosen = np.isin(texels.face, groups[name])
        color[chosen] = paint(texels.points[chosen])
    return texels.image(color)


def paint_relief(texels: Texels, groups: dict[str, Int[ndarray, " F"]], seed: int) -> Float[ndarray, "R R"]:
    """Static relief of the head's texture, m: pores, lip lines and the tongue's roughness."""
    points = texels.points
    skin = np.isin(texels.face, np.concatenate((groups["skin"], groups["left_ear"], groups["right_ear"])))
    pores = 0.000028 * noise(points, 0.0016, seed + 40) + 0.000045 * noise(points, 0.0040, seed + 41)
    lips = vermilion(points)
    relief = pores * (1 - 0.6 * lips) + lips * 0.00007 * noise(points * (5.0, 0.8, 1.0), 0.004, seed + 42)
    relief = np.where(skin, relief, 0.0)
    tongue = np.isin(texels.face, groups["tongue"])
    return texels.image(np.where(tongue, 0.00012 * noise(points, 0.0015, seed + 43), relief))
