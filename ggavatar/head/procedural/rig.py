"""Joints, skinning weights and lids of the procedural head."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float, Int
from numpy import ndarray

from ggavatar.head.procedural.expression import lower_lip_weight
from ggavatar.head.procedural.surface import EYE_CENTER, EYE_RADIUS, LID_THICKNESS

JOINT_NAMES = ("root", "neck", "jaw", "left_eye", "right_eye")
PARENTS = (-1, 0, 1, 1, 1)
_EYE_X, _EYE_Y, _EYE_Z = EYE_CENTER
JOINTS = np.array(
    [
        (0, -0.150, -0.045),
        (0, -0.0775, -0.030),
        (0, -0.0200, -0.010),
        (_EYE_X, _EYE_Y, _EYE_Z),
        (-_EYE_X, _EYE_Y, _EYE_Z),
    ]
)
_CLOSING_LINE_HEIGHT = 0.30


def _smooth(low: float, high: float, values: ndarray) -> ndarray:
    """Smoothstep: 0 below `low`, 1 above `high`, a cubic step between."""
    share = np.clip((values - low) / (high - low), 0.0, 1.0)
    return share * share * (3 - 2 * share)


def jaw_weight(points: Float[ndarray, "V 3"]) -> Float[ndarray, " V"]:
    """Weight with which skin follows the jaw, in [0, 1].

    It is 1 on the lower lip and chin, 0 on the upper lip, and fades over cheeks and throat and towards the ears.
    """
    throat = _smooth(-0.125, -0.088, points[:, 1] + 0.35 * np.clip(points[:, 2] - 0.02, 0, 0.05))
    front = _smooth(-0.045, 0.015, points[:, 2])
    return lower_lip_weight(points) * throat * front


def skinning_weights(points: Float[ndarray, "V 3"], groups: dict[str, Int[ndarray, " R"]]) -> Float[ndarray, "V J"]:
    """Weights of root, neck, jaw, left and right eye; rows sum to 1.

    Args:
        points: Vertices of the generic head, m.
        groups: Vertex sets `skin`, `mouth_bag`, `left_eyeball`, `right_eyeball`, `upper_teeth`, `lower_teeth`,
            `tongue` and `ears`.
    """
    weights = np.zeros((len(points), len(JOINTS)))
    jaw = jaw_weight(points)
    for name in ("ears", "upper_teeth"):
        jaw[groups[name]] = 0.0
    bag = groups["mouth_bag"]
    jaw[bag] = lower_lip_weight(points[bag]) * _smooth(-0.03, 0.01, points[bag, 2])
    jaw[groups["lower_teeth"]] = 1.0
    jaw[groups["tongue"]] = 0.5 + 0.5 * _smooth(-0.010, 0.020, points[groups["tongue"], 2])
    neck = _smooth(-0.150, -0.095, points[:, 1])
    weights[:, 1] = neck * (1 - jaw)
    weights[:, 2] = neck * jaw
    weights[:, 0] = 1 - neck
    for joint, name in ((3, "left_eyeball"), (4, "right_eyeball")):
        weights[groups[name]] = np.eye(len(JOINTS))[joint]
    return weights


def joint_regressor(points: Float[ndarray, "V 3"], groups: dict[str, Int[ndarray, " R"]]) -> Float[ndarray, "J V"]:
    """For every joint, the weights closest to the plain mean of a vertex set that reproduce the joint exactly."""
    skin = points[groups["skin"]]
    supports = (
        groups["skin"][skin[:, 1] < -0.125],
        groups["skin"][np.abs(skin[:, 1] + 0.085) < 0.022],
        groups["skin"][(np.abs(skin[:, 1] + 0.020) < 0.030) & (np.abs(skin[:, 2] + 0.005) < 0.040)],
        groups["left_eyeball"],
        groups["right_eyeball"],
    )
    regressor = np.zeros((len(JOINTS), len(points)))
    for joint, rows in enumerate(supports):
        mean = np.full(len(rows), 1 / len(rows))
        constraints = np.vstack((np.ones(len(rows)), points[rows].T))
        missing = np.concatenate(([1.0], JOINTS[joint])) - constraints @ mean
        regressor[joint, rows] = mean + constraints.T @ np.linalg.solve(constraints @ constraints.T, missing)
    return regressor


def eyelid_basis(
    points: Float[ndarray, "V 3"], skin: Int[ndarray, " R"], loops: tuple[ndarray, ndarray]
) -> Float[ndarray, "V 3 2"]:
    """Displacement that closes the left and the right lid, m.

    The margins of both lids move onto one closing line, 30 % of the way up from the lower lid, on a sphere just
    outside the eyeball; the surrounding skin follows with a Gaussian falloff.
    """
    basis = np.zeros((len(points), 3, 2))
    for side, loop in enumerate(loops):
        center = np.array([_EYE_X * (1 - 2 * side), _EYE_Y, _EYE_Z])
        margin = points[loop] - center
        half = len(loop) // 2
        upper, lower = margin[: half + 1], np.concatenate((margin[half:], margin[:1]))[::-1]
        along = upper[:, 0]
        order = np.argsort(along)
        heights = [np.interp(points[skin, 0] - center[0], along[order], lid[order, 1]) for lid in (upper, lower)]
        basis[skin, :, side] = _closing(points[skin] - center, *heights)
    return basis


def _closing(local: ndarray, upper: ndarray, lower: ndarray) -> ndarray:
    """Displacement of skin points relative to the eye's center, given the height of both margins at each point's x."""
    line = lower + _CLOSING_LINE_HEIGHT * (upper - lower)
    above = local[:, 1] >= 0.5 * (upper + lower)
    margin = np.where(above, upper, lower)
    distance = np.abs(local[:, 1] - margin)
    weight = np.exp(-((distance / 0.0052) ** 2)) * _smooth(0.0185, 0.0135, np.abs(local[:, 0])) * (local[:, 2] > -0.004)
    target_y = local[:, 1] + weight * (line - margin)
    radius = EYE_RADIUS + LID_THICKNESS
    depth = np.sqrt(np.maximum(radius**2 - target_y**2 - local[:, 0] ** 2, 0.0))
    before = np.sqrt(np.maximum(radius**2 - local[:, 1] ** 2 - local[:, 0] ** 2, 0.0))
    forwards = weight * np.where(np.abs(local[:, 0]) < radius, depth - before + 0.0004, 0.0)
    return np.stack((np.zeros_like(target_y), target_y - local[:, 1], forwards), axis=1)
