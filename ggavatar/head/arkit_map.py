"""What ARKit's 52 blendshapes move on a head: expression coefficients, joint angles and lids, by name.

Angles and signs are those of the capture format: a positive x rotation opens the jaw and lowers the gaze, a positive y
rotation turns towards the subject's left.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Literal, NamedTuple

from ggavatar.head.axis_names import axis_names
from ggavatar.head.expression_axes import TRACKED_AXES
from ggavatar.head.model import HeadModel
from ggavatar.head.procedural.blendshapes import BLENDSHAPES

JAW_OPEN, JAW_SIDEWAYS, JAW_CLOSING = 0.45, 0.12, 0.25
"""Rotation of the jaw at a score of 1, rad."""
GAZE_UP_DOWN, GAZE_SIDEWAYS = 0.45, 0.5
"""Rotation of an eyeball at a score of 1, rad."""

Part = Literal["expression", "joint_rotations", "eyelids"]
SIDES = (("Left", "left", 0, 1.0), ("Right", "right", 1, -1.0))
"""ARKit's suffix, ours, the lid, and the sign of a rotation about y that turns the eye outwards."""


class Target(NamedTuple):
    """One number of a drive, and how far it moves at a score of 1.

    Attributes:
        part: Field of `ggavatar.core.Drive`.
        place: Position in the field, flattened.
        factor: In the field's unit.
    """

    part: Part
    place: int
    factor: float


def arkit_map(head: HeadModel) -> dict[str, tuple[Target, ...]]:
    """What each of the 52 moves; names without a counterpart are left out, and heads without named axes give none."""
    names = axis_names(head)
    if head.version.startswith("procedural-"):
        axes = BLENDSHAPES
        closing = True
    elif head.version.startswith("tracked-"):
        axes = {name: ((name, 1.0),) for name in TRACKED_AXES}
        closing = False
    elif head.version.startswith("ict-facekit-"):
        return _moved(_ict_axes(names), names)
    else:
        return {}
    return _moved(axes, names) | _joints_and_lids(head, closing)


def _ict_axes(names: Iterable[str]) -> dict[str, tuple[tuple[str, float], ...]]:
    """ICT-FaceKit's axes have ARKit's names, with _L and _R, and two where ARKit has one."""
    axes: dict[str, tuple[tuple[str, float], ...]] = {}
    for name in names:
        stem, _, side = name.partition("_")
        suffix = {"L": "Left", "R": "Right"}.get(side, "")
        key = stem if stem in ("browInnerUp", "cheekPuff") else stem + suffix
        axes[key] = (*axes.get(key, ()), (name, 1.0))
    return axes


def _moved(axes: Mapping[str, Iterable[tuple[str, float]]], names: tuple[str, ...]) -> dict[str, tuple[Target, ...]]:
    """Targets in the expression coefficients, for the axes that a head has."""
    found = {
        arkit: tuple(Target("expression", names.index(name), factor) for name, factor in own if name in names)
        for arkit, own in axes.items()
    }
    return {arkit: targets for arkit, targets in found.items() if targets}


def _joints_and_lids(head: HeadModel, closing: bool) -> dict[str, tuple[Target, ...]]:
    """Jaw, gaze and lids; `closing`: mouthClose turns the jaw back, for heads without an axis for it."""
    wanted: dict[str, tuple[str, int, float]] = {
        "jawOpen": ("jaw", 0, JAW_OPEN),
        "jawLeft": ("jaw", 1, JAW_SIDEWAYS),
        "jawRight": ("jaw", 1, -JAW_SIDEWAYS),
    }
    if closing:
        wanted["mouthClose"] = ("jaw", 0, -JAW_CLOSING)
    for suffix, side, _, outwards in SIDES:
        eye = f"{side}_eye"
        wanted[f"eyeLookDown{suffix}"] = (eye, 0, GAZE_UP_DOWN)
        wanted[f"eyeLookUp{suffix}"] = (eye, 0, -GAZE_UP_DOWN)
        wanted[f"eyeLookOut{suffix}"] = (eye, 1, outwards * GAZE_SIDEWAYS)
        wanted[f"eyeLookIn{suffix}"] = (eye, 1, -outwards * GAZE_SIDEWAYS)
    joints: dict[str, tuple[Target, ...]] = {
        arkit: (joint_target(head, joint, axis, factor),)
        for arkit, (joint, axis, factor) in wanted.items()
        if joint in head.joint_names
    }
    lids: dict[str, tuple[Target, ...]] = {
        f"eyeBlink{suffix}": (Target("eyelids", lid, 1.0),) for suffix, _, lid, _ in SIDES
    }
    return joints | (lids if bool(head.eyelid_basis.any()) else {})


def joint_target(head: HeadModel, joint: str, axis: int, factor: float) -> Target:
    """The rotation of a joint about one of its axes (0 x, 1 y, 2 z)."""
    return Target("joint_rotations", 3 * head.joint_index(joint) + axis, factor)
