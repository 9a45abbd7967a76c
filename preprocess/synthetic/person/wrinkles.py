"""Wrinkles and bulges that appear with expressions, which a linear head model cannot express."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from numpy import ndarray

from preprocess.synthetic.person.texture_space import Texels, mirrored_gaussian, noise, smoothstep

Point = tuple[float, float]


@dataclass(frozen=True)
class Fold:
    """A group of wrinkles on both halves of the face.

    Attributes:
        curves: Polylines in x, y of the generic head seen from the front, left half, m.
        drivers: Expression names (without the side if `sided`) and weights; see `strength`.
        depth: Depth of the groove at full strength, m.
        width: Half width of the groove, m.
        sided: Whether each half has its own strength.
        rest: Fraction of the depth that remains at rest with age.
    """

    curves: tuple[tuple[Point, ...], ...]
    drivers: tuple[tuple[str, float], ...]
    depth: float
    width: float
    sided: bool = True
    rest: float = 0.3


FOLDS = (
    Fold(
        tuple(
            ((0.0, y), (0.012, y + 0.0016), (0.026, y + 0.0005), (0.038, y - 0.004))
            for y in (0.0570, 0.0645, 0.0722, 0.0800)
        ),
        (("brow_inner_up", 0.6), ("brow_outer_up_left", 0.3), ("brow_outer_up_right", 0.3)),
        0.00075,
        0.0013,
        sided=False,
        rest=0.35,
    ),
    Fold(
        (((0.0052, 0.0360), (0.0060, 0.0430), (0.0050, 0.0510)),),
        (("brow_down_left", 0.5), ("brow_down_right", 0.5)),
        0.0009,
        0.0012,
        sided=False,
        rest=0.3,
    ),
    Fold(
        (((0.0045, 0.0200), (0.0105, 0.0130)), ((0.0050, 0.0150), (0.0115, 0.0080)), ((0.0, 0.0290), (0.0080, 0.0270))),
        (("nose_wrinkle", 1.0),),
        0.0006,
        0.0009,
        rest=0.05,
    ),
    Fold(
        (
            ((0.0495, 0.0250), (0.0590, 0.0300)),
            ((0.0500, 0.0225), (0.0600, 0.0220)),
            ((0.0490, 0.0200), (0.0580, 0.0140)),
        ),
        (("smile", 0.45), ("cheek_squint", 0.5), ("eye_squint", 0.4)),
        0.0006,
        0.0010,
        rest=0.4,
    ),
    Fold(
        (((0.0180, -0.0150), (0.0245, -0.0230), (0.0305, -0.0350), (0.0325, -0.0480), (0.0315, -0.0560)),),
        (("smile", 0.9), ("upper_lip_raise", 0.5), ("nose_wrinkle", 0.5), ("cheek_squint", 0.2)),
        0.0013,
        0.0020,
        rest=0.35,
    ),
    Fold(
        (((0.0370, -0.0400), (0.0385, -0.0470), (0.0370, -0.0530)),),
        (("dimple", 1.0), ("smile", 0.3)),
        0.0011,
        0.0020,
        rest=0.1,
    ),
    Fold(
        (
            ((0.0170, 0.0150), (0.0240, 0.0110), (0.0330, 0.0100), (0.0420, 0.0130)),
            ((0.0190, 0.0110), (0.0270, 0.0065), (0.0360, 0.0070)),
        ),
        (("cheek_squint", 0.7), ("eye_squint", 0.5), ("smile", 0.3)),
        0.00055,
        0.0010,
        rest=0.5,
    ),
    Fold((((0.0275, -0.0500), (0.0300, -0.0580), (0.0290, -0.0660)),), (("frown", 1.0),), 0.0010, 0.0018, rest=0.3),
    Fold(
        (((0.0, -0.0620), (0.0100, -0.0615), (0.0160, -0.0640)),),
        (("chin_raise", 1.0),),
        0.0010,
        0.0020,
        sided=False,
        rest=0.2,
    ),
    Fold(
        tuple(((0.0015 + 0.0045 * i, -0.0330), (0.0012 + 0.0040 * i, -0.0385)) for i in range(5)),
        (("pucker", 0.9), ("upper_roll_in", 0.6)),
        0.0004,
        0.0008,
        sided=False,
        rest=0.4,
    ),
    Fold(
        (((0.0200, 0.0340), (0.0310, 0.0362), (0.0420, 0.0335)),),
        (("brow_outer_up", 0.3), ("eye_wide", 0.5)),
        0.0005,
        0.0010,
        rest=0.9,
    ),
)


@dataclass(frozen=True)
class Bulge:
    """A swelling that grows with expressions: cheek apples, the bunched chin, the corrugator of a frown.

    Attributes:
        center: Center on the left half of the generic head, m.
        reach: Distance along each axis at which the Gaussian has fallen to 1/e, m.
        drivers: Expression names and weights; see `strength`.
        out: Displacement at full strength, m.
    """

    center: tuple[float, float, float]
    reach: tuple[float, float, float]
    drivers: tuple[tuple[str, float], ...]
    out: tuple[float, float, float]


BULGES = (
    Bulge(
        (0.036, -0.012, 0.040), (0.013, 0.012, 0.02), (("smile", 0.8), ("cheek_squint", 0.5)), (0.0008, 0.0006, 0.0026)
    ),
    Bulge((0.044, -0.036, 0.030), (0.012, 0.014, 0.02), (("smile", 0.7), ("stretch", 0.6)), (0.0020, 0.0, -0.0006)),
    Bulge((0.012, 0.042, 0.046), (0.008, 0.007, 0.02), (("brow_down", 1.0),), (-0.0004, -0.0004, 0.0014)),
    Bulge((0.041, -0.036, 0.034), (0.020, 0.020, 0.03), (("cheek_puff", 1.0),), (0.0024, 0.0, 0.0030)),
    Bulge((0.000, -0.072, 0.053), (0.011, 0.008, 0.02), (("chin_raise", 1.0),), (0.0, 0.0, 0.0014)),
    Bulge(
        (0.030, 0.010, 0.040), (0.010, 0.004, 0.02), (("eye_squint", 0.7), ("cheek_squint", 0.6)), (0.0, 0.0003, 0.0010)
    ),
)


def strength(drivers: tuple[tuple[str, float], ...], side: str, values: dict[str, float]) -> float:
    """Strength of a fold or bulge: the weighted sum of its drivers to the power 1.6, 0 at rest and about 1 at most."""
    total = sum(weight * values[name if name in values else f"{name}_{side}"] for name, weight in drivers)
    return float(np.clip(total, 0.0, 1.3)) ** 1.6


@dataclass(frozen=True)
class FoldPatch:
    """The part of the height texture that one fold changes on one side.

    Attributes:
        fold: The fold.
        side: "left" or "right".
        row: First row of the part.
        column: First column of the part.
        heights: Height change at full strength, m.
    """

    fold: Fold
    side: str
    row: int
    column: int
    heights: Float[ndarray, "A B"]


def fold_patches(texels: Texels) -> list[FoldPatch]:
    """The parts of the height texture that the folds change."""
    found = []
    front = texels.points[:, 2] > 0.0
    flat = texels.points[:, :2]
    for fold in FOLDS:
        corners = np.concatenate([np.asarray(curve) for curve in fold.curves])
        low, high = corners.min(axis=0) - 5.5 * fold.width, corners.max(axis=0) + 5.5 * fold.width
        for side, sign in (("left", 1.0), ("right", -1.0)):
            heights = np.zeros(len(texels.points))
            mirrored = flat * (sign, 1)
            near = front & (mirrored[:, 0] > -0.0005) & ((mirrored > low) & (mirrored < high)).all(axis=1)
            heights[near] = _profile(texels.points[near] * (sign, 1, 1), fold)
            rows, columns = texels.rows[heights != 0], texels.columns[heights != 0]
            canvas = np.zeros((np.ptp(rows) + 1, np.ptp(columns) + 1), np.float32)
            canvas[rows - rows.min(), columns - columns.min()] = heights[heights != 0]
            found.append(FoldPatch(fold, side, int(rows.min()), int(columns.min()), canvas))
    return found


def _profile(points: ndarray, fold: Fold) -> ndarray:
    """Height of grooves with soft shoulders along the fold's curves, m; exactly 0 beyond five widths."""
    wobble = 0.0004 * noise(points, 0.006, 5)
    total = np.zeros(len(points))
    for curve in fold.curves:
        away, along = _distance(points[:, :2] + wobble[:, None], np.asarray(curve))
        fade = np.sin(np.pi * np.clip(0.08 + 0.84 * along, 0, 1)) ** 0.7
        shoulder = 0.45 * np.exp(-(((away - 2.2 * fold.width) / (1.1 * fold.width)) ** 2))
        profile = (shoulder - np.exp(-((away / fold.width) ** 2))) * fold.depth * fade
        total += np.where(away < 5 * fold.width, profile, 0.0)
    return total


def _distance(points: ndarray, curve: ndarray) -> tuple[ndarray, ndarray]:
    """Distance to a polyline and position along it in [0, 1]."""
    best, place = np.full(len(points), np.inf), np.zeros(len(points))
    lengths = np.linalg.norm(np.diff(curve, axis=0), axis=1)
    starts = np.concatenate(([0.0], np.cumsum(lengths)))
    for index in range(len(curve) - 1):
        axis = (curve[index + 1] - curve[index]) / lengths[index]
        along = np.clip((points - curve[index]) @ axis, 0, lengths[index])
        away = np.linalg.norm(points - curve[index] - along[:, None] * axis, axis=1)
        place = np.where(away < best, (starts[index] + along) / starts[-1], place)
        best = np.minimum(best, away)
    return best, place


def add_folds(height: Float[ndarray, "R R"], pieces: list[FoldPatch], values: dict[str, float], age: float) -> None:
    """Add all folds at their current strength to a height texture, in place.

    Args:
        height: The texture, m.
        pieces: The folds' parts of it.
        values: Expression coefficients by name.
        age: Depth of wrinkles at rest, 0 to 1.
    """
    for piece in pieces:
        amount = strength(piece.fold.drivers, piece.side, values) + age * piece.fold.rest
        if amount > 0.01:
            rows, columns = piece.heights.shape
            height[piece.row : piece.row + rows, piece.column : piece.column + columns] += amount * piece.heights


def bulge_fields(points: Float[ndarray, "V 3"], on_skin: ndarray) -> Float[ndarray, "B 2 V 3"]:
    """Displacement of the vertices by every bulge at full strength on the left and on the right, m."""
    fields = np.zeros((len(BULGES), 2, len(points), 3), np.float32)
    for index, item in enumerate(BULGES):
        for side, sign in enumerate((1.0, -1.0)):
            own = (
                smoothstep(-0.004, 0.004, points[:, 0] * sign) if item.center[0] > 0.008 else np.full(len(points), 0.5)
            )
            weight = mirrored_gaussian(points, item.center, item.reach) * own * on_skin
            fields[index, side] = weight[:, None] * (np.asarray(item.out) * (sign, 1, 1))
    return fields


def bulge_strengths(values: dict[str, float]) -> Float[ndarray, "B 2"]:
    """Strength of every bulge on the left and on the right."""
    return np.array([[strength(item.drivers, side, values) for side in ("left", "right")] for item in BULGES])
