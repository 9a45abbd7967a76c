"""ARKit's blendshapes as mixtures of the procedural head's expressions."""

from __future__ import annotations

_SIDED = {
    "browDown": "brow_down",
    "browOuterUp": "brow_outer_up",
    "cheekSquint": "cheek_squint",
    "eyeSquint": "eye_squint",
    "eyeWide": "eye_wide",
    "mouth": "mouth_shift",
    "mouthDimple": "dimple",
    "mouthFrown": "frown",
    "mouthLowerDown": "lower_lip_depress",
    "mouthSmile": "smile",
    "mouthStretch": "stretch",
    "mouthUpperUp": "upper_lip_raise",
    "noseSneer": "nose_wrinkle",
}
BLENDSHAPES: dict[str, tuple[tuple[str, float], ...]] = {
    "browInnerUp": (("brow_inner_up", 1.0),),
    "cheekPuff": (("cheek_puff_left", 1.0), ("cheek_puff_right", 1.0)),
    "mouthFunnel": (("funnel", 1.0),),
    "mouthPressLeft": (("lips_press", 0.5),),
    "mouthPressRight": (("lips_press", 0.5),),
    "mouthPucker": (("pucker", 1.0),),
    "mouthRollLower": (("lower_roll_in", 1.0),),
    "mouthRollUpper": (("upper_roll_in", 1.0),),
    "mouthShrugLower": (("chin_raise", 1.0),),
    "mouthShrugUpper": (("upper_lip_forward", 0.7),),
    "tongueOut": (("tongue_out", 1.0),),
} | {f"{stem}{side}": ((f"{own}_{side.lower()}", 1.0),) for stem, own in _SIDED.items() for side in ("Left", "Right")}
"""Expressions and their amounts at a score of 1; blendshapes that joints and lids stand for are left out."""
