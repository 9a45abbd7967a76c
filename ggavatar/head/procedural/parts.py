"""Parts of the procedural head besides the skin: lid margins, mouth bag, eyeballs, teeth, tongue and ears.

Lengths in m, FLAME's axes.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int
from numpy import ndarray

from ggavatar.head.procedural.surface import EYE_RADIUS

_EYE_AROUND, _EYE_RINGS = 28, 14
_TOOTH_WIDTHS = (0.0085, 0.0066, 0.0076, 0.0070, 0.0068, 0.0098, 0.0095)
_LOWER_TOOTH_WIDTHS = (0.0054, 0.0059, 0.0068, 0.0070, 0.0071, 0.0108, 0.0102)


@dataclass(frozen=True)
class Part:
    """A separate triangle mesh; `faces` index its own vertices."""

    vertices: Float[ndarray, "V 3"]
    faces: Int[ndarray, "F 3"]


def strip(first: Int[ndarray, " N"], second: Int[ndarray, " N"], *, closed: bool = True) -> Int[ndarray, "F 3"]:
    """Triangles between two loops of equal length, given as vertex indices.

    They face the side from which `first` runs counter-clockwise around `second`.
    """
    count = len(first) if closed else len(first) - 1
    index = np.arange(count)
    following = (index + 1) % len(first)
    a, b, c, d = first[index], first[following], second[index], second[following]
    return np.concatenate((np.stack((a, b, c), axis=1), np.stack((b, d, c), axis=1)))


def grid_faces(rows: int, columns: int, *, closed: bool = False) -> Int[ndarray, "F 3"]:
    """Triangles of a grid of vertices in row-major order; `closed` joins the last column to the first."""
    numbers = np.arange(rows * columns).reshape(rows, columns)
    return np.concatenate([strip(numbers[row], numbers[row + 1], closed=closed) for row in range(rows - 1)])


def lid_margin(loop: Float[ndarray, "N 3"], center: Float[ndarray, " 3"]) -> list[ndarray]:
    """Two loops that continue a lid's edge inwards: across its thickness, then behind the front of the eyeball."""
    offset = loop - center
    length = np.linalg.norm(offset, axis=1, keepdims=True)
    edge = center + offset * ((EYE_RADIUS + np.minimum(length - EYE_RADIUS, 0.0003)) / length)
    edge = np.where(length > EYE_RADIUS + 0.0022, loop - (0.0, 0.0, 0.0012) - 0.0004 * offset / length, edge)
    pressed = offset * (0.86, 1.0, 1.0)
    behind = center + pressed * (0.985 * EYE_RADIUS / np.linalg.norm(pressed, axis=1, keepdims=True))
    return [edge, behind]


def mouth_bag(loop: Float[ndarray, "N 3"]) -> list[ndarray]:
    """Loops from the lip margin into a pocket behind the teeth, from outside to inside.

    The caller closes the last one with a fan of triangles.
    """
    side = np.sin(np.arange(len(loop)) * 2 * np.pi / len(loop))
    middle = loop.mean(axis=0)
    loops = []
    for back, tall, wide in (
        (0.0016, 0.0002, 1.0),
        (0.0042, 0.0022, 1.0),
        (0.0068, 0.0085, 1.04),
        (0.0105, 0.0150, 1.12),
    ):
        ring = loop.copy()
        ring[:, 0] *= wide
        ring[:, 1] += tall * np.sign(side) * np.abs(side) ** 0.6
        ring[:, 2] -= back
        loops.append(ring)
    for depth, tall, wide in ((0.020, 0.0190, 0.030), (0.000, 0.0190, 0.028), (-0.014, 0.012, 0.016)):
        x = wide * loop[:, 0] / np.abs(loop[:, 0]).max()
        loops.append(
            np.stack((x, middle[1] + tall * np.sign(side) * np.abs(side) ** 0.6, np.full(len(loop), depth)), axis=1)
        )
    return loops


def eyeball(center: Float[ndarray, " 3"]) -> Part:
    """A sphere with its pole at the pupil, a slightly bulging cornea, and denser rings there."""
    share = np.linspace(0, 1, _EYE_RINGS + 1)[1:-1]
    polar = np.pi * (0.55 * share + 0.45 * share**2.2)
    around = np.arange(_EYE_AROUND) * 2 * np.pi / _EYE_AROUND
    ring = np.stack((np.cos(around), np.sin(around)), axis=1)
    body = np.concatenate([np.column_stack((np.sin(p) * ring, np.full(_EYE_AROUND, np.cos(p)))) for p in polar])
    unit = np.concatenate(([[0.0, 0.0, 1.0]], body, [[0.0, 0.0, -1.0]]))
    bulge = 0.0006 * np.exp(-((np.arccos(np.clip(unit[:, 2], -1, 1)) / 0.42) ** 4))
    faces = grid_faces(len(polar), _EYE_AROUND, closed=True)[:, ::-1] + 1
    first, last = np.arange(_EYE_AROUND) + 1, np.arange(_EYE_AROUND) + 1 + (len(polar) - 1) * _EYE_AROUND
    cap = np.stack((np.zeros_like(first), first, np.roll(first, -1)), axis=1)
    end = np.stack((np.full_like(last, len(unit) - 1), np.roll(last, -1), last), axis=1)
    return Part(center + unit * (EYE_RADIUS + bulge)[:, None], np.concatenate((cap, faces, end)))


def teeth(*, upper: bool) -> Part:
    """A dental arch of fourteen teeth as one closed band: gum, front, biting edge, back."""
    widths = np.asarray(_TOOTH_WIDTHS if upper else _LOWER_TOOTH_WIDTHS)
    samples, tooth, inside = _arch_samples(widths)
    front_z, half = (0.0426, 0.0256) if upper else (0.0404, 0.0236)
    x, z, normal = _arch(samples, front_z, half)
    bulge = np.sqrt(np.clip(1 - inside**2, 0, 1))
    height = np.interp(np.abs(tooth), [0, 1, 2, 3, 6], [0.0102, 0.0092, 0.0098, 0.0085, 0.0068]) * (0.93 + 0.07 * bulge)
    sign, edge = (1.0, -0.0478 if upper else -0.0480) if upper else (-1.0, -0.0480)
    height = height if upper else height * 0.86
    edge_y = edge + sign * (0.0102 if upper else 0.0088) - sign * height
    back = np.interp(np.abs(tooth), [0, 2, 4, 6], [0.0040, 0.0050, 0.0080, 0.0095])
    rows = []
    for rise, inwards in (
        (0.0145, 0.004),
        (0.0108, 0.0004),
        (0.0085, 0.0),
        (0.0045, -0.0005),
        (0.0010, 0.0),
        (0.0, 0.0012),
        (0.0, 1.0),
        (0.0145, 1.0),
    ):
        shrink = 0.0009 * (1 - bulge) if inwards < 0.5 else 0.0
        depth = inwards * back if inwards > 0.5 else inwards + shrink
        y = edge_y + sign * (rise * height / (0.0102 if upper else 0.0088))
        rows.append(np.stack((x - normal[:, 0] * depth, y, z - normal[:, 1] * depth), axis=1))
    faces = grid_faces(len(rows), len(samples))
    return Part(np.concatenate(rows), faces if not upper else faces[:, ::-1])


def _arch_samples(widths: ndarray) -> tuple[ndarray, ndarray, ndarray]:
    """Positions along the arch, signed tooth numbers and positions within the tooth in [−1, 1]; five samples each."""
    edges = np.concatenate(([0.0], np.cumsum(widths)))
    inside = np.array([-0.97, -0.75, 0.0, 0.75, 0.97])
    right = np.concatenate([(edges[i] + edges[i + 1]) / 2 + inside * widths[i] / 2 for i in range(len(widths))])
    number = np.repeat(np.arange(len(widths)), len(inside)).astype(float)
    place = np.tile(inside, len(widths))
    return (
        np.concatenate((-right[::-1], right)),
        np.concatenate((-number[::-1], number)),
        np.concatenate((-place[::-1], place)),
    )


def _arch(samples: ndarray, front: float, half: float) -> tuple[ndarray, ndarray, ndarray]:
    """x, z and outward normal (x, z) along an elliptic arch of half width `half`, by arc length from the middle."""
    angle = np.linspace(-np.pi / 2, np.pi / 2, 2001)
    depth = 0.044
    curve = np.stack((half * np.sin(angle), front - depth * (1 - np.cos(angle))), axis=1)
    length = np.concatenate(([0.0], np.cumsum(np.linalg.norm(np.diff(curve, axis=0), axis=1))))
    length -= length[-1] / 2
    at = np.interp(samples, length, angle)
    normal = np.stack((np.sin(at) / half, np.cos(at) / depth), axis=1)
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    return half * np.sin(at), front - depth * (1 - np.cos(at)), normal


def tongue() -> Part:
    """A flat ellipsoid with a groove, its tip behind the lower front teeth."""
    rows, around = 12, 18
    share = np.linspace(0, np.pi, rows + 2)[1:-1]
    angle = np.arange(around) * 2 * np.pi / around
    width = 0.0185 * np.sin(share) ** 0.6
    x = width[:, None] * np.cos(angle)
    lift = np.where(np.sin(angle) > 0, 0.0075, 0.0050) * np.sin(angle)
    groove = 0.0020 * np.exp(-((x / 0.004) ** 2)) * (np.sin(angle) > 0.3)
    y = np.sin(share)[:, None] ** 0.6 * lift - groove - 0.0555 + 0.004 * (1 - np.cos(share))[:, None]
    z = 0.0130 + 0.0235 * np.cos(share)[:, None] + 0 * x
    body = np.stack((x, y, z), axis=-1).reshape(-1, 3)
    ends = np.array([[0.0, -0.0555, 0.0368], [0.0, -0.0475, -0.0108]])
    last = rows * around
    first, end = np.arange(around), np.arange(around) + (rows - 1) * around
    tip = np.stack((np.full(around, last), first, np.roll(first, -1)), axis=1)
    root = np.stack((np.full(around, last + 1), np.roll(end, -1), end), axis=1)
    return Part(
        np.concatenate((body, ends)), np.concatenate((grid_faces(rows, around, closed=True)[:, ::-1], tip, root))
    )


@dataclass(frozen=True)
class EarRing:
    """One ring of the ear: its size relative to the outline, and how far it stands out from the head, m."""

    size: float
    lift: float


_EAR_RINGS = (
    EarRing(0.14, -0.0010),
    EarRing(0.30, 0.0000),
    EarRing(0.44, 0.0040),
    EarRing(0.55, 0.0088),
    EarRing(0.66, 0.0092),
    EarRing(0.76, 0.0070),
    EarRing(0.85, 0.0082),
    EarRing(0.94, 0.0110),
    EarRing(1.00, 0.0105),
    EarRing(1.00, 0.0080),
    EarRing(0.92, 0.0055),
    EarRing(0.80, -0.0040),
)
_EAR_AROUND = 30


def left_ear() -> Part:
    """The left auricle: concha, antihelix, scapha and helix as rings around the ear canal; open towards the head."""
    angle = np.arange(_EAR_AROUND) * 2 * np.pi / _EAR_AROUND
    outline = _ear_outline(angle)
    rings = []
    for ring in _EAR_RINGS:
        front = np.clip(np.cos(angle - 0.15), 0, 1) ** 1.5
        lobe = np.clip(-np.sin(angle), 0, 1) ** 3
        flat = outline * ring.size
        lift = ring.lift * (1 - 0.55 * front) * (1 - 0.35 * lobe) + 0.0018 * lobe * ring.size
        lift = lift + 0.0115 * np.clip(-flat[:, 0] / 0.02, 0, 1.2) * ring.size
        rings.append(np.column_stack((lift, flat[:, 1], flat[:, 0])))
    rings = [np.tile(rings[0].mean(axis=0) - (0.004, 0, 0), (1, 1)), *rings]
    vertices = np.concatenate(rings)
    faces = grid_faces(len(_EAR_RINGS), _EAR_AROUND, closed=True) + 1
    hub = np.arange(_EAR_AROUND) + 1
    faces = np.concatenate((np.stack((np.zeros_like(hub), np.roll(hub, -1), hub), axis=1), faces))
    tilt = np.deg2rad(-12)
    turned = vertices.copy()
    turned[:, 1] = np.cos(tilt) * vertices[:, 1] - np.sin(tilt) * vertices[:, 2]
    turned[:, 2] = np.sin(tilt) * vertices[:, 1] + np.cos(tilt) * vertices[:, 2]
    return Part(turned + np.array([0.0695, 0.0050, -0.0260]), faces)


def _ear_outline(angle: ndarray) -> ndarray:
    """Outline in (forward, up) around the ear canal, m; angle 0 is forward, π/2 up."""
    forward = np.cos(angle) * np.interp(np.cos(angle), [-1, 0, 1], [0.0230, 0.018, 0.0100])
    up = np.where(np.sin(angle) > 0, 0.0330, 0.0300) * np.sin(angle)
    narrow = 1 - 0.45 * np.clip(-np.sin(angle), 0, 1) ** 2
    return np.stack((forward * narrow - 0.004 * np.sin(angle) * (np.sin(angle) > 0), up), axis=1)
