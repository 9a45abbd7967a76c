"""Names of expression coefficients: which of them mean the same on every head, and which only on one.

A tracked head has axes named after ARKit's blendshapes, axes of the subject's own (principal components of the clip),
and the length of the neck. Only axes of the same name can be carried from one head to another.
"""

from __future__ import annotations

from ggavatar.head.ict import EXPRESSIONS as ICT_AXES
from ggavatar.head.procedural.expression import expression_names
from ggavatar.landmarks.blendshapes import NAMES

JOINT_SCORES = ("neutral", "jawForward", "jawLeft", "jawOpen", "jawRight", "eyeBlinkLeft", "eyeBlinkRight")
"""Scores that joints and lids represent instead of axes, as do gaze scores (eyeLook…)."""

TRACKED_AXES = tuple(name for name in NAMES if name not in JOINT_SCORES and not name.startswith("eyeLook"))
"""Named expression coefficients of tracked heads; one unit is the full expression of the blendshape of that name."""

OWN_PREFIX, NECK_LENGTH = "own", "neckLength"
"""Prefix of axes that mean something on one head only, and the axis that moves the torso instead of the face."""


def tracked_names(personal: int) -> tuple[str, ...]:
    """Names of a tracked head's coefficients: shared axes, `personal` axes of its own, then the neck's length."""
    return (*TRACKED_AXES, *(f"{OWN_PREFIX}{number + 1}" for number in range(personal)), NECK_LENGTH)


def names_without_file(version: str, count: int) -> tuple[str, ...]:
    """Names of the coefficients of a head file that does not hold any; empty if they are not known."""
    known: tuple[str, ...] = ()
    if version == "tracked-2":
        known = tracked_names(max(count - len(TRACKED_AXES) - 1, 0))
    elif version.startswith("procedural-"):
        known = expression_names()
    elif version.startswith("ict-facekit-"):
        known = ICT_AXES
    return known if len(known) == count else ()


def is_shared(name: str) -> bool:
    """Whether an axis means the same on every head that has one of this name."""
    return not name.startswith(OWN_PREFIX)
