"""What a web avatar's sliders and ARKit's names move, and how far: names and ranges from the head and the training."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from ggavatar.core import Drive
from ggavatar.head.arkit_map import GAZE_SIDEWAYS, GAZE_UP_DOWN, JAW_OPEN, JAW_SIDEWAYS, Target, arkit_map, joint_target
from ggavatar.head.axis_names import axis_names
from ggavatar.head.head_pose import HeadPoses
from ggavatar.head.model import HeadModel

PARTS = ("expression", "joint_rotations", "eyelids")
QUANTILES = (0.01, 0.99)
"""Range of a slider, of the values in training."""
LEAST_EXPRESSION = (-0.2, 0.5)
"""Sliders of expressions reach at least this far."""
BEYOND = 0.15
"""How far ARKit's curves may leave the training range, as a fraction of it; narrower than ggavatar-render --limit."""
LEAST_ZONE = 1e-6
"""Zone of numbers that did not move in training; zero would be divided by."""
VIEW_MARGIN = np.radians(15.0)
"""How far the view may leave the poses seen in training, rad."""


@dataclass(frozen=True)
class Slider:
    """A slider of the page.

    Attributes:
        group: Heading under which it stands.
        label: Its name.
        unit: Of its value: "rad", which the page shows in degrees, or "" for plain numbers.
        low: Smallest value.
        high: Largest value.
        targets: What it moves per unit of its value.
    """

    group: str
    label: str
    unit: str
    low: float
    high: float
    targets: tuple[Target, ...]


def sliders(head: HeadModel, drives: list[Drive]) -> list[Slider]:
    """Jaw, gaze and lids by their effect, then every expression coefficient with its range in training."""
    found = [*_joint_sliders(head)]
    if bool(head.eyelid_basis.any()):
        for index, side in enumerate(("left", "right")):
            found.append(Slider("Face", f"{side} lid", "", 0.0, 1.0, (Target("eyelids", index, 1.0),)))
    seen = _stacked(drives, "expression")
    low, high = (np.quantile(seen, share, axis=0) for share in QUANTILES)
    for index, name in enumerate(axis_names(head)):
        least, most = min(LEAST_EXPRESSION[0], float(low[index])), max(LEAST_EXPRESSION[1], float(high[index]))
        target = Target("expression", index, 1.0)
        found.append(Slider("Expression", name.replace("_", " "), "", round(least, 3), round(most, 3), (target,)))
    return found


def _joint_sliders(head: HeadModel) -> list[Slider]:
    def slider(label: str, joints: tuple[str, ...], axis: int, low: float, high: float) -> Slider | None:
        if not set(joints) <= set(head.joint_names):
            return None
        return Slider("Face", label, "rad", low, high, tuple(joint_target(head, name, axis, 1.0) for name in joints))

    eyes = ("left_eye", "right_eye")
    wanted = (
        slider("jaw open", ("jaw",), 0, -0.05, JAW_OPEN),
        slider("jaw sideways", ("jaw",), 1, -JAW_SIDEWAYS, JAW_SIDEWAYS),
        slider("gaze sideways", eyes, 1, -GAZE_SIDEWAYS, GAZE_SIDEWAYS),
        slider("gaze down", eyes, 0, -GAZE_UP_DOWN, GAZE_UP_DOWN),
    )
    return [one for one in wanted if one is not None]


def limits(drives: list[Drive]) -> dict[str, list[list[float]]]:
    """Least and most value in training and the zone beyond in which values saturate, for every number of a drive."""
    found = {}
    for part in PARTS:
        seen = _stacked(drives, part)
        low, high = seen.min(axis=0), seen.max(axis=0)
        width = high - low
        zone = np.maximum(BEYOND * np.maximum(width, np.median(width) if width.size else 0.0), LEAST_ZONE)
        found[part] = [[round(float(value), 6) for value in row] for row in (low, high, zone)]
    return found


def view_range(poses: HeadPoses, drives: list[Drive]) -> dict[str, list[float]]:
    """Yaw and pitch from which the head was seen, and a margin, rad: within it the view shows what was trained.

    A view is turned by Rx(pitch) Ry(yaw) in the camera's axes (`evaluate.motion.orbit.orbit_camera`).
    """
    turned = torch.stack([drive.head_to_camera[:3, :3] for drive in drives]) @ poses.reference[:3, :3].T
    yaw = torch.atan2(turned[:, 0, 2], turned[:, 0, 0])
    pitch = torch.atan2(turned[:, 2, 1], turned[:, 1, 1])
    return {"yaw": _range(yaw), "pitch": _range(pitch)}


def _range(angles: Tensor) -> list[float]:
    low, high = np.quantile(angles.cpu().numpy(), QUANTILES)
    return [round(min(float(low), 0.0) - VIEW_MARGIN, 3), round(max(float(high), 0.0) + VIEW_MARGIN, 3)]


def control_description(head: HeadModel, poses: HeadPoses, drives: list[Drive]) -> dict[str, Any]:
    """Sliders, limits, view and ARKit's map as the page reads them."""
    return {
        "sliders": [asdict(slider) for slider in sliders(head, drives)],
        "limits": limits(drives),
        "view": view_range(poses, drives),
        "arkit": {name: [list(target) for target in targets] for name, targets in arkit_map(head).items()},
    }


def _stacked(drives: list[Drive], part: str) -> Float[np.ndarray, "T D"]:
    return np.stack([getattr(drive, part).detach().cpu().numpy().ravel() for drive in drives]).astype(np.float64)
