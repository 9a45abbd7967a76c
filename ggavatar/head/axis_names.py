"""Names of a head's expression coefficients, by the version of its parameter space."""

from __future__ import annotations

from ggavatar.head.ict import EXPRESSIONS as ICT_AXES
from ggavatar.head.model import HeadModel
from ggavatar.head.procedural.model import procedural_names
from ggavatar.landmarks.blendshapes import NAMES

JOINT_SCORES = ("neutral", "jawForward", "jawLeft", "jawOpen", "jawRight", "eyeBlinkLeft", "eyeBlinkRight")
"""Blendshape scores that joints and lids represent instead of axes, as do gaze scores (eyeLook…)."""

TRACKED_AXES = tuple(name for name in NAMES if name not in JOINT_SCORES and not name.startswith("eyeLook"))
"""Named coefficients of heads of our own tracker; the person's own axes and the neck's length follow."""


def axis_names(head: HeadModel) -> tuple[str, ...]:
    """The name of every expression coefficient; those without a meaning of their own are numbered."""
    count = head.expression_basis.shape[2]
    if head.version.startswith("procedural-"):
        known = tuple(procedural_names()[0])
    elif head.version.startswith("tracked-"):
        personal = max(count - len(TRACKED_AXES) - 1, 0)
        known = (*TRACKED_AXES, *(f"personal_{index + 1}" for index in range(personal)), "neck_length")
    else:
        known = ICT_AXES if head.version.startswith("ict-facekit-") else ()
    return known if len(known) == count else tuple(f"expression_{index + 1}" for index in range(count))
