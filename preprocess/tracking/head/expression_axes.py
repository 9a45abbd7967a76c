"""The expression axes of a tracked head that have names and are the same for every subject."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float

from ggavatar.head.expression_axes import TRACKED_AXES
from ggavatar.head.procedural.model import procedural_names
from ggavatar.landmarks.blendshapes import NAMES

# The procedural head's expressions that make up each axis: name and amount. Sides follow the axis.
_GENERIC_EXPRESSIONS = {
    "browDown": (("brow_down", 1.0),),
    "browInnerUp": (("brow_inner_up", 1.0),),
    "browOuterUp": (("brow_outer_up", 1.0),),
    "cheekPuff": (("cheek_puff", 1.0),),
    "cheekSquint": (("cheek_squint", 1.0),),
    "eyeSquint": (("eye_squint", 1.0),),
    "eyeWide": (("eye_wide", 1.0),),
    "mouthDimple": (("dimple", 1.0),),
    "mouthFrown": (("frown", 1.0),),
    "mouthFunnel": (("funnel", 1.0),),
    "mouth": (("mouth_shift", 1.0),),
    "mouthLowerDown": (("lower_lip_depress", 1.0),),
    "mouthPress": (("lips_press", 0.5),),
    "mouthPucker": (("pucker", 1.0),),
    "mouthRollLower": (("lower_roll_in", 1.0),),
    "mouthRollUpper": (("upper_roll_in", 1.0),),
    "mouthShrugLower": (("chin_raise", 1.0),),
    "mouthShrugUpper": (("upper_lip_forward", 0.7),),
    "mouthSmile": (("smile", 1.0),),
    "mouthStretch": (("stretch", 1.0),),
    "mouthUpperUp": (("upper_lip_raise", 1.0),),
    "noseSneer": (("nose_wrinkle", 1.0),),
}


def axis_scores(blendshapes: Float[np.ndarray, "T 52"]) -> Float[np.ndarray, "T A"]:
    """The scores that belong to `TRACKED_AXES`."""
    return blendshapes[:, [NAMES.index(name) for name in TRACKED_AXES]]


def score(blendshapes: Float[np.ndarray, "T 52"], name: str) -> Float[np.ndarray, " T"]:
    """One score by name."""
    return blendshapes[:, NAMES.index(name)]


def generic_mixture() -> Float[np.ndarray, "G A"]:
    """Amount of each of the procedural head's expressions in each of `TRACKED_AXES`."""
    names, _ = procedural_names()
    mixture = np.zeros((len(names), len(TRACKED_AXES)))
    for column, axis in enumerate(TRACKED_AXES):
        stem, side = _split(axis)
        for generic, amount in _GENERIC_EXPRESSIONS.get(stem, ()):
            candidates = (f"{generic}_{side}", f"{generic}_left", f"{generic}_right", generic)
            existing = [name for name in candidates if name in names]
            chosen = existing[:1] if side or generic in names else existing
            mixture[[names.index(name) for name in chosen], column] = amount
    return mixture


def _split(axis: str) -> tuple[str, str]:
    """An axis name without its side, and the side ("left", "right" or "")."""
    for side in ("Left", "Right"):
        if axis.endswith(side):
            return axis.removesuffix(side), side.lower()
    return axis, ""
